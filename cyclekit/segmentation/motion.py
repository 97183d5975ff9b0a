"""A robot's log as runs that are read window by window.

A run is one continuous stretch. Whoever reads motion asks for the rows that matter (a stand, a task, an execution) and
never for all of them, so a log of any length takes the memory of its longest task. Runs that stay on the disk are in
`stored_run`; what the motion means is the business of `stops` and `segment`.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from cyclekit.storage.ahead import ahead

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Ints, Points, Vector
    from cyclekit.segmentation.stored_run import StoredRun

    Run: TypeAlias = "RobotRun | StoredRun"
    """One continuous stretch of a robot log, in memory or in a file."""


SPEED_WINDOW_S = 0.024
"""Speed is the slope of the position over three controller cycles at 125 Hz: at 500 Hz the position's resolution would
dominate a quotient of differences."""
DENSE_S = 0.02
"""Samples snap to log rows closer than this, s."""
BLOCK_ROWS = 1 << 17
COLUMNS = ("t_s", "tcp_x_m", "tcp_y_m", "tcp_z_m", "tcp_speed_m_s", "scaling")
"""Columns of table ROBOT that a run is made of."""
STANDING, PAUSED, STOPPED, NOT_LOGGED, NO_REFERENCE, NEVER_FULL, OTHER_PATH, TOO_SLOW, LOG_GAP = range(9)
"""Why a scaling is unknown: indices into `schema.SCALING_GAPS`."""


class InferredScaling(NamedTuple):
    """Scaling of consecutive rows of a run, inferred.

    Attributes:
        first: First row.
        scaling: Values, shape (N,), NaN = unknown.
        deviation: Their standard deviations, shape (N,).
        gap: Why they are unknown where they are, shape (N,), indices into SCALING_GAPS.
    """

    first: int
    scaling: NDArray[np.floating[Any]]
    deviation: NDArray[np.floating[Any]]
    gap: NDArray[np.int8]


@dataclass(frozen=True)
class Halt:
    """The program of the robot did not run in rows `first` to `last`, inclusive; `gap`: PAUSED or STOPPED."""

    first: int
    last: int
    gap: int


@dataclass(frozen=True)
class RobotRun:
    """A run, or a window of one, in memory.

    Attributes:
        t_s: Session time, shape (T,), strictly increasing, seconds.
        xyz_m: TCP, shape (T, 3), metres.
        speed_m_s: TCP speed, shape (T,), m/s.
        scaling: The safety system's scaling, shape (T,), NaN = unknown.
        deviation: Its standard deviation, shape (T,); None = 0, it was logged.
        gap: Why it is unknown, shape (T,), where it is; None = it was not logged there.
        q_rad: Joint angles, shape (T, J), if known.
        slider: The operator's speed slider, shape (T,); None = not logged.
        halts: When the program was paused or stopped.
        is_inferred: The scaling was inferred and not logged.
        changes: When each logged signal changed, session seconds, ascending; a window has none.
    """

    t_s: Vector
    xyz_m: Points
    speed_m_s: Vector
    scaling: Vector
    deviation: Vector | None = None
    gap: NDArray[np.int8] | None = None
    q_rad: Points | None = None
    slider: Vector | None = None
    halts: tuple[Halt, ...] = ()
    is_inferred: bool = False
    changes: Mapping[str, Vector] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """How many rows it has."""
        return len(self.t_s)

    @property
    def period_s(self) -> float:
        """Usual time between rows."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.1

    @property
    def knows_scaling(self) -> bool:
        """Whether the scaling of any row is known."""
        return bool(np.isfinite(self.scaling).any())

    def window(self, first: int, last: int) -> RobotRun:
        """Return rows `first` to `last`, inclusive: views, no copies."""
        part = slice(first, last + 1)
        deviation = None if self.deviation is None else self.deviation[part]
        gap = None if self.gap is None else self.gap[part]
        return RobotRun(self.t_s[part], self.xyz_m[part], self.speed_m_s[part], self.scaling[part], deviation, gap)

    def posture(self, first: int, last: int) -> tuple[Points, Vector]:
        """Return joint angles (else TCP) of rows `first` to `last`, (T, D), and the slider, (T,), 1 if not logged."""
        part = slice(first, last + 1)
        points = (self.xyz_m if self.q_rad is None else self.q_rad)[part]
        return points, moving_slider(self.slider_at(first, last), len(points))

    def slider_at(self, first: int, last: int) -> Vector | None:
        """Return the slider of rows `first` to `last`, shape (T,), NaN = unknown; None where it was not logged."""
        return None if self.slider is None else self.slider[first : last + 1]

    def time_at(self, row: int) -> float:
        """Return the session time of a row, seconds."""
        return float(self.t_s[row])

    def row_at(self, t_s: Vector) -> Ints:
        """Return the last row at or before each time (to a nanosecond), shape (N,); 0 where there is none."""
        return np.clip(np.searchsorted(self.t_s, t_s + 1e-9, side="right") - 1, 0, None)

    def with_scaling(self, parts: Sequence[InferredScaling]) -> RobotRun:
        """Return the run with scaling replaced from each first row on; unknown (NaN) elsewhere."""
        scaling, deviation, gap = Overlay(parts).rows(0, self.rows - 1)
        return replace(self, scaling=scaling, deviation=deviation, gap=gap, is_inferred=True)


