"""A robot's log as runs that are read window by window.

A run is one stretch without gaps. Motion is read only for the rows needed (a standstill, a task, an execution), so a
log of any length takes the memory of its longest task. `stored_run` has the runs that stay on the disk, and reads any
run in pieces and at sample times.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Ints, Points, Vector


SPEED_WINDOW_S = 0.024
"""Time over which speed is computed from positions, s: three controller cycles at 125 Hz. At 500 Hz, the resolution of
the position would dominate the difference of two rows."""
COLUMNS = ("t_s", "tcp_x_m", "tcp_y_m", "tcp_z_m", "tcp_speed_m_s", "scaling")
"""Columns of table ROBOT that a run needs."""
STANDING, PAUSED, STOPPED, NOT_LOGGED, NO_REFERENCE, NEVER_FULL, OTHER_PATH, TOO_SLOW, LOG_GAP = range(9)
"""Reasons for an unknown scaling: indices into `schema.SCALING_GAPS`."""
_FEW = 500
"""Maximum number of values whose median is found faster by sorting them."""


class InferredScaling(NamedTuple):
    """Inferred scaling of consecutive rows of a run.

    Attributes:
        first: First row.
        scaling: Values, shape (N,), NaN = unknown.
        deviation: Their standard deviations, shape (N,).
        gap: Reason for unknown values, shape (N,), indices into SCALING_GAPS.
    """

    first: int
    scaling: NDArray[np.floating[Any]]
    deviation: NDArray[np.floating[Any]]
    gap: NDArray[np.int8]


@dataclass(frozen=True)
class ProgramStop:
    """Rows `first` to `last`, inclusive, in which the program did not run; `gap`: PAUSED or STOPPED."""

    first: int
    last: int
    gap: int


@dataclass(frozen=True)
class RobotRun:
    """A run, or a window of one, in memory.

    Attributes:
        t_s: Session time, shape (T,), strictly increasing, s.
        xyz_m: TCP, shape (T, 3), m.
        speed_m_s: TCP speed, shape (T,), m/s.
        scaling: The safety system's scaling, shape (T,), NaN = unknown.
        deviation: Its standard deviation, shape (T,); None = 0, as it was logged.
        gap: Reason for an unknown scaling, shape (T,); None = not logged.
        q_rad: Joint angles, shape (T, J), if known.
        slider: The operator's speed slider, shape (T,); None = not logged.
        halts: Rows in which the program was paused or stopped.
        is_inferred: Whether the scaling was inferred, not logged.
        changes: Times of changes of each logged signal, session seconds, ascending; a window has none.
    """

    t_s: Vector
    xyz_m: Points
    speed_m_s: Vector
    scaling: Vector
    deviation: Vector | None = None
    gap: NDArray[np.int8] | None = None
    q_rad: Points | None = None
    slider: Vector | None = None
    halts: tuple[ProgramStop, ...] = ()
    is_inferred: bool = False
    changes: Mapping[str, Vector] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.t_s)

    @property
    def period_s(self) -> float:
        """Median time between rows, s."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.1

    @property
    def knows_scaling(self) -> bool:
        """Whether the scaling of any row is known."""
        return bool(np.isfinite(self.scaling).any())

    def window(self, first: int, last: int) -> RobotRun:
        """Return rows `first` to `last`, inclusive, as views."""
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
        """Return the slider of rows `first` to `last`, shape (T,), NaN = unknown; None if it was not logged."""
        return None if self.slider is None else self.slider[first : last + 1]

    def time_at(self, row: int) -> float:
        """Return the session time of a row, s."""
        return float(self.t_s[row])

    def row_at(self, t_s: Vector) -> Ints:
        """Return the last row at or before each time (to a nanosecond), shape (N,); 0 if there is none."""
        return np.clip(np.searchsorted(self.t_s, t_s + 1e-9, side="right") - 1, 0, None)

    def with_scaling(self, parts: Sequence[InferredScaling], *, logged_apart: bool = False) -> RobotRun:
        """Return the run with its scaling replaced by `parts`; unknown (NaN) elsewhere.

        Args:
            parts: The scaling.
            logged_apart: Whether it was logged in a separate log, not inferred.
        """
        scaling, deviation, gap = Overlay(parts).rows(0, self.rows - 1)
        return replace(self, scaling=scaling, deviation=deviation, gap=gap, is_inferred=not logged_apart)

    def with_set_override(self) -> RobotRun:
        """Return the run with its logged scaling as the operator's slider, and the scaling unknown."""
        return replace(self, scaling=np.full(self.rows, np.nan), slider=self.scaling)

    def with_halts(self, spans_s: Sequence[tuple[float, float]]) -> RobotRun:
        """Return a run of inferred scaling with a scaling of 0 in some times, session seconds."""
        deviation = np.full(self.rows, np.nan) if self.deviation is None else self.deviation
        gap = np.zeros(self.rows, np.int8) if self.gap is None else self.gap
        whole = InferredScaling(0, self.scaling, deviation, gap)
        rows = [self.row_at(np.array(span)).tolist() for span in spans_s]
        return self.with_scaling([whole, *(halted(first, last) for first, last in rows)])


