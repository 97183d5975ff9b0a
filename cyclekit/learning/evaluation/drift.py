"""Tests by newer logs whether the safety function or the operator's habits have changed since training.

Neighbouring samples are nearly equal, so the test compares means per execution with the scatter between executions.
Because many places are tested, a change is reported only beyond NAMED standard errors and a minimum size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import ModelError, command_line
from cyclekit.learning.coupling.learn import pace_before_and_after
from cyclekit.learning.labelling import as_learned
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.learning.signal_inputs import as_learned_by, learned_rows
from cyclekit.learning.windows import build_samples
from cyclekit.parallel.one_thread import one_thread

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.schema import Floats

NAMED = 4.0
"""Minimum difference, in standard errors, that is reported."""
MIN_SCALING = 0.01
"""Minimum change of the mean error of the scaling that justifies a new training."""
MIN_SHARE = 0.03
"""Minimum change of a share of time that counts as a new habit (0.03 = 3 percentage points)."""


@dataclass(frozen=True)
class Shift:
    """One quantity before and after: means over executions, and their difference.

    Attributes:
        what: The quantity: a place, a task, an activity, or `everywhere`.
        before, after: Mean over the executions.
        z: Difference in standard errors.
        changed: Whether the change is significant and large enough to matter.
    """

    what: str
    before: float
    after: float
    z: float
    changed: bool


@dataclass(frozen=True)
class Drift:
    """Newer logs compared with those of the training.

    Attributes:
        safety: Mean absolute error of the predicted scaling: everywhere, by robot task, and by operator's activity.
        habits: Share of time per operator's activity (quarter of the floor if activities are unknown), cycle time
            relative to its mean before, and, where he and the robot wait for each other, the duration of his work and
            walks relative to the last of the older logs.
        executions: Number of executions before (held out in training) and after.
    """

    safety: tuple[Shift, ...]
    habits: tuple[Shift, ...]
    executions: tuple[int, int]

    @property
    def safety_changed(self) -> bool:
        """Whether the safety function differs from the learned one."""
        return any(shift.changed for shift in self.safety)

    @property
    def habits_changed(self) -> bool:
        """Whether the operator's habits differ from those in training."""
        return any(shift.changed for shift in self.habits)

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "safety_changed": self.safety_changed,
            "habits_changed": self.habits_changed,
            "safety": [vars(shift) for shift in self.safety],
            "habits": [vars(shift) for shift in self.habits],
            "executions": list(self.executions),
        }


@one_thread()
def drift(model: TrainedModel, trained_on: Dataset, newer: Dataset) -> Drift:
    """Compare newer logs with those that the model was trained on.

    Args:
        model: A model of problem `now`.
        trained_on: Dataset of the training, of which the held-out executions are used.
        newer: The newer logs.

    Raises:
        ModelError: The model does not predict the present scaling, or was not trained on that dataset.
    """
    if model.problem != "now":
        msg = f"the model predicts problem {model.problem!r}; drift is read from the present scaling"
        cure = f"Train one: {command_line('train', trained_on.place, '--problem', 'now', '--out', 'MODEL')}"
        raise ModelError(msg, cure=cure)
    held_out = model.card.held_out
    names = set(trained_on.executions["execution"].to_list())
    if not held_out or not names.issuperset(held_out):
        msg = f"{trained_on.path}: not the dataset that the model was trained on"
        raise ModelError(msg, cure="Give the dataset named in the model's card with --trained-on.")
    return drift_between(model, trained_on, newer, held_out, newer.executions["execution"].to_list())


