"""Errors of a model on held-out executions, compared with baselines.

A single figure says little, because the same error is excellent in one cell and poor in another. So the constant mean,
the best staircase over the distance, and gradient boosting learn from the same executions and are evaluated on the same
rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.dataset.cards import MetricsCard, plain
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.unknown_height import height_notes, inputs_in_plane
from cyclekit.errors import DatasetError, ModelError, command_line
from cyclekit.learning.evaluation.baselines import Rival, boosted, rivals
from cyclekit.learning.evaluation.drift import Drift, drift
from cyclekit.learning.labelling import as_learned, without_slider
from cyclekit.learning.networks.cell import may_share_logs, refuse_other_cell
from cyclekit.learning.networks.comparison import BOOSTED, LAST_SECOND, BetterRival, better_rival
from cyclekit.learning.networks.kinds import NETWORKS
from cyclekit.learning.networks.metrics import Predictor, measure
from cyclekit.learning.networks.saved import TrainedModel, load_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.out_of_core import memory_rows, some_executions
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.rules.words import kind_of
from cyclekit.learning.signal_inputs import as_learned_by, learned_rows
from cyclekit.learning.windows import GROUPS, Samples, build_samples
from cyclekit.parallel.one_thread import one_thread
from cyclekit.text.numbers import fixed, given, percent, scientific
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import polars as pl
    from numpy.typing import NDArray

    from cyclekit.schema import Floats, Ints, Progress


__all__ = ["ErrorRow", "Evaluation", "LevelRow", "evaluate", "evaluate_at"]


@dataclass(frozen=True)
class ErrorRow:
    """One row of the comparison: name, mean squared error of the scaling, and description."""

    name: str
    mse: float
    note: str


@dataclass(frozen=True)
class LevelRow:
    """Prediction quality on one level.

    Attributes:
        level: The level.
        rows: Number of rows on it.
        recall: Share of these predicted on this level; None without rows.
        precision: Share of rows predicted on this level that were on it; None if never predicted.
        bias: Mean of predicted - true scaling; None without rows.
    """

    level: float
    rows: int
    recall: float | None
    precision: float | None
    bias: float | None


@dataclass(frozen=True, repr=False)
class Evaluation(Result):
    """A model evaluated on a dataset.

    Attributes:
        problem: The model's problem.
        network: The model's network; `rule` if a rule answers in its place: what answers is evaluated.
        held_out: Whether its training knew the logs of the dataset, and these executions were not learned from.
        executions: Executions evaluated.
        metrics: Errors over all their usable rows.
        mse: Mean squared errors, first of what answers (`rule` or `model`), then of the network beside a rule and of
            the baselines: name, mse, note.
        confusion: Number of rows by true (first index) and predicted level, shape (P, P); None for `average`.
        levels: One entry per level, ascending; empty for `average`.
        dropped: Number of dropped rows by reason.
        notes: Limits of the comparison, one sentence each.
        better: Baseline that is better than the model by more than chance; None if there is none.
        drift: Changes since the training; None if not requested.
        learned: Number of these executions that the model learned from: errors on others are larger.
    """

    problem: str
    network: str
    held_out: bool
    executions: tuple[str, ...]
    metrics: MetricsCard
    mse: tuple[ErrorRow, ...]
    confusion: tuple[tuple[int, ...], ...] | None
    levels: tuple[LevelRow, ...]
    dropped: Mapping[str, int]
    notes: tuple[str, ...] = ()
    better: BetterRival | None = None
    drift: Drift | None = None
    learned: int = 0

    @property
    def accuracy(self) -> float | None:
        """Share of the rows on a level whose level is predicted correctly."""
        return self.metrics.accuracy

    def to_dict(self) -> dict[str, object]:
        """Return everything as JSON values."""
        return {
            "problem": self.problem,
            "network": self.network,
            "held_out": self.held_out,
            "executions": list(self.executions),
            **plain(self.metrics, nulls=True),
            "mse": [vars(row) for row in self.mse],
            "confusion": None if self.confusion is None else [list(row) for row in self.confusion],
            "levels": [vars(row) for row in self.levels],
            "dropped": dict(self.dropped),
            "notes": list(self.notes),
            "learned": self.learned,
            "better": None if self.better is None else vars(self.better),
            **({} if self.drift is None else {"drift": self.drift.to_dict()}),
        }

    def to_frame(self) -> pl.DataFrame:
        """Return one row per predictor: the model, then the baselines."""
        import polars as pl

        return pl.DataFrame([dict(vars(row)) for row in self.mse])

    def _lines(self) -> list[str]:
        named = "" if self.accuracy is None else f", {percent(self.accuracy)} of levels predicted correctly"
        about = f"{self.network} for problem {self.problem}, {len(self.executions)} executions"
        return [
            f"{about}; mean absolute error {fixed(self.metrics.mae, 4)}, MSE {scientific(self.metrics.mse_mean)}{named}"
        ]


@one_thread()
def evaluate(
    model: TrainedModel,
    dataset: Dataset,
    *,
    boosting: bool = True,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Evaluate what answers for `model`, its rule or network, on executions of `dataset` that it was not trained on.

    If it was trained on logs of this dataset, these are the executions that it did not learn from, and the baselines
    learn from its training executions. Otherwise they are all executions, and there are no baselines. Whether it was is
    told by the checksums of the logs, so a dataset may have been ingested again, copied, renamed or have grown.

    Args:
        model: Any model.
        dataset: Dataset with a known scaling.
        boosting: Include gradient boosting, up to a minute of processor time each.
        other_cell: Accept a model of another cell.
        progress: Called with share done and text.

    Raises:
        DatasetError: No row of these executions can be used.
        ModelError: The model is of another cell, or was trained on logs of this dataset and its card does not name the
            held-out executions.
    """
    tell = progress or (lambda fraction, text: None)
    refuse_other_cell(model.card, dataset, other_cell=other_cell)
    dataset = as_learned_by(model.card, dataset)
    names = tuple(dataset.executions["execution"].to_list())
    learned_from = _learned_from(model) if may_share_logs(model.card, dataset) else frozenset()
    executions = tuple(name for name in names if name not in learned_from) or names
    held_out = not learned_from.isdisjoint(names) and learned_from.isdisjoint(executions)
    every = len(executions)
    executions = some_executions(dataset, executions, memory_rows())
    tell(0.02, "reading the test executions")
    rows = _rows(model, dataset, executions)
    if not len(rows):
        why = "; ".join(f"{reason}: {count}" for reason, count in rows.dropped.items()) or "it is empty"
        msg = f"{dataset.path}: no sample can be evaluated ({why})"
        raise DatasetError(msg, cure=f"See what the logs lack: {command_line('inspect', dataset.place)}")
    tell(0.2, f"evaluating {len(rows)} samples")
    answering = _Answering.of(model)
    metrics = measure(answering, rows)
    table, notes, better = [*_read_outs(metrics, model), *_beside_rule(model, rows)], list[str](), None
    if len(executions) < every:
        notes.append(
            f"{len(executions)} of {every} executions are evaluated, drawn at random: the memory is too small for all"
        )
    notes += height_notes(dataset.samples(executions, columns=["human_x_m", "human_z_m"]))
    training = model.card.split.train if held_out and model.card.split is not None else ()
    if training and set(training) <= set(names):
        tell(0.4, "reading the training samples of the baselines")
        learned = _rows(model, dataset, some_executions(dataset, training, memory_rows()))
        tell(0.6, f"fitting the baselines to {len(learned)} samples")
        others = rivals(learned, rows, model.levels, signals=bool(model.card.operator_signals))
        if boosting:
            others += _boosted(model, dataset, learned, rows)
        table += [ErrorRow(other.name, float(other.squared.mean()), other.note) for other in others]
        squared = (answering.predict(rows.model_inputs) - rows.scaling) ** 2
        if isinstance(answering, TrainedModel):
            named = {other.name: other.squared for other in others}
            better = better_rival(model.card.spec, squared, named, rows.execution)
    else:
        why = _why_alone(held_out, bool(learned_from), not learned_from.isdisjoint(names))
        notes.append(f"{why}, without baselines")
    tell(0.95, "evaluating levels")
    confusion = _confusion(answering, rows) if model.levels and model.problem != "average" else None
    return Evaluation(
        model.problem,
        answering.network,
        held_out,
        executions,
        metrics,
        tuple(table),
        None if confusion is None else tuple(tuple(int(count) for count in row) for row in confusion),
        () if confusion is None else _per_level(answering, rows, confusion),
        dict(rows.dropped),
        tuple(notes),
        better,
        learned=len(learned_from.intersection(executions)),
    )


