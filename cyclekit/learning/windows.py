"""Converts samples to the arrays that a network learns from, for each of the paper's three problems.

    now      x_r, x_h              -> s_i                        present scaling
    ahead    x_r, x_h, g_r, g_h    -> s_{i+w}                    scaling w samples later
    average  x_r, x_h, g_r, g_h    -> mean of s_i ... s_{i+w}    mean scaling of a task (w + 1 samples)

A window never extends into another execution or across a gap in the log; neither does the history of a recurrent
network. A row with an unknown target is dropped and counted, never filled; so is one with an unknown input, unless the
network has a flag "known or not" for it (`GROUPS`). If only the operator's height is unknown, that of the TCP is used
(`unknown_height`). Executions, never rows, are split into training and test here, because neighbouring rows are nearly
equal.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import polars as pl

from cyclekit.dataset.time_grid import stretches
from cyclekit.dataset.unknown_height import inputs_in_plane
from cyclekit.errors import DatasetError, ShapeError, UnknownName
from cyclekit.learning.last_second import PAST, past_inputs
from cyclekit.scaling.levels import UNKNOWN, label_in_time, unbroken
from cyclekit.text.numbers import given

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from cyclekit.schema import Bools, Floats, Ints, Singles

Problem = Literal["now", "ahead", "average"]
PROBLEMS: tuple[Problem, ...] = get_args(Problem)

_POSITIONS = tuple(f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz")
_GOALS = tuple(f"{who}_goal_{axis}_m" for who in ("robot", "human") for axis in "xyz")
INPUTS: Mapping[str, tuple[str, ...]] = {
    "now": _POSITIONS,
    "ahead": _POSITIONS + _GOALS,
    "average": _POSITIONS + _GOALS,
}
"""Input columns of every problem, in the order of the columns of X."""
GROUPS: Mapping[str, slice] = {
    "human": slice(3, 6),
    "robot_goal": slice(6, 9),
    "human_goal": slice(9, 12),
    "scaling": slice(14, 15),
}
"""Columns of X that may be unknown together: an absent operator, a goal that was not logged, the present scaling."""
_MODEL_ERROR = 0.05
"""Assumed standard deviation of a prediction, which weighs the uncertainty of an inferred scaling."""


def inputs_of(problem: str, *, past: bool) -> tuple[str, ...]:
    """Return the input columns of a problem; `past` adds those of `last_second.PAST`."""
    return INPUTS[problem] + (PAST if past else ())


def input_rows(X: ArrayLike, names: Sequence[str]) -> Floats | Singles:
    """Return inputs of a model as an array.

    Args:
        X: An array, lists, or a frame; the columns of a frame are taken by name, or by position if none has a known
            name.
        names: Names of the inputs.

    Raises:
        ShapeError: A frame lacks some of the inputs, or a value is no number.
    """
    columns: Sequence[str] = getattr(X, "columns", ())
    if any(name in columns for name in names):
        if missing := [name for name in names if name not in columns]:
            msg = f"inputs without {', '.join(missing)}"
            raise ShapeError(msg, cure=f"Give all of {', '.join(names)}.")
        X = X[list(names)]  # type: ignore[call-overload,index]  # polars and pandas select columns by their names
    try:
        found = np.asarray(X)
        return found if np.issubdtype(found.dtype, np.floating) else found.astype(np.float64)
    except (TypeError, ValueError) as error:
        msg = f"inputs must be numbers in rows of {len(names)}: {error}"
        raise ShapeError(msg) from error


@dataclass(frozen=True)
class Samples:
    """Rows for a network: N rows, F inputs.

    Attributes:
        X: Inputs, shape (N, F), float32, metres, base frame; columns as in `inputs`.
        step: Index of the target level, shape (N,), int32; -1 = on no level (always for `average`).
        scaling: Target, shape (N,): s_i, s_{i+w} or the mean of s_i ... s_{i+w}.
        execution: Execution, shape (N,), index into `executions`.
        executions: Names of the executions.
        t_s: Session time of the row (of its inputs), shape (N,), s.
        inputs: Names of the F input columns.
        weight: Weight of each row in training, shape (N,), in (0, 1]; below 1 if the scaling was inferred.
        table: Inputs of all rows that a history may contain, shape (M, F); None without a history.
        before: Rows of `table` that a recurrent network sees for each row, oldest first, shape (N, K); None without a
            history.
        ahead: Row of `table` at the end of each row's window, shape (N,), for the future position of the operator; None
            without a history.
        dropped: Number of dropped rows by reason.
        in_files: The arrays are memory-mapped and may exceed memory (`out_of_core`).
    """

    X: Singles
    step: NDArray[np.int32]
    scaling: Floats
    execution: Ints
    executions: tuple[str, ...]
    t_s: Floats
    inputs: tuple[str, ...]
    weight: Singles
    table: Singles | None = None
    before: Ints | None = None
    ahead: Ints | None = None
    dropped: Mapping[str, int] = field(default_factory=dict)
    in_files: bool = False

    def __len__(self) -> int:
        """Return N."""
        return int(self.scaling.size)

    @property
    def model_inputs(self) -> Singles:
        """Inputs of a model: X, or with a history shape (N, K, F)."""
        return self.X if self.table is None or self.before is None else self.table[self.before]

    def of(self, executions: Iterable[str]) -> Samples:
        """Return the rows of some executions; `dropped` stays empty."""
        wanted = set(executions)
        keep = np.isin(self.execution, [i for i, name in enumerate(self.executions) if name in wanted])
        return self.where(keep)

    def where(self, keep: Bools) -> Samples:
        """Return the rows for which `keep`, shape (N,), is true; `dropped` stays empty."""
        names = ("X", "step", "scaling", "execution", "t_s", "weight")
        parts = {name: getattr(self, name)[keep] for name in names}
        parts |= {name: getattr(self, name)[keep] for name in ("before", "ahead") if getattr(self, name) is not None}
        return replace(self, **parts, dropped={})


def build_samples(
    frame: pl.DataFrame,
    problem: str,
    horizon_s: float,
    levels: Sequence[float],
    *,
    rate_hz: float,
    allow: Collection[str] = (),
    history: tuple[int, int] = (1, 1),
    past: bool = False,
) -> Samples:
    """Build the rows of one problem.

    Args:
        frame: Table SAMPLES, grouped by execution and ordered by time. A column `scaling_sd`, standard deviation of an
            inferred scaling (0 or null if logged), determines the weight.
        problem: `now`, `ahead` or `average`.
        horizon_s: Horizon of the target, or length of its average, s; must be 0 for `now`.
        levels: Levels of the speed scaling, ascending, to label the targets; rows in transition get none.
        rate_hz: Rate of `frame`.
        allow: Groups (see `GROUPS`) whose columns may be unknown (NaN in X). Rows in which the operator is hidden, or
            his log has ended, are dropped in any case, because he is not known to be absent.
        history: Number of samples that a recurrent network sees, and rows between them. At the start of a stretch, its
            first sample replaces the earlier ones.
        past: Add the inputs of `last_second.PAST`; for a problem with goals.

    Raises:
        UnknownName: There is no such problem.
        ShapeError: The horizon does not suit the problem.
    """
    if problem not in INPUTS:
        raise UnknownName("the model", "problem", problem, PROBLEMS)
    width = round(horizon_s * rate_hz)
    if (problem == "now") != (width == 0) or horizon_s < 0:
        msg = f"problem {problem!r} with a horizon of {horizon_s} s: `now` has none, the others need one"
        raise ShapeError(
            msg, cure=f"Give a horizon of at least {given(1 / rate_hz)} s for ahead and average, 0 for now."
        )
    inputs = inputs_of(problem, past=past)
    X = inputs_in_plane(frame.select(pl.col(INPUTS[problem]).cast(pl.Float32)).to_numpy())
    scaling = frame["scaling"].fill_null(np.nan).to_numpy()
    run = stretches(frame, rate_hz)
    X = np.concatenate([X, past_inputs(X, scaling, run, rate_hz)], axis=1) if past else X
    target, whole = _target(problem, scaling, run, width)
    unknown = _unknown_inputs(frame, X, allow)
    keep, dropped = _usable({"window leaves the execution or crosses a gap": ~whole, **unknown}, target)
    names = frame["execution"].unique(maintain_order=True).to_list()
    code = frame["execution"].replace_strict(names, list(range(len(names))), return_dtype=pl.Int64).to_numpy()
    step = np.full(target.shape, UNKNOWN, np.int32)
    if problem != "average" and len(levels):
        now = label_in_time(scaling, levels, unbroken(run, np.isfinite(scaling)), rate_hz=rate_hz)
        step[: len(step) - width] = now[width:]
    table, before, ahead = None, None, None
    if history != (1, 1):
        ahead = np.minimum(np.arange(len(X)) + width, len(X) - 1)
        table, before = X, _history(run, np.logical_or.reduce(list(unknown.values())), history)
    time, weight = frame["t_s"].to_numpy(), _weight(frame, width, problem)
    every = Samples(X, step, target, code, tuple(names), time, inputs, weight, table, before, ahead)
    return replace(every.where(keep), dropped=dropped)


def _weight(frame: pl.DataFrame, width: int, problem: str) -> Singles:
    """Return the weight of every row: variance of a prediction, divided by that plus the target's own variance."""
    if "scaling_sd" not in frame.columns:
        return np.ones(frame.height, np.float32)
    variance = frame["scaling_sd"].fill_null(0.0).fill_nan(0.0).to_numpy() ** 2
    mine = np.zeros_like(variance)
    if problem == "average":  # neighbours have the same error, so the mean is no more certain
        total = np.concatenate([[0.0], np.cumsum(variance)])
        mine[: variance.size - width] = (total[width + 1 :] - total[: variance.size - width]) / (width + 1)
    else:
        mine[: variance.size - width] = variance[width:]
    return np.asarray(_MODEL_ERROR**2 / (_MODEL_ERROR**2 + mine), np.float32)