def halted(first: int, last: int) -> InferredScaling:
    """Return a scaling of 0 in rows `first` to `last`."""
    none = np.zeros(last + 1 - first)
    return InferredScaling(first, none, none, none.astype(np.int8))


def moving_slider(slider: Vector | None, rows: int) -> Vector:
    """Return the slider of some rows as a factor of the speed; 1 if it is zero or unknown."""
    return np.ones(rows) if slider is None else np.where(slider > 0.0, slider, 1.0)


class Overlay:
    """Inferred scaling of a run, in parts, readable by row ranges."""

    def __init__(self, parts: Sequence[InferredScaling]) -> None:
        """Take the parts; where two overlap, the one that starts later counts."""
        self._parts = sorted(parts, key=lambda part: part.first)
        self._begins = [part.first for part in self._parts]
        self._longest = max((len(part.scaling) for part in self._parts), default=0)
        self.is_known = any(np.isfinite(part.scaling).any() for part in self._parts)

    def with_parts(self, parts: Sequence[InferredScaling]) -> Overlay:
        """Return these and more parts."""
        return Overlay([*self._parts, *parts])

    def rows(self, first: int, last: int) -> tuple[Vector, Vector, NDArray[np.int8]]:
        """Return scaling, deviation and gap of rows `first` to `last`; rows without a part are standstills."""
        scaling, deviation = np.full(last + 1 - first, np.nan), np.full(last + 1 - first, np.nan)
        gap = np.full(last + 1 - first, STANDING, np.int8)
        near = slice(bisect_left(self._begins, first - self._longest), bisect_left(self._begins, last + 1))
        for part in self._parts[near]:
            a, b = max(first, part.first), min(last + 1, part.first + len(part.scaling))
            if a < b:
                here, there = slice(a - first, b - first), slice(a - part.first, b - part.first)
                scaling[here], deviation[here], gap[here] = part.scaling[there], part.deviation[there], part.gap[there]
        return scaling, deviation, gap


def half_window(period_s: float) -> int:
    """Return the number of rows before and after a row over which its speed is computed."""
    return max(1, round(SPEED_WINDOW_S / 2 / period_s))


def lengths(ways_m: Points) -> Vector:
    """Return the lengths (N,) of vectors (N, D); as numpy's norm, without its overhead."""
    return np.asarray(np.sqrt(np.add.reduce(ways_m * ways_m, axis=1)))


def median(values: Vector) -> float:
    """Return the median of values (N,), N > 0; NaN if one is unknown. As numpy's, without its overhead."""
    if len(values) > _FEW:
        return float(np.median(values))
    ordered, half = np.sort(values), len(values) // 2
    if np.isnan(ordered[-1]):
        return float("nan")
    middle = ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2
    return float(middle + 0.0)  # numpy gives 0 for -0


def slope(t_s: Vector, xyz_m: Points, half: int) -> Vector:
    """Return the distance from `half` rows before to `half` rows after each row, divided by time, (T,), m/s."""
    row = np.arange(len(t_s))
    after, before = np.minimum(row + half, len(t_s) - 1), np.maximum(row - half, 0)
    path = lengths(xyz_m[after] - xyz_m[before])
    return np.asarray(path / np.maximum(t_s[after] - t_s[before], 1e-9))