def evaluate_at(
    model: str,
    *,
    dataset: str,
    trained_on: str | None = None,
    other_cell: bool = False,
    boosting: bool = True,
    progress: Progress | None = None,
) -> Evaluation:
    """Evaluate the model at a path or URL; with `trained_on`, also test for changes since training.

    With `trained_on`, the two datasets are compared, so they may be of different cells. `progress` is called with share
    done and text; only for work in this process.

    Raises:
        CyclekitError: As `evaluate` and `drift`.
    """
    opened, judged = load_model(model), Dataset.open(dataset)
    changed = None if trained_on is None else drift(opened, Dataset.open(trained_on), judged)
    other_cell = other_cell or trained_on is not None
    found = evaluate(opened, judged, boosting=boosting, other_cell=other_cell, progress=progress)
    return replace(found, drift=changed)


def _learned_from(model: TrainedModel) -> frozenset[str]:
    """Return the names of the executions that a model learned from, or by which its training was stopped."""
    split = model.card.split
    if split is None or not split.test or not split.train:
        msg = "the model's card does not say which executions were held out"
        raise ModelError(msg, cure="Train it again: cyclekit train DATASET --out MODEL")
    return frozenset((*split.train, *split.validation))


def _why_alone(held_out: bool, same_logs: bool, same_names: bool) -> str:
    """Return why a model is evaluated on these executions, and why no baseline can learn from those it learned from."""
    if held_out:
        return "not all executions that the model learned from are in this dataset: the others are evaluated"
    if same_names:
        return "the model learned from every execution of this dataset: errors on others are larger"
    if same_logs:
        return (
            "the model learned from these logs, whose executions had other names: which ones is unknown, and errors on "
            "others may be larger; all are evaluated"
        )
    return "not the dataset the model was trained on: all executions are evaluated"


