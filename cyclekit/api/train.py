"""`train_model`: the safety function of the cell, learned from a dataset; `train_seeds`: one model for each seed.

`train_task_times` learns from task lists, without positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.dataset import Dataset, People
from cyclekit.dataset.guard import check_output
from cyclekit.errors import CyclekitError
from cyclekit.estimate.joint.proven import with_proven_waits
from cyclekit.learning.networks.saved import TrainedModel, check_model_output, load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.learning.task_times.learn import learn_task_times
from cyclekit.learning.task_times.saved import TaskTimesModel, save_task_times
from cyclekit.learning.training import learns_unseen, need_torch, train
from cyclekit.learning.unseen.fit import learn_unseen
from cyclekit.learning.unseen.model import UnseenOperator
from cyclekit.learning.unseen.saved import holds_unseen, load_unseen, save_unseen
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.storage.remote.folders import join


@checked
def train_model(
    dataset: Dataset | Place,
    spec: ModelSpec | None = None,
    *,
    rules: bool = True,
    people: People = "auto",
    out: Place | None = None,
    engine: Engine = LOCAL,
    progress: Progress | None = None,
) -> TrainedModel | UnseenOperator:
    """Train a model of when the robot slows down.

    Args:
        dataset: A dataset with speed scaling, logged or inferred, and positions of robot and operator. If no log shows
            people, the model is one of an unseen operator: it gives estimates, but knows no positions of people.
        spec: Training settings; None: `ModelSpec.of()`.
        rules: For problem `now`, also search the simplest rule that explains the commanded level; if one is found,
            estimates use it instead of the network.
        people: Information on people: positions, signals, or the kind that more executions have.
        out: Also write it there: a folder or a URL.
        engine: Where it is trained, if `out` is given; else in this process.
        progress: Called after every epoch with the fraction done and the validation error.

    Raises:
        DatasetError: The dataset lacks what training needs; the message says what.
        MissingExtra: torch is not installed.
        OutputError: The model would replace something other than a model, or be inside the dataset.
        CyclekitError: The model cannot be written.
    """
    wanted = spec or ModelSpec.of()
    if out is None:
        opened = Dataset.of(dataset).by_people(people)
        if learns_unseen(opened, wanted):
            return learn_unseen(opened, seed=wanted.seed, progress=progress)
        return _with_proven_waits(train(opened, wanted, rules=rules, progress=progress), opened)
    (model,) = _put([Training(_place(dataset), wanted, str(out), rules, people)], engine, progress)
    return model


@checked
def train_seeds(
    dataset: Dataset | Place,
    seeds: Sequence[int],
    out: Place,
    spec: ModelSpec | None = None,
    *,
    rules: bool = True,
    people: People = "auto",
    engine: Engine = LOCAL,
    progress: Progress | None = None,
) -> dict[str, TrainedModel | UnseenOperator]:
    """Train one model per seed and write each to `out`/seed-N; return them by that place, in the order of the seeds.

    Args:
        dataset: As in `train_model`.
        seeds: Seeds of the splits and the trainings.
        out: A folder or a URL for all models.
        spec: Training settings; its seed is ignored.
        rules: As in `train_model`.
        people: As in `train_model`.
        engine: Where models are trained, and how many at the same time.
        progress: Called with the fraction done.

    Raises:
        CyclekitError: As in `train_model`.
    """
    wanted = spec or ModelSpec.of()
    todo = [
        Training(_place(dataset), replace(wanted, seed=seed), join(str(out), f"seed-{seed}"), rules, people)
        for seed in seeds
    ]
    return dict(zip([each.out for each in todo], _put(todo, engine, progress), strict=True))


@checked
def train_task_times(
    dataset: Dataset | Place, *, out: Place | None = None, seed: int = 0, progress: Progress | None = None
) -> TaskTimesModel:
    """Train a model of task times: durations during other tasks, and what each task waits for.

    Args:
        dataset: A dataset of task lists of both agents; positions are not needed.
        out: Also write it there: a folder or a URL.
        seed: Seed of the random draws.
        progress: Called with the fraction done.

    Raises:
        DatasetError: It holds too few complete executions.
        OutputError: The model would replace something other than a model, or be inside the dataset.
    """
    if out is not None:
        check_output(str(out), "model", [_place(dataset)])
        check_model_output(str(out))
    found = TaskTimesModel(learn_task_times(Dataset.of(dataset), seed=seed, progress=progress))
    if out is not None:
        save_task_times(out, found)
    return found


@dataclass(frozen=True)
class Training:
    """One model to train, as a task of an engine.

    Attributes:
        dataset, out: Paths or URLs of dataset and model.
        spec: What to train.
        rules: Whether to search a rule too.
        people: Source of people (`Dataset.by_people`).
    """

    dataset: str
    spec: ModelSpec
    out: str
    rules: bool = False
    people: People = "auto"


def train_at(what: Training, *, progress: Progress | None = None) -> TrainingCard:
    """Train a model, save it and return its card; for a robot's log alone, the model is of an unseen operator.

    Raises:
        OutputError: The model would replace something else, or lie in the dataset.
        CyclekitError: As `train`, or the model cannot be written.
    """
    check_output(what.out, "model", [what.dataset])
    check_model_output(what.out)
    dataset = Dataset.open(what.dataset).by_people(what.people)
    if learns_unseen(dataset, what.spec):
        unseen = learn_unseen(dataset, seed=what.spec.seed, progress=progress)
        save_unseen(what.out, unseen)
        return unseen.card
    model = _with_proven_waits(train(dataset, what.spec, rules=what.rules, progress=progress), dataset)
    save_model(what.out, model)
    return model.card


def _with_proven_waits(model: TrainedModel, dataset: Dataset) -> TrainedModel:
    """Return a model without the learned waits if logged executions speak against them."""
    if model.problem != "now":
        return model
    return replace(model, card=with_proven_waits(predictor_of(model), dataset))


def _place(dataset: Dataset | Place) -> str:
    return dataset.place if isinstance(dataset, Dataset) else str(dataset)


def _learns_unseen(each: Training) -> bool:
    """Return whether no network is trained; if the dataset cannot be opened, the training reports it."""
    try:
        return learns_unseen(Dataset.open(each.dataset), each.spec)
    except CyclekitError:
        return False


def _put(todo: Sequence[Training], engine: Engine, progress: Progress | None) -> list[TrainedModel | UnseenOperator]:
    """Train every model and write it to its place; all refusals come before the first training."""
    for each in todo:
        check_output(each.out, "model", [each.dataset])
        check_model_output(each.out)
        if not _learns_unseen(each):
            need_torch(each.spec)
    here = len(todo) == 1 and engine.stays_here(1)
    tell = progress or (lambda _fraction, _text: None)
    work = partial(train_at, progress=tell) if here else train_at
    for count, done in enumerate(engine.map(work, todo), start=1):
        done.get()
        tell(count / len(todo), done.item.out)
    return [load_unseen(each.out) if holds_unseen(each.out) else load_model(each.out) for each in todo]