def moving_slider(slider: Vector | None, rows: int) -> Vector:
    """Return the slider of some rows as a factor of the speed; 1 where it is zero or unknown."""
    return np.ones(rows) if slider is None else np.where(slider > 0.0, slider, 1.0)


class Overlay:
    """Inferred scaling of a run, in parts, to be read by windows."""

    def __init__(self, parts: Sequence[InferredScaling]) -> None:
        """Keep the parts; of two that overlap the one that begins later wins."""
        self._parts = sorted(parts, key=lambda part: part.first)
        self._begins = [part.first for part in self._parts]
        self._longest = max((len(part.scaling) for part in self._parts), default=0)
        self.is_known = any(np.isfinite(part.scaling).any() for part in self._parts)

    def rows(self, first: int, last: int) -> tuple[Vector, Vector, NDArray[np.int8]]:
        """Return scaling, deviation and gap of rows `first` to `last`; where there is no part, the robot stands."""
        scaling, deviation = np.full(last + 1 - first, np.nan), np.full(last + 1 - first, np.nan)
        gap = np.full(last + 1 - first, STANDING, np.int8)
        near = slice(bisect_left(self._begins, first - self._longest), bisect_left(self._begins, last + 1))
        for part in self._parts[near]:
            a, b = max(first, part.first), min(last + 1, part.first + len(part.scaling))
            if a < b:
                here, there = slice(a - first, b - first), slice(a - part.first, b - part.first)
                scaling[here], deviation[here], gap[here] = part.scaling[there], part.deviation[there], part.gap[there]
        return scaling, deviation, gap


def pieces(run: Run, first: int = 0, last: int | None = None, *, overlap: int = 0) -> Iterator[tuple[int, RobotRun]]:
    """Return rows `first` to `last` of a run, a block at a time, each with its first row; the next is read meanwhile.

    Args:
        run: The run.
        first: First row.
        last: Last row, inclusive; None = that of the run.
        overlap: Ints that a block has in common with the one before it.
    """
    last = run.rows - 1 if last is None else last
    blocks = _pieces(run, first, last, overlap)
    return ahead(blocks) if last - first >= BLOCK_ROWS else blocks


def _pieces(run: Run, first: int, last: int, overlap: int) -> Iterator[tuple[int, RobotRun]]:
    begin = first
    while begin <= last:
        after = min(begin + BLOCK_ROWS - 1, last)
        yield begin, run.window(begin, after)
        if after == last:
            return
        begin = after + 1 - overlap


