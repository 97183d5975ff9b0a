"""A robot's log as runs that are read window by window: short logs from memory, long ones from Parquet.

A run is one continuous stretch. Whoever reads motion asks for the rows that matter (a stand, a task, an execution) and
never for all of them, so a log of any length takes the memory of its longest task. What the motion means is the
business of `segment`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.tables import StoredTable

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]
    Rows = NDArray[np.int64]

SPEED_WINDOW_S = 0.024
"""Speed is the slope of the position over three controller cycles at 125 Hz: at 500 Hz the position's resolution would
dominate a quotient of differences."""
DENSE_S = 0.02
"""Samples stand on rows of the log where those lie nearer than this."""
BLOCK_ROWS = 1 << 17
COLUMNS = ("t_s", "tcp_x_m", "tcp_y_m", "tcp_z_m", "tcp_speed_m_s", "scaling")
"""Columns of table ROBOT that a run is made of."""


class Run(Protocol):
    """One continuous stretch of a robot log."""

    @property
    def rows(self) -> int:
        """How many rows it has."""
        ...

    @property
    def period_s(self) -> float:
        """Usual time between rows."""
        ...

    @property
    def knows_scaling(self) -> bool:
        """Whether the scaling of any row is known."""
        ...

    def window(self, first: int, last: int) -> RobotRun:
        """Return rows `first` to `last`, inclusive."""
        ...

    def time_at(self, row: int) -> float:
        """Return the session time of a row, seconds."""
        ...

    def row_at(self, t_s: Vector) -> Rows:
        """Return the last row at or before each time, shape (N,); 0 where there is none."""
        ...

    def with_scaling(self, parts: Sequence[tuple[int, Vector]]) -> Run:
        """Return the run with scaling replaced from each first row on; unknown (NaN) elsewhere."""
        ...


@dataclass(frozen=True)
class RobotRun:
    """A run, or a window of one, in memory.

    Attributes:
        t_s: Session time, shape (T,), strictly increasing, seconds.
        xyz_m: TCP, shape (T, 3), metres.
        speed_m_s: TCP speed, shape (T,), m/s.
        scaling: Shape (T,), NaN = unknown.
    """

    t_s: Vector
    xyz_m: Points
    speed_m_s: Vector
    scaling: Vector

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
        return RobotRun(self.t_s[part], self.xyz_m[part], self.speed_m_s[part], self.scaling[part])

    def time_at(self, row: int) -> float:
        """Return the session time of a row, seconds."""
        return float(self.t_s[row])

    def row_at(self, t_s: Vector) -> Rows:
        """Return the last row at or before each time (to a nanosecond), shape (N,); 0 where there is none."""
        return np.clip(np.searchsorted(self.t_s, t_s + 1e-9, side="right") - 1, 0, None)

    def with_scaling(self, parts: Sequence[tuple[int, Vector]]) -> RobotRun:
        """Return the run with scaling replaced from each first row on; unknown (NaN) elsewhere."""
        scaling = np.full(self.rows, np.nan)
        for first, values in parts:
            scaling[first : first + len(values)] = values
        return replace(self, scaling=scaling)


@dataclass(frozen=True)
class StoredRun:
    """A run that stays on the disk.

    Attributes:
        table: Table ROBOT of its recording, with COLUMNS.
        first, end: Its rows of the table: from `first` to before `end`.
        offset_s: Session time of the log's time 0.
        period_s: Usual time between rows.
        has_speed: The TCP speed is logged in every row of the table.
        knows_scaling: Whether the scaling of any row is known.
        steps: Rows of the run, every BLOCK_ROWS-th, and the times there: where to look for a time.
        inferred: Scaling in place of the logged one, from each first row on; None = as logged.
    """

    table: StoredTable
    first: int
    end: int
    offset_s: float
    period_s: float
    has_speed: bool
    knows_scaling: bool
    steps: tuple[Rows, Vector]
    inferred: tuple[tuple[int, NDArray[np.float32]], ...] | None = None

    @property
    def rows(self) -> int:
        """How many rows it has."""
        return self.end - self.first

    def window(self, first: int, last: int) -> RobotRun:
        """Return rows `first` to `last`, inclusive."""
        half = 0 if self.has_speed else half_window(self.period_s)
        begin, after = max(first - half, 0), min(last + 1 + half, self.rows)
        columns = self.table.read(self.first + begin, self.first + after)
        t_s = columns["t_s"] + self.offset_s
        xyz = np.column_stack([columns[f"tcp_{axis}_m"] for axis in "xyz"])
        speed = columns["tcp_speed_m_s"] if self.has_speed else slope(t_s, xyz, half)
        inside = slice(first - begin, last + 1 - begin)
        scaling = columns["scaling"][inside] if self.inferred is None else self._inferred(first, last)
        return RobotRun(t_s[inside], xyz[inside], speed[inside], scaling)

    def _inferred(self, first: int, last: int) -> Vector:
        values = np.full(last + 1 - first, np.nan)
        for begin, part in self.inferred or ():
            a, b = max(first, begin), min(last + 1, begin + len(part))
            if a < b:
                values[a - first : b - first] = part[a - begin : b - begin]
        return values

    def time_at(self, row: int) -> float:
        """Return the session time of a row, seconds."""
        return float(self.table.read(self.first + row, self.first + row + 1)["t_s"][0]) + self.offset_s

    def row_at(self, t_s: Vector) -> Rows:
        """Return the last row at or before each time (to a nanosecond), shape (N,); 0 where there is none."""
        rows, times = self.steps
        found = np.zeros(len(t_s), np.int64)
        step = np.clip(np.searchsorted(times, t_s + 1e-9, side="right") - 1, 0, None)
        for number in np.unique(step).tolist():
            last = int(rows[number + 1]) if number + 1 < len(rows) else self.rows
            here = step == number
            found[here] = rows[number] + self.window(int(rows[number]), last - 1).row_at(t_s[here])
        return found

    def with_scaling(self, parts: Sequence[tuple[int, Vector]]) -> StoredRun:
        """Return the run with scaling replaced from each first row on; unknown (NaN) elsewhere."""
        kept = tuple((first, np.asarray(values, np.float32)) for first, values in sorted(parts, key=lambda p: p[0]))
        return replace(self, inferred=kept, knows_scaling=any(np.isfinite(values).any() for _, values in kept))


def pieces(run: Run, first: int = 0, last: int | None = None, *, overlap: int = 0) -> Iterator[tuple[int, RobotRun]]:
    """Yield rows `first` to `last` of a run, a block at a time, each with its first row.

    Args:
        run: The run.
        first: First row.
        last: Last row, inclusive; None = that of the run.
        overlap: Rows that a block has in common with the one before it.
    """
    last = run.rows - 1 if last is None else last
    begin = first
    while begin <= last:
        after = min(begin + BLOCK_ROWS - 1, last)
        yield begin, run.window(begin, after)
        if after == last:
            return
        begin = after + 1 - overlap


def runs_of(table: StoredTable, offset_s: float, *, gap_s: float) -> list[StoredRun]:
    """Return the continuous stretches of a log: split where its clock jumps ahead by more than `gap_s` or goes back.

    Args:
        table: Table ROBOT of its recording, with COLUMNS.
        offset_s: Session time of the log's time 0.
        gap_s: Longest silence within a run; infinite = one run, unless the clock goes back.
    """
    cuts, firsts, before, periods = [0], list[tuple[int, float]](), np.nan, []
    for begin, end in table.groups:
        t = table.read(begin, end)["t_s"]
        between = np.diff(t, prepend=before)
        cuts += (begin + np.flatnonzero((between > gap_s) | (between <= 0))).tolist()
        firsts.append((begin, float(t[0])))
        periods.append(np.median(between[1:]) if len(between) > 1 else np.nan)
        before = t[-1]
    known = [float(period) for period in periods if np.isfinite(period)]
    period_s = float(np.median(known)) if known else 0.1
    has_speed = table.unknown("tcp_speed_m_s") == 0
    logged = table.unknown("scaling") < table.rows
    found = []
    for first, end in pairwise([*cuts, table.rows]):
        if end <= first:
            continue
        inside = [(begin - first, t) for begin, t in firsts if first < begin < end]
        start = float(table.read(first, first + 1)["t_s"][0])
        rows, times = zip((0, start), *inside, strict=True)
        steps = (np.array(rows, np.int64), np.array(times) + offset_s)
        found.append(StoredRun(table, first, end, offset_s, period_s, has_speed, logged, steps))
    return found


def half_window(period_s: float) -> int:
    """Return how many rows before and behind a row its speed is taken over."""
    return max(1, round(SPEED_WINDOW_S / 2 / period_s))


def tcp_speed(t_s: Vector, xyz_m: Points) -> Vector:
    """Return the TCP speed, m/s, shape (T,), as the slope of the position over SPEED_WINDOW_S around each row."""
    if len(t_s) < 3:
        return np.zeros(len(t_s))
    return slope(t_s, xyz_m, half_window(float(np.median(np.diff(t_s)))))


def slope(t_s: Vector, xyz_m: Points, half: int) -> Vector:
    """Return the length of the way from `half` rows before each row to `half` rows behind it over its time, (T,)."""
    row = np.arange(len(t_s))
    after, before = np.minimum(row + half, len(t_s) - 1), np.maximum(row - half, 0)
    path = np.linalg.norm(xyz_m[after] - xyz_m[before], axis=1)
    return np.asarray(path / np.maximum(t_s[after] - t_s[before], 1e-9))


@dataclass(frozen=True)
class Sampled:
    """A run at N times.

    Attributes:
        t_s: The times, shape (N,); those of rows where the log has them dense enough.
        xyz_m: TCP, shape (N, 3); NaN in a gap of the log.
        scaling: Value in force, shape (N,); NaN = unknown.
        row: Row at or before each time, shape (N,).
    """

    t_s: Vector
    xyz_m: Points
    scaling: Vector
    row: Rows


def sampled(run: Run, t_s: Vector) -> Sampled:
    """Return a run at some times, ascending: TCP by linear interpolation, scaling as the value in force.

    Neither looks across a gap of the log. A time is moved back to the row before it where that is less than DENSE_S
    ago: the scaling of a row belongs to the positions at that row, and a TCP at 1 m/s is 8 mm farther one controller
    cycle later, which at the edge of a zone is another level.
    """
    at_once = max(1, int(BLOCK_ROWS * run.period_s * len(t_s) / max(t_s[-1] - t_s[0], 1e-9))) if len(t_s) else 1
    parts = [_sampled(run, t_s[begin : begin + at_once]) for begin in range(0, len(t_s), at_once)]
    if not parts:
        return Sampled(np.empty(0), np.empty((0, 3)), np.empty(0), np.empty(0, np.int64))
    columns = zip(*((part.t_s, part.xyz_m, part.scaling, part.row) for part in parts), strict=True)
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
    return Sampled(t, xyz, np.where(gap, np.nan, part.scaling[here]), row)