def _boosted(model: TrainedModel, dataset: Dataset, learned: Samples, rows: Samples) -> list[Rival]:
    """Return boosting on the inputs of the model and, for `ahead` and `average`, on the last second."""
    if NETWORKS[model.network].trees:
        return []
    found = [boosted(BOOSTED, "the inputs of the model and distances", learned, rows)]
    if model.problem != "now" and not model.past:
        wide = (_rows(model, dataset, part.executions, last_second=True) for part in (learned, rows))
        found.append(boosted(LAST_SECOND, "positions, goal times and scaling of the last second", *wide))
    return found


def _rows(model: TrainedModel, dataset: Dataset, executions: Sequence[str], *, last_second: bool = False) -> Samples:
    """Return the rows for evaluating a model; with `last_second`, with all inputs of the last second."""
    frame, _ = without_slider(dataset, learned_rows(dataset, dataset.samples(executions)))
    frame = as_learned(model.card, dataset, frame, model.levels)
    known, history = model.weights.known, model.history
    learned_hz = model.card.rate_hz or dataset.rate_hz
    if history != (1, 1) and learned_hz != dataset.rate_hz:
        msg = (
            f"the model looks back at samples of {given(learned_hz)} Hz, and {dataset.path} has "
            f"{given(dataset.rate_hz)} Hz"
        )
        raise ModelError(msg, cure=f"Ingest the logs with --rate {given(learned_hz)}, or train on this dataset.")
    past = model.past
    if last_second:
        history = ModelSpec.of("ahead", "boosting").at_rate(dataset.rate_hz).history or history
        known, past = (*known, "scaling"), True
    where = (model.problem, model.horizon_s, model.levels)
    return build_samples(frame, *where, rate_hz=dataset.rate_hz, allow=known, history=history, past=past)