def half_window(period_s: float) -> int:
    """Return how many rows before and behind a row its speed is taken over."""
    return max(1, round(SPEED_WINDOW_S / 2 / period_s))


def lengths(ways_m: Points) -> Vector:
    """Return the lengths of vectors, shape (N, D); as numpy's norm, without its overhead."""
    return np.asarray(np.sqrt(np.add.reduce(ways_m * ways_m, axis=1)))


def slope(t_s: Vector, xyz_m: Points, half: int) -> Vector:
    """Return the distance from `half` rows before each row to `half` rows after it over the time between, (T,)."""
    row = np.arange(len(t_s))
    after, before = np.minimum(row + half, len(t_s) - 1), np.maximum(row - half, 0)
    path = lengths(xyz_m[after] - xyz_m[before])
    return np.asarray(path / np.maximum(t_s[after] - t_s[before], 1e-9))


@dataclass(frozen=True)
class Sampled:
    """A run at N times.

    Attributes:
        t_s: The times, shape (N,); those of rows where the log has them dense enough.
        xyz_m: TCP, shape (N, 3); NaN in a gap of the log.
        scaling: The safety system's scaling in force, shape (N,); NaN = unknown.
        deviation: Its standard deviation, shape (N,); NaN = unknown.
        gap: Why it is unknown, shape (N,), where it is: indices into SCALING_GAPS.
        slider: The operator's speed slider, shape (N,); NaN = not logged.
        row: Row at or before each time, shape (N,).
    """

    t_s: Vector
    xyz_m: Points
    scaling: Vector
    deviation: Vector
    gap: NDArray[np.int8]
    slider: Vector
    row: Ints


def sampled(run: Run, t_s: Vector) -> Sampled:
    """Return a run at some times, ascending: TCP by linear interpolation, scaling as the value in force.

    Neither looks across a gap of the log. A time is moved back to the row before it where that is less than DENSE_S
    ago: the scaling of a row belongs to the positions at that row, and a TCP at 1 m/s is 8 mm farther one controller
    cycle later, which at the edge of a zone is another level.
    """
    at_once = max(1, int(BLOCK_ROWS * run.period_s * len(t_s) / max(t_s[-1] - t_s[0], 1e-9))) if len(t_s) else 1
    parts = [_sampled(run, t_s[begin : begin + at_once]) for begin in range(0, len(t_s), at_once)]
    if not parts:
        none = np.empty(0)
        return Sampled(none, np.empty((0, 3)), none, none, none.astype(np.int8), none, none.astype(np.int64))
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Sampled(*(np.concatenate(column) for column in columns))


def _sampled(run: Run, t_s: Vector) -> Sampled:
    row = run.row_at(t_s)
    first = int(row[0])
    part = run.window(first, min(int(row[-1]) + 1, run.rows - 1))
    here = row - first
    back = t_s - part.t_s[here]
    t = np.where(back < DENSE_S, part.t_s[here], t_s)
    after = np.minimum(here + 1, part.rows - 1)
    gap = part.t_s[after] - part.t_s[here] > max(0.1, 5 * run.period_s)
    xyz = np.column_stack([np.interp(t, part.t_s, part.xyz_m[:, axis]) for axis in range(3)])
    xyz[gap] = np.nan
    scaling = np.where(gap, np.nan, part.scaling[here])
    known = np.zeros(len(t)) if part.deviation is None else part.deviation[here]
    why = np.full(len(t), NOT_LOGGED, np.int8) if part.gap is None else part.gap[here].copy()
    for halt in run.halts:
        why[(row >= halt.first) & (row <= halt.last)] = halt.gap
    why[gap] = LOG_GAP
    slider = run.slider_at(first, first + part.rows - 1)
    slider = np.full(len(t), np.nan) if slider is None else slider[here]
    return Sampled(t, xyz, scaling, np.where(np.isnan(scaling), np.nan, known), why, slider, row)