def _history(run: Ints, unusable: Bools, history: tuple[int, int]) -> Ints:
    """Return the rows in each row's history, oldest first, shape (T, K); never across a gap or an unusable row."""
    count, every = history
    at = np.arange(run.size)
    first = np.concatenate([[True], (run[1:] != run[:-1]) | unusable[1:] | unusable[:-1]])
    begin = np.maximum.accumulate(np.where(first, at, 0))
    back = every * np.arange(count - 1, -1, -1)
    return np.asarray(np.maximum(at[:, None] - back[None, :], begin[:, None]))


def _target(problem: str, scaling: Floats, run: Ints, width: int) -> tuple[Floats, Bools]:
    """Return the target of each row (NaN = unknown) and whether its window lies in one unbroken stretch."""
    count = scaling.size
    if width == 0:
        return scaling, np.ones(count, np.bool_)
    target, whole = np.full(count, np.nan), np.zeros(count, np.bool_)
    if count <= width:
        return target, whole
    whole[:-width] = run[width:] == run[:-width]
    if problem == "ahead":
        target[:-width] = scaling[width:]
        return target, whole
    known = np.isfinite(scaling)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, scaling, 0.0))])
    holes = np.concatenate([[0], np.cumsum(~known)])
    mean = (total[width + 1 :] - total[: -width - 1]) / (width + 1)
    target[:-width] = np.where(holes[width + 1 :] == holes[: -width - 1], mean, np.nan)
    return target, whole