@dataclass(frozen=True)
class _Answering:
    """The rule of a model, evaluated on the rows and the levels of its network."""

    rule: RuleSafety
    model: TrainedModel
    network: str = "rule"

    @classmethod
    def of(cls, model: TrainedModel) -> _Answering | TrainedModel:
        """Return what answers for a model: its rule if there is one that can be evaluated, else itself."""
        found = predictor_of(model)
        return cls(found, model) if isinstance(found, RuleSafety) else model

    @property
    def problem(self) -> str:
        return self.model.problem

    @property
    def levels(self) -> tuple[float, ...]:
        return self.model.levels

    def predict(self, X: NDArray[np.floating[Any]]) -> Floats:
        """Return the scaling, shape (N,), of rows (N, F), or of the last ones of (N, K, F)."""
        rows = inputs_in_plane(X if X.ndim == 2 else X[:, -1])
        found, alone = self.rule.predict(rows).astype(np.float64), self.model.card.scaling_without_operator
        if alone is not None and not self.model.card.operator_signals:
            found[np.isnan(rows[:, GROUPS["human"]]).any(axis=1)] = alone
        return found

    def steps(self, X: NDArray[np.floating[Any]]) -> Ints:
        """Return the number of the level nearest to the scaling, shape (N,)."""
        levels = np.array(self.levels)
        return np.searchsorted((levels[1:] + levels[:-1]) / 2, self.predict(X)).astype(np.int64)


def _read_outs(metrics: MetricsCard, model: TrainedModel) -> list[ErrorRow]:
    """Return the errors of what answers."""
    rule = model.card.rule
    if rule is not None and isinstance(predictor_of(model), RuleSafety):
        return [ErrorRow("rule", metrics.mse_mean, f"answers: {kind_of(rule)}")]
    return _of_network("model", metrics)


def _beside_rule(model: TrainedModel, rows: Samples) -> list[ErrorRow]:
    """Return the errors of a network in whose place a rule answers."""
    return _of_network("network", measure(model, rows)) if isinstance(predictor_of(model), RuleSafety) else []


def _of_network(name: str, metrics: MetricsCard) -> list[ErrorRow]:
    note = "best estimate: mean of the levels weighted by their probabilities, or the value"
    rows = [ErrorRow(name, metrics.mse_mean, note)]
    if metrics.mse_argmax is not None:
        rows.append(ErrorRow(f"{name}, most likely step", metrics.mse_argmax, "the level of the most likely step"))
    return rows


def _confusion(model: Predictor, rows: Samples) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    count, known = len(model.levels), rows.step >= 0
    cell = rows.step[known].astype(np.int64) * count + model.steps(rows.where(known).model_inputs)
    return np.bincount(cell, minlength=count**2).reshape(count, count)


def _per_level(
    model: Predictor, rows: Samples, confusion: np.ndarray[tuple[int, int], np.dtype[np.int64]]
) -> tuple[LevelRow, ...]:
    error = model.predict(rows.model_inputs) - rows.scaling
    true, named, right = confusion.sum(axis=1), confusion.sum(axis=0), confusion.diagonal()
    return tuple(
        LevelRow(
            level,
            int(true[i]),
            float(right[i] / true[i]) if true[i] else None,
            float(right[i] / named[i]) if named[i] else None,
            float(error[rows.step == i].mean()) if true[i] else None,
        )
        for i, level in enumerate(model.levels)
    )
