"""Arguments of public functions: paths are opened, open objects are used as they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cyclekit.api.arguments import Place
from cyclekit.config.sequences import TaskSequence, load_sequences
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, ModelError, UnknownName
from cyclekit.estimate.plan.jobs import Jobs, load_jobs
from cyclekit.estimate.plan.task_orders import TaskJobs, load_task_jobs
from cyclekit.estimate.robot.safety import SafetyModel
from cyclekit.estimate.whatif.change import Change, load_changes
from cyclekit.learning.networks.saved import TrainedModel, load_model
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.learning.task_times.saved import TaskTimesModel, holds_task_times, load_task_times
from cyclekit.learning.unseen.saved import holds_unseen, load_unseen

Sequences = Place | TaskSequence | Sequence[TaskSequence]
Changes = Place | Change | Sequence[Change]


def model_of(given: SafetyModel | Place) -> SafetyModel:
    """Return a safety function: the rule of a trained model if it has one, else its network.

    A model trained on a robot log without people is a safety function of states.
    """
    if isinstance(given, str | Path) and holds_unseen(given):
        return load_unseen(given)
    opened = load_model(given) if isinstance(given, str | Path) else given
    return predictor_of(opened) if isinstance(opened, TrainedModel) else opened


def estimator_model(given: SafetyModel | TaskTimesModel | Place) -> SafetyModel | TaskTimesModel:
    """Return the model for an estimate: a safety function, or task times learned from task lists."""
    times = times_of(given)
    return times if times is not None else model_of(given)  # type: ignore[arg-type]  # it is no other


def times_of(given: object) -> TaskTimesModel | None:
    """Return a model of task times, opened; None if it is another model."""
    if isinstance(given, str | Path) and holds_task_times(given):
        return load_task_times(given)
    return given if isinstance(given, TaskTimesModel) else None


def refuse_options_of_positions(**chosen: bool) -> None:
    """Refuse the options that a model of task times cannot honour.

    Args:
        chosen: Whether the caller chose a value other than the default, by option.

    Raises:
        ModelError: Some were chosen.
    """
    if names := [name for name, differs in chosen.items() if differs]:
        seen = f"{', '.join(names)}: not for a model of task times"
        why = "It has one way to an estimate, was validated when it was trained, and knows no positions and no cell"
        raise ModelError(seen, cure=f"{why}: leave {'it' if len(names) == 1 else 'them'} out.")


def trained_of(given: TrainedModel | Place) -> TrainedModel:
    """Return a trained model, opened."""
    return given if isinstance(given, TrainedModel) else load_model(given)


def sequences_of(given: Sequences) -> list[TaskSequence]:
    """Return sequences, read from a file if a path is given."""
    if isinstance(given, str | Path):
        return load_sequences(given)
    return [given] if isinstance(given, TaskSequence) else list(given)


def changes_of(given: Changes) -> list[Change]:
    """Return changes, read from a file if a path is given."""
    if isinstance(given, str | Path):
        return load_changes(given)
    return [given] if isinstance(given, Change) else list(given)


def jobs_of(given: Jobs | TaskJobs | Place) -> Jobs:
    """Return the jobs, read from a file if a path is given.

    Raises:
        ConfigError: These are tasks of both agents.
    """
    if isinstance(given, TaskJobs):
        seen = f"{given.shown}: tasks of both agents, and this model needs places to visit"
        raise ConfigError(seen, cure="Give Jobs, or train a model on task lists.")
    return given if isinstance(given, Jobs) else load_jobs(given)


def task_jobs_of(given: Jobs | TaskJobs | Place) -> TaskJobs:
    """Return the work of both agents, read from a file if a path is given.

    Raises:
        ConfigError: These are places to visit.
    """
    if isinstance(given, str | Path):
        return load_task_jobs(Path(given))
    if isinstance(given, TaskJobs):
        return given
    seen = f"{given.shown}: places to visit, and a model of task times orders tasks of both agents"
    raise ConfigError(seen, cure="Give TaskJobs, or a jobs file with [[task]].")


def refuse_baseline(baseline: str | None, names: Sequence[str]) -> None:
    """Refuse a baseline that is not one of the sequences, before anything is computed.

    Raises:
        UnknownName: There is no sequence of that name.
    """
    if baseline is not None and baseline not in names:
        raise UnknownName("the baseline", "sequence", baseline, names)


def place_of(given: object) -> Path | str | None:
    """Return the place of an input, which no output may replace; None if it has none."""
    if isinstance(given, str | Path):
        return given
    return given.place if isinstance(given, Dataset) else None


def path_of(given: Place | None) -> Path | None:
    """Return a path as a `Path`; None stays None."""
    return None if given is None else Path(given)
