"""Runs stored on disk in the Parquet table of a recording; reading of any run in pieces and at sample times."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from cyclekit.segmentation.motion import (
    LOG_GAP,
    NOT_LOGGED,
    PAUSED,
    STOPPED,
    InferredScaling,
    Overlay,
    ProgramStop,
    RobotRun,
    half_window,
    halted,
    moving_slider,
    slope,
)
from cyclekit.storage.prefetch import prefetch

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Ints, Points, Vector
    from cyclekit.storage.parquet import StoredTable


DENSE_S = 0.02
"""Maximum time, s, from a sample back to the log row that it snaps to."""
BLOCK_ROWS = 1 << 17
SHORT_ROWS = 1 << 14
"""Maximum number of rows of a run that is read as a whole and cached for successive windows."""


@dataclass(frozen=True, eq=False)
class StoredRun:
    """A run that stays on disk.

    Attributes:
        table: Table ROBOT of its recording, with COLUMNS.
        first, end: Its rows in the table, `end` excluded.
        offset_s: Session time of the log's time 0.
        period_s: Median time between rows.
        has_speed: Whether the TCP speed is logged in every row of the table.
        knows_scaling: Whether the scaling of any row is known.
        steps: First row of each block of the table and its time, as index to find the row of a time.
        more: Joint angles and slider of the same rows, as far as known; None = neither.
        halts: Rows in which the program was paused or stopped.
        inferred: Scaling that replaces the logged one; None = as logged.
        logged_apart: Whether that scaling was logged in a separate log, not inferred.
        changes: Times of changes of each logged signal, session seconds, ascending.
        set_override: Whether the logged scaling is the override that was set, and so a slider (`with_set_override`).
        hand: The slider that a hand set, if people move the logged one, which then counts as scaling: times from which
            a value holds, session time, s, and the values, shape (K,) each (`with_hand`).
    """

    table: StoredTable
    first: int
    end: int
    offset_s: float
    period_s: float
    has_speed: bool
    knows_scaling: bool
    steps: tuple[Ints, Vector]
    more: StoredTable | None = None
    halts: tuple[ProgramStop, ...] = ()
    inferred: Overlay | None = None
    logged_apart: bool = False
    changes: Mapping[str, Vector] = field(default_factory=dict)
    set_override: bool = False
    hand: tuple[Vector, Vector] | None = None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.end - self.first

    def window(self, first: int, last: int) -> RobotRun:
        """Return rows `first` to `last`, inclusive; read-only."""
        if self.rows > SHORT_ROWS:
            return self._window(first, last)
        return _whole(self).window(first, last)

    def _window(self, first: int, last: int) -> RobotRun:
        half = 0 if self.has_speed else half_window(self.period_s)
        begin, after = max(first - half, 0), min(last + 1 + half, self.rows)
        columns = self.table.read(self.first + begin, self.first + after)
        t_s = columns["t_s"] + self.offset_s
        xyz = np.column_stack([columns[f"tcp_{axis}_m"] for axis in "xyz"])
        speed = columns["tcp_speed_m_s"] if self.has_speed else slope(t_s, xyz, half)
        inside = slice(first - begin, last + 1 - begin)
        if self.inferred is not None:
            return RobotRun(t_s[inside], xyz[inside], speed[inside], *self.inferred.rows(first, last))
        slider, scaling = self.slider_at(first, last), columns["scaling"][inside]
        if self.hand is not None and self.table.unknown("scaling") == self.table.rows:
            logged = self._slider_as_logged(first, last)
            scaling = scaling if logged is None else logged
        if self.set_override:
            scaling = np.full(len(scaling), np.nan)
        elif slider is not None:
            scaling = np.clip(scaling / moving_slider(slider, len(slider)), 0.0, 1.0)
        return RobotRun(t_s[inside], xyz[inside], speed[inside], scaling)

    def slider_at(self, first: int, last: int) -> Vector | None:
        """Return the slider of rows `first` to `last`, shape (T,), NaN = unknown; None if it was not logged."""
        if self.set_override:
            return self.table.column("scaling", self.first + first, self.first + last + 1)
        if self.hand is None:
            return self._slider_as_logged(first, last)
        from_s, values = self.hand
        t_s = self.table.column("t_s", self.first + first, self.first + last + 1) + self.offset_s
        return np.asarray(values[np.searchsorted(from_s, t_s, side="right").clip(1) - 1])

    def _slider_as_logged(self, first: int, last: int) -> Vector | None:
        if self.more is None or "slider" not in self.more.columns:
            return None
        return self.more.column("slider", self.first + first, self.first + last + 1)

    @property
    def slider_range(self) -> tuple[float, float] | None:
        """Least and largest value of the logged slider; None if it was not logged."""
        blocks = (
            self._slider_as_logged(at, min(at + BLOCK_ROWS, self.rows) - 1) for at in range(0, self.rows, BLOCK_ROWS)
        )
        known = [block[np.isfinite(block)] for block in blocks if block is not None]
        ends = [(float(block.min()), float(block.max())) for block in known if len(block)]
        return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else None

    @property
    def is_inferred(self) -> bool:
        """Whether its scaling was inferred, not logged."""
        return self.inferred is not None and not self.logged_apart

    def posture(self, first: int, last: int) -> tuple[Points, Vector]:
        """Return joint angles (else TCP) of rows `first` to `last`, (T, D), and the slider, (T,), 1 if not logged."""
        slider = moving_slider(self.slider_at(first, last), last + 1 - first)
        joints = [name for name in self.more.columns if name != "slider"] if self.more is not None else []
        if self.more is None or not joints:
            return self.window(first, last).xyz_m, slider
        columns = self.more.read(self.first + first, self.first + last + 1)
        return np.column_stack([columns[name] for name in joints]), slider

    def time_at(self, row: int) -> float:
        """Return the session time of a row, s."""
        return float(self.table.column("t_s", self.first + row, self.first + row + 1)[0]) + self.offset_s

    def row_at(self, t_s: Vector) -> Ints:
        """Return the last row at or before each time (to a nanosecond), shape (N,); 0 if there is none."""
        rows, times = self.steps
        if len(rows) == 1:
            return self._last_before(t_s, 0, self.rows)
        found = np.zeros(len(t_s), np.int64)
        step = np.clip(np.searchsorted(times, t_s + 1e-9, side="right") - 1, 0, None)
        for number in np.unique(step).tolist():
            last = int(rows[number + 1]) if number + 1 < len(rows) else self.rows
            here = step == number
            found[here] = self._last_before(t_s[here], int(rows[number]), last)
        return found

    def _last_before(self, t_s: Vector, first: int, end: int) -> Ints:
        """Return the result of `row_at` within rows `first` to `end` - 1."""
        times_there = self.table.column("t_s", self.first + first, self.first + end)
        before = times_there.searchsorted(t_s - self.offset_s + 1e-9, side="right") - 1
        return np.asarray(first + np.maximum(before, 0))

    def with_scaling(self, parts: Sequence[InferredScaling], *, logged_apart: bool = False) -> StoredRun:
        """Return the run with its scaling replaced by `parts`; unknown (NaN) elsewhere."""
        kept = Overlay(parts)
        return replace(self, inferred=kept, knows_scaling=kept.is_known, logged_apart=logged_apart)

    def with_set_override(self) -> StoredRun:
        """Return the run with its logged scaling as the operator's slider, and the scaling unknown."""
        return replace(self, set_override=True, knows_scaling=False)

    def with_hand(self, from_s: Vector, values: Vector) -> StoredRun:
        """Return the run with its logged slider as part of the scaling, and a hand's slider beside it; see `hand`."""
        return replace(self, hand=(from_s, values), knows_scaling=True)

    def with_halts(self, spans_s: Sequence[tuple[float, float]]) -> StoredRun:
        """Return a run of inferred scaling with a scaling of 0 in some times, session seconds."""
        if self.inferred is None:
            return self
        rows = [self.row_at(np.array(span)).tolist() for span in spans_s]
        return replace(self, inferred=self.inferred.with_parts([halted(first, last) for first, last in rows]))


