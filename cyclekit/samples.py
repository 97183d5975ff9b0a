"""Turn 10 Hz samples into the arrays a network learns from, for each of the paper's three problems.

    now      x_r, x_h              -> s_i                        what holds at this instant
    ahead    x_r, x_h, g_r, g_h    -> s_{i+w}                    what will hold w samples later
    average  x_r, x_h, g_r, g_h    -> mean of s_i ... s_{i+w}    what a task will be slowed to (w + 1 samples)

A window never crosses from one execution into the next, nor a gap in the log. A row with an unknown input or target
is left out and counted, never filled. How executions are divided into those to learn from and those to judge by is
decided here too: by execution, never by row, because neighbouring rows are nearly equal.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import polars as pl

from cyclekit.errors import DatasetError, ShapeError, UnknownName
from cyclekit.steps import UNKNOWN, label

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

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
_GAP = 1.5
"""Two samples farther apart than this many periods have a gap between them."""


@dataclass(frozen=True)
class Samples:
    """Rows ready for a network: N rows, F inputs.

    Attributes:
        X: Inputs, shape (N, F), float32, metres, base frame; columns as in `inputs`.
        step: Level of the target, shape (N,), int32; -1 where the target is on no level (always for `average`).
        scaling: Target, shape (N,): s_i, s_{i+w} or the mean of s_i ... s_{i+w}.
        execution: Which execution, shape (N,), index into `executions`.
        executions: Names of the executions.
        t_s: Session time of the row (of its inputs), shape (N,), s.
        inputs: Names of the F input columns.
        dropped: Rows left out, by reason.
    """

    X: NDArray[np.float32]
    step: NDArray[np.int32]
    scaling: NDArray[np.float64]
    execution: NDArray[np.int64]
    executions: tuple[str, ...]
    t_s: NDArray[np.float64]
    inputs: tuple[str, ...]
    dropped: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return N."""
        return int(self.scaling.size)

    def of(self, executions: Iterable[str]) -> Samples:
        """Return the rows of some executions; `dropped` is not divided and stays empty."""
        wanted = set(executions)
        keep = np.isin(self.execution, [i for i, name in enumerate(self.executions) if name in wanted])
        return self.where(keep)

    def where(self, keep: NDArray[np.bool_]) -> Samples:
        """Return the rows for which `keep`, shape (N,), is true; `dropped` stays empty."""
        parts = {name: getattr(self, name)[keep] for name in ("X", "step", "scaling", "execution", "t_s")}
        return replace(self, **parts, dropped={})

    def labelled(self, levels: Sequence[float]) -> Samples:
        """Return the same rows with the steps of other levels."""
        return replace(self, step=label(self.scaling, levels))


def build_samples(
    frame: pl.DataFrame, problem: str, horizon_s: float, levels: Sequence[float], *, rate_hz: float = 10.0
) -> Samples:
    """Build the rows of one problem.

    Args:
        frame: Table SAMPLES, rows of one execution together and in order of time.
        problem: `now`, `ahead` or `average`.
        horizon_s: How far ahead the target lies or reaches; must be 0 for `now`.
        levels: Staircase levels, ascending, to name the step of a target.
        rate_hz: Rate of `frame`.

    Raises:
        UnknownName: There is no such problem.
        ShapeError: The horizon does not suit the problem.
    """
    if problem not in INPUTS:
        raise UnknownName("the model", "problem", problem, PROBLEMS)
    width = round(horizon_s * rate_hz)
    if (problem == "now") != (width == 0) or horizon_s < 0:
        msg = f"problem {problem!r} with a horizon of {horizon_s} s: `now` has none, the others need one"
        raise ShapeError(msg, cure=f"Give a horizon of at least {1 / rate_hz:g} s for ahead and average, 0 for now.")
    inputs = INPUTS[problem]
    X = frame.select(pl.col(inputs).cast(pl.Float32)).to_numpy()
    scaling = frame["scaling"].fill_null(np.nan).to_numpy()
    target, whole = _target(frame, problem, scaling, width, rate_hz)
    keep, dropped = _usable(X, target, whole)
    names = frame["execution"].unique(maintain_order=True).to_list()
    code = frame["execution"].replace_strict(names, list(range(len(names))), return_dtype=pl.Int64).to_numpy()
    step = np.full(target.shape, UNKNOWN, np.int32) if problem == "average" else label(target, levels)
    time = frame["t_s"].to_numpy()
    every = Samples(X, step, target, code, tuple(names), time, inputs)
    return replace(every.where(keep), dropped=dropped)


def stretches(frame: pl.DataFrame, rate_hz: float = 10.0) -> NDArray[np.int64]:
    """Return the number of the unbroken stretch (one execution, no gap) of every row of SAMPLES, shape (N,)."""
    step = pl.col("t_s").diff()
    new = (pl.col("execution") != pl.col("execution").shift()) | (step > _GAP / rate_hz) | (step <= 0)
    return frame.select(new.fill_null(value=True).cum_sum().cast(pl.Int64)).to_series().to_numpy()


def _target(
    frame: pl.DataFrame, problem: str, scaling: NDArray[np.float64], width: int, rate_hz: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the target of each row (NaN = unknown) and whether its window lies inside one unbroken run."""
    count = scaling.size
    if width == 0:
        return scaling, np.ones(count, np.bool_)
    target, whole = np.full(count, np.nan), np.zeros(count, np.bool_)
    if count <= width:
        return target, whole
    run = stretches(frame, rate_hz)
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


def _usable(
    X: NDArray[np.float32], target: NDArray[np.float64], whole: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Return which rows can be used, and how many are left out for each reason (the first that applies)."""

    def unknown(columns: NDArray[np.float32]) -> NDArray[np.bool_]:
        total: NDArray[np.float32] = columns.sum(axis=1)  # NaN in any column makes it NaN
        return np.isnan(total)

    reasons = {
        "window leaves the execution or crosses a gap": ~whole,
        "robot position unknown": unknown(X[:, :3]),
        "operator absent or not seen": unknown(X[:, 3:6]),
        "goal unknown": unknown(X[:, 6:]),
        "scaling unknown": np.isnan(target),
    }
    keep, dropped = np.ones(target.size, np.bool_), {}
    for reason, bad in reasons.items():
        if lost := int((keep & bad).sum()):
            dropped[reason] = lost
        keep &= ~bad
    return keep, dropped


def scaling_without_operator(frame: pl.DataFrame) -> float | None:
    """Return the scaling that holds while nobody is seen (median), None where the logs never show it.

    The networks need a position of the operator; this is what holds when there is none.
    """
    absent = frame.filter(pl.col("human_x_m").is_null() & pl.col("scaling").is_not_null())
    middle = absent["scaling"].median()
    return float(middle) if isinstance(middle, float) else None


def split_executions(
    names: Sequence[str], *, test_fraction: float = 0.2, seed: int = 0
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Divide executions at random into those to learn from and those held out, both in the given order.

    Args:
        names: Executions, each once.
        test_fraction: Part held out, in (0, 1); at least one execution is held out, and one is kept.
        seed: Same names and seed, same split, in whatever order the names come.

    Raises:
        DatasetError: There are fewer than two executions.
    """
    if len(names) < 2:
        msg = f"{len(names)} execution: nothing can be held out to judge by"
        raise DatasetError(msg, cure="Log the process at least twice, or mark in cell.toml how executions begin.")
    count = min(max(round(test_fraction * len(names)), 1), len(names) - 1)
    held_out = set(np.random.default_rng(seed).permutation(sorted(names))[:count].tolist())
    return tuple(n for n in names if n not in held_out), tuple(n for n in names if n in held_out)
