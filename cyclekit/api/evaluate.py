"""`evaluate_model`: the errors of a model on held-out executions; `evaluate_models`: of several models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import trained_of
from cyclekit.dataset.dataset import Dataset
from cyclekit.learning.evaluation.drift import drift
from cyclekit.learning.evaluation.evaluate import Evaluation, evaluate, evaluate_at
from cyclekit.learning.networks.saved import TrainedModel, models_in
from cyclekit.learning.task_times.judge import TaskTimesEvaluation, judge_task_times
from cyclekit.learning.task_times.saved import TaskTimesModel, load_task_times
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.text.results import Result


@checked
def evaluate_model(
    model: TrainedModel | Place,
    dataset: Dataset | Place,
    *,
    trained_on: Dataset | Place | None = None,
    boosting: bool = True,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Judge a model on held-out executions, and compare it with baselines.

    Args:
        model: A model, its folder or its URL.
        dataset: A dataset with known scaling, its folder or its URL.
        trained_on: Dataset of the training, if `dataset` is newer; `drift` then says what has changed.
        boosting: Also fit scikit-learn's gradient boosting, which takes a few seconds.
        other_cell: Accept a model of another cell.
        progress: Called with the fraction done and a text.

    Raises:
        DatasetError: No sample can be judged.
        ModelError: The model is of another cell, or its card does not say what was held out.
    """
    opened, judged = trained_of(model), Dataset.of(dataset)
    changed = None if trained_on is None else drift(opened, Dataset.of(trained_on), judged)
    foreign = other_cell or trained_on is not None
    return replace(evaluate(opened, judged, boosting=boosting, other_cell=foreign, progress=progress), drift=changed)


@checked
def evaluate_task_times(
    model: TaskTimesModel | Place,
    dataset: Dataset | Place,
    *,
    trained_on: Dataset | Place | None = None,
    progress: Progress | None = None,
) -> TaskTimesEvaluation:
    """Compare a model of task times with logged executions.

    Args:
        model: A model of task times, its folder or its URL.
        dataset: A dataset of task lists.
        trained_on: Dataset of the training, if `dataset` is newer; `drift` then says whether the pace has changed.
        progress: Called with the fraction done.

    Raises:
        ModelError: The model is of another kind.
        DatasetError: No execution can be judged.
    """
    opened = model if isinstance(model, TaskTimesModel) else load_task_times(model)
    older = None if trained_on is None else Dataset.of(trained_on)
    return judge_task_times(opened.card, Dataset.of(dataset), trained_on=older, progress=progress)


@dataclass(frozen=True, repr=False)
class ModelComparison(Result, Mapping[str, Evaluation]):
    """The evaluations of several models on one dataset, by the models' places; as a frame one row per model.

    Attributes:
        evaluations: One for each model.
        together: Whether a folder of models was given, even with only one model.
    """

    evaluations: Mapping[str, Evaluation]
    together: bool

    def __getitem__(self, place: str) -> Evaluation:
        """Return the evaluation of a model, by its place."""
        return self.evaluations[place]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the models' places."""
        return iter(self.evaluations)

    def __len__(self) -> int:
        """Return the number of models."""
        return len(self.evaluations)

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain JSON values; for a single model, its evaluation."""
        if not self.together:
            return next(iter(self.evaluations.values())).to_dict()
        return {"models": {Path(place).name: one.to_dict() for place, one in self.evaluations.items()}}

    def _frame_rows(self) -> list[dict[str, object]]:
        return [
            {"model": place, "network": one.network, "samples": one.metrics.rows}
            | {"mse": one.metrics.mse_mean, "mean_absolute_error": one.metrics.mae}
            for place, one in self.evaluations.items()
        ]

    def _lines(self) -> list[str]:
        return [f"{place}: {repr(one).partition(': ')[2]}" for place, one in self.evaluations.items()]


@checked
def evaluate_models(
    model: Place,
    dataset: Place,
    *,
    trained_on: Place | None = None,
    boosting: bool = True,
    other_cell: bool = False,
    engine: Engine = LOCAL,
    progress: Progress | None = None,
) -> ModelComparison:
    """Judge a model, or every model in a folder, as `evaluate_model` does.

    Args:
        model: A model or a folder of several, by path or URL.
        dataset: Folder or URL of the dataset.
        trained_on: Dataset of the training.
        boosting: Also fit gradient boosting.
        other_cell: Accept models of another cell.
        engine: Where models are evaluated, and how many at the same time.
        progress: Called with the fraction done and a text.

    Raises:
        CyclekitError: As in `evaluate_model`.
    """
    models = models_in(str(model))
    tell = progress or (lambda _fraction, _text: None)
    inner = tell if len(models) == 1 and engine.stays_here(1) else None
    newer = None if trained_on is None else str(trained_on)
    judge = partial(evaluate_at, dataset=str(dataset), trained_on=newer)
    found: dict[str, Evaluation] = {}
    for done in engine.map(partial(judge, other_cell=other_cell, boosting=boosting, progress=inner), models):
        found[done.item] = done.get()
        tell(len(found) / len(models), done.item)
    return ModelComparison({place: found[place] for place in models}, together=models != [str(model)])