@one_thread()
def drift_between(
    model: TrainedModel, older: Dataset, newer: Dataset, judged_before: Sequence[str], judged_after: Sequence[str]
) -> Drift:
    """Compare two sets of executions.

    Args:
        model: A model of problem `now`.
        older: The earlier executions.
        newer: The later executions.
        judged_before: Executions of `older` on which the model's errors are measured; not used in training.
        judged_after: The same for `newer`.
    """
    older, newer = (as_learned_by(model.card, whose) for whose in (older, newer))
    before, after = (learned_rows(whose, whose.samples()) for whose in (older, newer))
    judged = [
        as_learned(model.card, whose, frame.filter(pl.col("execution").is_in(list(names))), model.levels)
        for whose, frame, names in ((older, before, judged_before), (newer, after, judged_after))
    ]
    rates = (older.rate_hz, newer.rate_hz)
    safety = _safety(*(_errors(model, frame, rate_hz) for frame, rate_hz in zip(judged, rates, strict=True)))
    habits = _habits(before, after)
    cycles = [frame.executions.filter("complete")["duration_s"].to_numpy() for frame in (older, newer)]
    if min(len(part) for part in cycles) > 1:
        usual = float(cycles[0].mean())
        habits.append(_shift("cycle time, 1 = its mean before", cycles[0] / usual, cycles[1] / usual, MIN_SHARE))
    if (paces := pace_before_and_after(older, newer)) is not None:
        habits.append(_shift("time that the operator's work and walks take, 1 = as before", *paces, MIN_SHARE))
    counts = (judged[0]["execution"].n_unique(), judged[1]["execution"].n_unique())
    return Drift(tuple(safety), tuple(habits), counts)


def _safety(old: pl.DataFrame, new: pl.DataFrame) -> list[Shift]:
    found = [_shift("everywhere", _by_execution(old), _by_execution(new), MIN_SCALING)]
    for column in ("robot_task", "human_task"):
        for name in sorted(set(new[column].drop_nulls()) & set(old[column].drop_nulls())):
            was, now = (_by_execution(frame.filter(pl.col(column) == name)) for frame in (old, new))
            found.append(_shift(f"{column.replace('_', ' ')} {name}", was, now, MIN_SCALING))
    return found


def _errors(model: TrainedModel, frame: pl.DataFrame, rate_hz: float) -> pl.DataFrame:
    """Return one row per usable sample: execution, tasks, absolute error of what answers (rule or network)."""
    known = frame.filter(pl.all_horizontal(pl.col(name).is_not_null() for name in (*model.inputs, "scaling")))
    rows = build_samples(known, model.problem, model.horizon_s, model.levels, rate_hz=rate_hz)
    error = np.abs(predictor_of(model).predict(rows.X) - rows.scaling) if len(rows) else np.zeros(0)
    return known.select("execution", "robot_task", "human_task").with_columns(error=pl.Series(error))


def _by_execution(errors: pl.DataFrame) -> Floats:
    means = errors.group_by("execution", maintain_order=True).agg(pl.col("error").mean())
    return means["error"].to_numpy()


def _habits(before: pl.DataFrame, after: pl.DataFrame) -> list[Shift]:
    """Return the changes in the share of time per activity (or quarter of the floor), from means per execution."""
    known = before["human_task"].is_not_null().any() and after["human_task"].is_not_null().any()
    middle = before.select(pl.col("human_x_m", "human_y_m").median()).row(0)
    front = pl.when(pl.col("human_x_m") > (middle[0] or 0.0)).then(pl.lit("front")).otherwise(pl.lit("back"))
    side = pl.when(pl.col("human_y_m") > (middle[1] or 0.0)).then(pl.lit("left")).otherwise(pl.lit("right"))
    place = pl.col("human_task") if known else pl.format("floor {} {}", front, side)
    old, new = (_shares(frame.with_columns(where=place)) for frame in (before, after))
    names = sorted(set(old) | set(new))
    nobody = [np.zeros(frame["execution"].n_unique()) for frame in (before, after)]
    return [_shift(name, old.get(name, nobody[0]), new.get(name, nobody[1]), MIN_SHARE) for name in names]


def _shares(frame: pl.DataFrame) -> Mapping[str, Floats]:
    counts = frame.drop_nulls("where").group_by("execution", "where").len()
    wide = counts.pivot("where", index="execution", values="len").fill_null(0)
    names = [name for name in wide.columns if name != "execution"]
    total = wide.select(pl.sum_horizontal(names).alias("all"))["all"].to_numpy()
    return {name: wide[name].to_numpy() / np.maximum(total, 1) for name in names}


def _shift(what: str, before: Floats, after: Floats, least: float) -> Shift:
    """Compare two groups of executions; with one execution on either side no change is significant."""
    old, new = float(before.mean()), float(after.mean())
    if min(len(before), len(after)) < 2:
        return Shift(what, old, new, 0.0, changed=False)
    error = float(np.sqrt(before.var(ddof=1) / len(before) + after.var(ddof=1) / len(after)))
    z = (new - old) / max(error, 1e-9)
    return Shift(what, old, new, z, changed=bool(abs(z) > NAMED and abs(new - old) > least))