Run: TypeAlias = RobotRun | StoredRun
"""One stretch of a robot log without gaps, in memory or in a file."""


@lru_cache(maxsize=4)
def _whole(run: StoredRun) -> RobotRun:
    return run._window(0, run.rows - 1)


def runs_of(
    table: StoredTable,
    offset_s: float,
    *,
    gap_s: float,
    more: StoredTable | None = None,
    states: Sequence[tuple[int, int, str]] = (),
) -> list[StoredRun]:
    """Return the runs of a log, split where its clock jumps ahead by more than `gap_s` or goes back.

    Args:
        table: Table ROBOT of its recording, with COLUMNS.
        offset_s: Session time of the log's time 0.
        gap_s: Maximum gap within a run; infinite = one run, unless the clock goes back.
        more: The same table with joint angles and slider, as far as known.
        states: Parts in which the program does not play, in order: first and last row of the table, and the state.
    """
    cuts, groups, times, before, periods = [0], list[int](), list[float](), np.nan, []
    for begin, end in table.groups:
        t = table.column("t_s", begin, end)
        between = np.diff(t, prepend=before)
        cuts += (begin + np.flatnonzero((between > gap_s) | (between <= 0))).tolist()
        groups.append(begin)
        times.append(float(t[0]))
        periods.append(np.median(between[1:]) if len(between) > 1 else np.nan)
        before = t[-1]
    known = [float(period) for period in periods if np.isfinite(period)]
    period_s = float(np.median(known)) if known else 0.1
    has_speed = table.unknown("tcp_speed_m_s") == 0
    logged = table.unknown("scaling") < table.rows
    lasts = [last for _, last, _ in states]
    found = []
    for first, end in pairwise([*cuts, table.rows]):
        if end <= first:
            continue
        inside = slice(bisect_right(groups, first), bisect_left(groups, end))
        start = float(table.column("t_s", first, first + 1)[0])
        steps = (np.array([first, *groups[inside]]) - first, np.array([start, *times[inside]]) + offset_s)
        halts = tuple(
            ProgramStop(max(a - first, 0), min(b, end - 1) - first, PAUSED if state == "paused" else STOPPED)
            for a, b, state in states[bisect_left(lasts, first) : bisect_left(states, (end,))]
        )
        found.append(StoredRun(table, first, end, offset_s, period_s, has_speed, logged, steps, more, halts))
    return found