def _unknown_inputs(frame: pl.DataFrame, X: Singles, allow: Collection[str]) -> dict[str, Bools]:
    """Return by reason which rows lack a required input."""

    def unknown(columns: Singles) -> Bools:
        total: Singles = columns.sum(axis=1)  # NaN in any column makes it NaN
        return np.isnan(total)

    nobody = unknown(X[:, GROUPS["human"]])
    if "human" in allow:
        absent = (frame["human_gap"] == "absent").fill_null(value=False).to_numpy()
        nobody = nobody & ~absent
    goal = np.zeros(len(X), np.bool_)
    for group in ("robot_goal", "human_goal"):
        if X.shape[1] > GROUPS[group].start and group not in allow:
            goal |= unknown(X[:, GROUPS[group]])
    found = {"robot position unknown": unknown(X[:, :3]), "operator absent or not seen": nobody, "goal unknown": goal}
    if X.shape[1] > GROUPS["scaling"].start and "scaling" not in allow:
        found["present scaling unknown"] = unknown(X[:, GROUPS["scaling"]])
    return found


def _usable(unknown: Mapping[str, Bools], target: Floats) -> tuple[Bools, dict[str, int]]:
    """Return which rows are usable, and the number of dropped rows by reason (the first that applies)."""
    keep, dropped = np.ones(target.size, np.bool_), {}
    for reason, bad in {**unknown, "scaling unknown": np.isnan(target)}.items():
        if lost := int((keep & bad).sum()):
            dropped[reason] = lost
        keep &= ~bad
    return keep, dropped


def groups_seen_both_ways(rows: Samples, least: int) -> tuple[str, ...]:
    """Return the groups of inputs that are known in at least `least` rows and unknown in at least `least`."""
    found = []
    for group, columns in GROUPS.items():
        if rows.X.shape[1] > columns.start:
            unknown = int(np.isnan(rows.X[:, columns].sum(axis=1)).sum())
            if least <= unknown <= len(rows) - least:
                found.append(group)
    return tuple(found)


def nobody_there() -> pl.Expr:
    """Return an expression for rows of SAMPLES without an operator; not if he is hidden or his log has ended."""
    unknown = pl.col("human_gap").is_in(["occluded", "outside"]).fill_null(value=False)
    return pl.col("human_x_m").is_null() & ~unknown


def scaling_without_operator(frame: pl.DataFrame) -> float | None:
    """Return the median scaling without an operator; None if the logs never show it.

    Used where the networks, which need a position of the operator, have no input.
    """
    absent = frame.filter(nobody_there() & pl.col("scaling").is_not_null())
    middle = absent["scaling"].median()
    return float(middle) if isinstance(middle, float) else None


def split_executions(
    names: Sequence[str], *, test_fraction: float = 0.2, seed: int = 0
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split executions at random into those to learn from and those held out, both in the given order.

    Args:
        names: Executions, each once.
        test_fraction: Share held out, in (0, 1); at least one execution is held out, and one is kept.
        seed: Seed; same names and seed give the same split, in any order of names.

    Raises:
        DatasetError: There are fewer than two executions.
    """
    if len(names) < 2:
        msg = f"{len(names)} execution: none can be held out for the test"
        raise DatasetError(msg, cure="Log the process at least twice, or set in cell.toml how executions begin.")
    count = min(max(round(test_fraction * len(names)), 1), len(names) - 1)
    held_out = set(np.random.default_rng(seed).permutation(sorted(names))[:count].tolist())
    return tuple(n for n in names if n not in held_out), tuple(n for n in names if n in held_out)
