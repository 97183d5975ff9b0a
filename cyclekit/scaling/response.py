"""The response of the safety system from the logs: reaction time, ramps, hysteresis, hold time.

A transition from one level to another starts the reaction time after the operator crosses a threshold, and has the
slope of the ramp. The threshold is unknown but the same each time: at the right reaction time, the places of equal
changes agree best, in distance or on a line on the floor (the edge of a zone). If neither holds, reaction time and
hysteresis are unknown. If the robot speeds up later than it slows down, the difference is the hold time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.scaling.agreement import LATENCIES_S, PositionsBeforeChanges, agreement_of
from cyclekit.scaling.short_ramps import LevelChange, by_counts, by_cycles, stride_of
from cyclekit.scaling.transitions import RampRates, begin_of, fresh, held_levels, repeats, tolerance_of, transitions_of
from cyclekit.segmentation.motion import median

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.scaling.transitions import Transition
    from cyclekit.schema import Points, Vector


RAMP_ROWS = 1
"""Maximum number of rows between its levels for a transition without a slope; the mean number then gives the rate."""
JUMP_ROWS = 0.1
"""Minimum share of short transitions with a row between their levels; below, the scaling jumps."""
MIN_RAMPS = 5
"""Minimum number of ramps to determine a rate."""
MIN_ALIKE, ALIKE = 3, 0.05
"""Minimum number of slopes that determine a rate if they agree; their relative tolerance."""
_WHOLE = 0.85
"""Share of a step above which a change from row to row is limited by the step, not by the rate."""
_AGREE = 0.3
"""Relative tolerance between the slope of a few ramps and the rate from the number of rows in all ramps."""
SHORT_S = 1.0
"""Maximum duration of a transition without a slope, s."""
GROUPS = 10
"""Number of groups of changes for the jackknife standard error of a rate."""
MAX_CHANGES = 20_000
"""Maximum number of changes that are used."""


SLOW_SHARE = 0.2
"""Share of the usual programmed speed below which an inferred scaling tells no change of level: there it is the ratio
of two small speeds, so that the rounding of positions looks like changes."""


@dataclass(frozen=True)
class SafetyResponse:
    """Response of the safety function over time; None = unknown.

    Attributes:
        latency_s: Reaction time from the crossing of a threshold to the start of the change, s.
        ramp_down_per_s, ramp_up_per_s: Rate of change of the scaling, 1/s; None also if it jumps.
        hysteresis_m: Distance at which the robot speeds up minus that at which it slows, m.
        changes: Number of changes of level.
        spread_m: Median deviation of the places at which levels change, at that reaction time, m.
        hold_s: Additional delay of rises, s; None if there is none.
        ramp_down_se_per_s, ramp_up_se_per_s: Standard errors of the rates, 1/s.
    """

    latency_s: float | None
    ramp_down_per_s: float | None
    ramp_up_per_s: float | None
    hysteresis_m: float | None
    changes: int
    spread_m: float | None
    hold_s: float | None = None
    ramp_down_se_per_s: float | None = None
    ramp_up_se_per_s: float | None = None


def at_speed(scaling: Vector, speed_m_s: Vector) -> Vector:
    """Return an inferred scaling, unknown where the programmed speed is low: at the start and end of each motion.

    Args:
        scaling: Shape (T,), NaN = unknown; 0 stays.
        speed_m_s: TCP speed, shape (T,), m/s.
    """
    runs = scaling > 0.0
    programmed = np.divide(speed_m_s, scaling, out=np.full(len(scaling), np.inf), where=runs)
    known = programmed[runs & np.isfinite(programmed)]
    usual = float(np.quantile(known, 0.9)) if len(known) else 0.0
    return np.where(programmed < SLOW_SHARE * usual, np.nan, scaling)


def changes_of(t_s: Vector, scaling: Vector, levels: Sequence[float]) -> list[LevelChange]:
    """Return the changes of level of one stretch without gaps, including interrupted ones.

    Args:
        t_s: Time, shape (T,), native rate, s.
        scaling: Speed scaling, shape (T,), NaN = unknown.
        levels: Levels, ascending.
    """
    if len(levels) < 2 or len(t_s) < 3 or np.isnan(scaling).all():
        return []
    steps = np.asarray(levels, np.float64)
    rows = fresh(scaling, repeats(t_s, scaling))
    t_s, scaling = t_s[rows], scaling[rows]
    near = tolerance_of(scaling, steps)
    ramps = transitions_of(scaling, held_levels(t_s, scaling, steps, near, RampRates()), near)
    slopes = [_slope(ramp, t_s, scaling) for ramp in ramps]
    usual = {
        rises: _usual([slope for ramp, slope in zip(ramps, slopes, strict=True) if ramp.rises is rises and slope[0]])
        for rises in (False, True)
    }

    def found() -> list[LevelChange]:
        return [
            _change(ramp, slope, t_s, scaling, steps, usual[ramp.rises], near)
            for ramp, slope in zip(ramps, slopes, strict=True)
        ]

    if None in usual.values():  # ramps of few rows: their number gives the rate, and the rate gives the starts
        first = found()
        usual = {rises: rate_of([one for one in first if one.rises is rises]) for rises in usual}
    return found()


def _slope(ramp: Transition, t_s: Vector, scaling: Vector) -> tuple[float | None, float]:
    """Return the rate of a transition (None with too few rows), and its change over these rows."""
    first, last = ramp.first, ramp.last
    if ramp.before is None or ramp.after is None:  # at a turning point it may be constant for a moment
        first, last = first + (ramp.before is None), last - (ramp.after is None)
    if last - first + 1 <= RAMP_ROWS:
        return None, 0.0
    at, values = t_s[first : last + 1], scaling[first : last + 1]
    return abs(float(np.polyfit(at - at[0], values, 1)[0])), abs(float(values[-1] - values[0]))


def _change(
    ramp: Transition,
    slope: tuple[float | None, float],
    t_s: Vector,
    scaling: Vector,
    levels: Vector,
    usual: float | None,
    near: float,
) -> LevelChange:
    rate, change = slope
    begin_s = begin_of(ramp, t_s, scaling, levels, usual or rate)
    before, after, first, last = ramp.before, ramp.after, ramp.first, ramp.last
    step = -1 if before is None else before - (not ramp.rises)
    if before is None or after is None:
        return LevelChange(begin_s, step, ramp.rises, rate, change)
    rows = slice(max(first - 1, 0), last + 2)
    row_s = np.diff(t_s[rows])
    max_rate = float(np.abs(np.diff(scaling[rows]) / row_s).max()) if last >= first else None
    whole = abs(float(levels[after] - levels[before])) - 2 * near  # within that it is on a level
    gone = tuple(np.abs(scaling[first : last + 1] - levels[before]).tolist()) if rate is None else ()
    between_s = tuple(row_s.tolist()) if rate is None else ()
    return LevelChange(
        begin_s, step, ramp.rises, rate, whole, (last - first + 1) * median(row_s), max_rate, near, gone,
        between_s,
    )  # fmt: skip


def _usual(slopes: Sequence[tuple[float | None, float]]) -> float | None:
    """Return the usual rate, weighted by change; slower transitions, which paused midway, are excluded.

    Args:
        slopes: Rates, and the change at each.
    """
    chosen = [(rate, weight) for rate, weight in slopes if rate]
    if len(chosen) < MIN_RAMPS:
        return None
    rate, weight = np.array(chosen).T
    usual = _weighted_median(rate, weight)
    near = np.abs(rate - usual) <= 0.2 * usual
    return _weighted_median(rate[near], weight[near])


def _alike(rates: Sequence[float]) -> float | None:
    """Return the median of a few rates if they agree, else None."""
    middle = float(np.median(rates)) if len(rates) >= MIN_ALIKE else np.inf
    return middle if np.abs(np.array(rates) / middle - 1.0).max(initial=0.0) <= ALIKE and middle < np.inf else None


def _weighted_median(values: Vector, weight: Vector) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def rate_of(changes: Sequence[LevelChange]) -> float | None:
    """Return the rate of the ramps in one direction, 1/s; None if there are too few, or if the scaling jumps.

    The rate comes from slopes if ramps have enough rows, or if some have and agree with the rest. Otherwise, it comes
    from increments and cycles of the controller, or else from the number of rows between levels (`short_ramps`). If the
    log is synchronous with the safety system's cycle, that number is too low, and the rate is the fastest change from
    row to row.
    """
    whole = [change for change in changes if change.way_s is not None]
    sloped = [(change.rate_per_s, change.change) for change in changes if change.rate_per_s is not None]
    timed = [change for change in whole if (change.way_s or 0.0) <= SHORT_S]  # including those with a slope
    short = [change for change in timed if change.rate_per_s is None]
    slope = _usual(sloped)
    if sum(weight for _, weight in sloped) > 0.5 * sum(change.change for change in short):
        return slope
    fastest = [change.most_per_s for change in short if change.most_per_s is not None]
    if len(fastest) < max(MIN_RAMPS, JUMP_ROWS * len(short)):
        return None
    stride = stride_of([gone for change in short for gone in change.gone])
    counted = by_counts(timed, stride)
    slope = slope or _alike([rate for rate, _ in sloped]) or by_cycles(short, stride, counted)
    if slope is not None and abs(slope / counted - 1.0) <= _AGREE:
        return slope
    row_s = float(np.median([change.way_s for change in short if change.most_per_s is not None]))
    max_rate = float(np.quantile(fastest, 0.95))
    limited = max_rate * row_s > _WHOLE * float(np.median([change.change for change in short]))
    return counted if limited else min(counted, max_rate)


def error_of(changes: Sequence[LevelChange]) -> float | None:
    """Return the jackknife standard error of the rate in one direction (Efron 1982); None: too few changes."""
    groups = min(GROUPS, len(changes) // MIN_RAMPS)
    left_out = [[one for i, one in enumerate(changes) if i % groups != k] for k in range(groups)]
    rates = [rate for some in left_out if (rate := rate_of(some)) is not None]
    if groups < 3 or len(rates) < groups:
        return None
    return float(np.sqrt((groups - 1) * np.var(rates)))


@dataclass(frozen=True)
class Changes:
    """Changes of level of one session, and the positions of operator and TCP shortly before.

    Attributes:
        changes: All changes.
        positions: Positions before the changes for which they are known.
    """

    changes: list[LevelChange]
    positions: PositionsBeforeChanges

    @classmethod
    def of(
        cls,
        changes: Sequence[LevelChange],
        t_s: Vector,
        robot_m: Points,
        human_m: Points,
        max_changes: int = MAX_CHANGES,
    ) -> Changes:
        """Look up the positions before the changes of one session, for at most `max_changes` evenly spread ones.

        Args:
            changes: Changes in order of time.
            t_s: Times of samples, shape (N,), ascending, s.
            robot_m: TCP at these times, shape (N, 3), m; NaN = unknown.
            human_m: Operator at these times, shape (N, 3), likewise.
            max_changes: Maximum number of changes with positions.
        """
        with_level = [change for change in changes if change.step >= 0]
        chosen = with_level[:: max(1, -(-len(with_level) // max_changes))]
        change_kind = np.array([2 * change.step + change.rises for change in chosen], np.int64)
        begin_s = np.array([change.t_s for change in chosen])
        return cls(list(changes), PositionsBeforeChanges.before(begin_s, change_kind, t_s, robot_m, human_m))


def read_response(sessions: Sequence[Changes]) -> SafetyResponse:
    """Return the response of the safety system from the changes of level of all sessions."""
    changes = [change for mine in sessions for change in mine.changes]
    sorts = [[change for change in changes if change.rises is rises] for rises in (False, True)]
    (down, down_se), (up, up_se) = ((rate_of(mine), error_of(mine)) for mine in sorts)
    found = agreement_of([mine.positions for mine in sessions])
    spread_m = None if found is None else found.spread_m
    if found is None or found.latency_s is None:
        latency_s, hysteresis_m, hold_s = None, None, None
    else:
        latency_s, hysteresis_m = found.latency_s, found.hysteresis_m
        hold_s = (found.rising_s or 0.0) - (found.falling_s or 0.0) if found.held else None
    return SafetyResponse(latency_s, down, up, hysteresis_m, len(changes), spread_m, hold_s, down_se, up_se)


__all__ = [
    "LATENCIES_S", "Changes", "LevelChange", "SafetyResponse", "at_speed", "changes_of", "rate_of", "read_response",
]  # fmt: skip