def pieces(run: Run, first: int = 0, last: int | None = None, *, overlap: int = 0) -> Iterator[tuple[int, RobotRun]]:
    """Yield rows `first` to `last` of a run in blocks, each with its first row; the next is read in the background.

    Args:
        run: The run.
        first: First row.
        last: Last row, inclusive; None = last row of the run.
        overlap: Number of rows that a block shares with the one before.
    """
    last = run.rows - 1 if last is None else last
    blocks = _pieces(run, first, last, overlap)
    return prefetch(blocks) if last - first >= BLOCK_ROWS else blocks


def _pieces(run: Run, first: int, last: int, overlap: int) -> Iterator[tuple[int, RobotRun]]:
    begin = first
    while begin <= last:
        after = min(begin + BLOCK_ROWS - 1, last)
        yield begin, run.window(begin, after)
        if after == last:
            return
        begin = after + 1 - overlap


@dataclass(frozen=True)
class Sampled:
    """A run at N times.

    Attributes:
        t_s: The times, shape (N,), snapped to rows of the log that are close enough.
        xyz_m: TCP, shape (N, 3), m; NaN in a gap of the log.
        scaling: The safety system's scaling, shape (N,); NaN = unknown.
        deviation: Its standard deviation, shape (N,); NaN = unknown.
        gap: Reason for an unknown scaling, shape (N,), indices into SCALING_GAPS.
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
    """Return a run at some times, ascending: TCP by linear interpolation, scaling of the last row.

    Neither extends across a gap of the log. A time snaps to the row before it if that is less than DENSE_S ago: the
    scaling of a row belongs to its position, and a TCP at 1 m/s moves 8 mm in one controller cycle, which at the edge
    of a zone may mean another level.
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
