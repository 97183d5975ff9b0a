"""Times at which a robot arrived at a place and left it, to a few hundredths of a second.

The distance covered at the start of a jerk-limited motion grows with the cube of nominal time (the time that the path
would take at full speed), so at a quarter of full speed its first tenths of a second are lost in the noise of the
position. The visible part is extrapolated back: the cube root of the distance is linear in nominal time, and the motion
starts at its zero. A stop has no length in nominal time, so a robot that was stopped just after it left, or just before
it arrived, is handled too. Only if the stop is closer than the noise, the result is an interval instead of a time.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.segmentation.motion import RobotRun, lengths, median

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Place
    from cyclekit.schema import Bools, Ints, Points, Vector
    from cyclekit.segmentation.executions import Execution, Visit
    from cyclekit.segmentation.stored_run import Run


BEYOND_S = 1.0
"""Time before and after a standstill that is read, s."""
SMOOTH_S = 0.024
"""Averaging time of positions, s."""
REST_M = 1e-5
"""Maximum distance, m, from the resting position of a robot at rest; three times its jitter if that is larger."""
STILL_S = 0.1
"""Averaging time, s, to separate rest from a stop very close to it."""
REST_S = 0.2
"""Minimum time at a place, s, for it to be the resting position, even if the robot stops longer elsewhere."""
SEEN = 64.0
"""Range of the fit of the start of a motion: from the shortest visible distance to this multiple of it."""
SLOW = 0.05
"""Minimum scaling of the rows of that fit."""
BLOCKED = 1e-6
"""Maximum scaling of a stop."""
VAGUE_S, INFERRED_S = 0.004, 0.03
"""Uncertainty of the start of a motion in nominal time, s: with logged scaling, and with inferred scaling, in which the
ramp after a stop is unknown."""
_LONG_ROWS = 1 << 18


class PlaceStandstill(NamedTuple):
    """A standstill at a place, session seconds.

    Attributes:
        arrived_earliest_s, arrived_s: Bounds of the arrival; they differ if the safety system stopped the robot there.
        departed_earliest_s, left_s: Bounds of the departure, likewise.
        changes: Time of the last change of each logged signal that changed during the standstill.
        pauses: Times from and to which the program was paused or stopped, ascending.
    """

    arrived_earliest_s: float
    arrived_s: float
    departed_earliest_s: float
    left_s: float
    changes: tuple[tuple[str, float], ...] = ()
    pauses: tuple[tuple[float, float], ...] = ()

    @property
    def halted(self) -> bool:
        """Whether the robot was stopped as it arrived or left, so that only the bounds are known."""
        return self.left_s > self.departed_earliest_s or self.arrived_s > self.arrived_earliest_s

    @property
    def lasts_s(self) -> float:
        """Longest possible standstill, s."""
        return self.left_s - self.arrived_earliest_s

    def times(self, usual_s: float, ready_s: float | None = None) -> tuple[float, float]:
        """Return the times of arrival and departure, within their bounds as far apart as the usual process.

        Args:
            usual_s: Usual duration of the process.
            ready_s: End of the process, if a signal gives it.
        """
        if self.left_s > self.departed_earliest_s:
            over_s = self.after(self.arrived_earliest_s, usual_s) if ready_s is None else ready_s
            return self.arrived_earliest_s, min(max(over_s, self.departed_earliest_s), self.left_s)
        over_s = self.left_s if ready_s is None else min(ready_s, self.left_s)
        begun_s = over_s - usual_s
        for first_s, last_s in reversed(self.pauses):
            begun_s -= max(0.0, min(last_s, over_s) - first_s) if begun_s < last_s else 0.0
        return min(max(begun_s, self.arrived_earliest_s), self.arrived_s), self.left_s

    def after(self, start_s: float, lasts_s: float) -> float:
        """Return the end of a part of the process that began at `start_s` and takes `lasts_s` without pauses, s."""
        end_s = start_s + lasts_s
        for first_s, last_s in self.pauses:
            if start_s < last_s and first_s < end_s:
                end_s += last_s - max(first_s, start_s)
        return end_s


PlaceStandstills = dict[tuple[int, int, int], PlaceStandstill]
"""Standstills by run, first and last row."""


def place_standstills(
    runs: Mapping[int, Run] | Sequence[Run],
    executions: Sequence[Execution],
    places: Mapping[str, Place],
    known: PlaceStandstills | None = None,
) -> PlaceStandstills:
    """Return the times of arrival and departure at every visit of the executions; those `known` are kept."""
    found: PlaceStandstills = {}
    known = known or {}
    for execution in executions:
        for visit in execution.visits:
            key = (execution.run, visit.first, visit.last)
            if key in known:
                found[key] = known[key]
            elif key not in found:
                found[key] = standstill_at(runs[execution.run], visit, np.asarray(places[visit.place].xyz_m))
    return found


def unchanged(
    standstills: PlaceStandstills,
    runs: Mapping[int, Run] | Sequence[Run],
    rows: Mapping[int, Sequence[tuple[int, int]]],
) -> PlaceStandstills:
    """Return the standstills that do not depend on these rows of each run.

    Args:
        standstills: Standstills by run, first and last row.
        runs: The runs.
        rows: Rows whose scaling changes, by run: first and last row of each stretch, inclusive.
    """
    kept: PlaceStandstills = {}
    for (number, first, last), standstill in standstills.items():
        if spans := rows.get(number):
            before, after = _rows_around(runs[number], first, last)
            if any(begin <= after + 1 and end >= before for begin, end in spans):
                continue
        kept[number, first, last] = standstill
    return kept


def _rows_around(run: Run, first: int, last: int) -> tuple[int, int]:
    """Return the last rows at or before BEYOND_S before row `first` and BEYOND_S after row `last`."""
    ends = run.time_at(first) - BEYOND_S, run.time_at(last) + BEYOND_S
    before, after = run.row_at(np.array(ends)).tolist()
    return before, after


def standstill_at(run: Run, visit: Visit, place_m: Vector) -> PlaceStandstill:
    """Return the times of arrival and departure of one visit; of a standstill of many minutes, only its ends are read.

    Args:
        run: The run.
        visit: The rows without visible motion.
        place_m: The place, shape (3,), m.
    """
    first, last = visit.first, visit.last
    before, after = _rows_around(run, first, last)
    head = run.window(before, min(last, first + _LONG_ROWS // 2))
    tail = run.window(max(first, last - _LONG_ROWS // 2), min(after + 1, run.rows - 1))
    vague_s = INFERRED_S if run.is_inferred else VAGUE_S
    pauses = pauses_within(run, before, after)
    if not run.is_inferred:  # a paused robot is not allowed to move; inferred, a pause hides any stop beside it
        head, tail = _halted_in(pauses, head), _halted_in(pauses, tail)
    back = RobotRun(-head.t_s[::-1], head.xyz_m[::-1], head.speed_m_s[::-1], head.scaling[::-1])
    arrived, stopped = _left(back, head.rows - 1 - (first - before), place_m, vague_s)
    free, left = _left(tail, last - max(first, last - _LONG_ROWS // 2), place_m, vague_s)
    stopped, left = -stopped, max(left, -stopped)
    changes = ((name, _last(when, stopped, left)) for name, when in run.changes.items())
    told = tuple((name, at_s) for name, at_s in changes if at_s is not None)
    return PlaceStandstill(stopped, min(-arrived, left), max(free, stopped), left, told, pauses)


def pauses_within(run: Run, first: int, last: int) -> tuple[tuple[float, float], ...]:
    """Return the times from and to which the program was paused or stopped in rows `first` to `last`, ascending, s."""
    begin = bisect_left(run.halts, first, key=lambda halt: halt.last)
    end = bisect_right(run.halts, last, key=lambda halt: halt.first)
    return tuple((run.time_at(halt.first), run.time_at(halt.last) + run.period_s) for halt in run.halts[begin:end])


def _halted_in(pauses: Sequence[tuple[float, float]], part: RobotRun) -> RobotRun:
    """Return rows with a scaling of 0 in pauses."""
    scaling = part.scaling.copy()
    for first_s, last_s in pauses:
        scaling[(part.t_s >= first_s) & (part.t_s < last_s - 1e-9)] = 0.0
    return replace(part, scaling=scaling)


def _last(when: Vector, first_s: float, last_s: float) -> float | None:
    """Return the last of the times `when` (ascending) from `first_s` to `last_s`; None if there is none."""
    before = int(np.searchsorted(when, last_s, side="right"))
    return float(when[before - 1]) if before and when[before - 1] >= first_s else None


def _left(part: RobotRun, at: int, place_m: Vector, vague_s: float) -> tuple[float, float]:
    """Return the earliest and latest time of departure from a place; `at` is the last row of the standstill."""
    t_s, scaling = part.t_s, part.scaling
    period_s = max(median(t_s[1:] - t_s[:-1]), 1e-4) if len(t_s) > 1 else 1.0
    off, reach = _off(part, at, place_m, SMOOTH_S, period_s)
    wide, wide_reach = _off(part, at, place_m, STILL_S, period_s)  # separates a stop from a nearby resting position
    resting = np.flatnonzero(wide[: at + 1] <= wide_reach)
    rest = int(resting[-1]) if len(resting) else at
    half = max(1, round(0.5 * STILL_S / period_s))
    s = _known(scaling, wide, wide_reach, half)
    nominal = np.concatenate([[0.0], np.cumsum(s[:-1] * (t_s[1:] - t_s[:-1]))])
    seen = _seen(off, s, np.isnan(scaling) & (s == 0.0), reach, rest, half)
    still = np.flatnonzero(off[rest:] > reach)
    jumped = rest + (int(still[0]) - 1 if len(still) else 0) + (round(SMOOTH_S / period_s) | 1) // 2
    jumped = min(max(jumped, 0), len(nominal) - 1)  # in averages, a jump appears half their length earlier
    began = float(nominal[jumped])
    if len(seen) >= 3 and np.ptp(nominal[seen]) > 0.0:
        slope, level = np.polyfit(nominal[seen], np.cbrt(off[seen]), 1)
        if slope > 0.0:
            began = min(float(-level / slope), began)
    return _instant(t_s, nominal, (s <= BLOCKED) & (wide <= wide_reach), began, max(vague_s, 1.5 * period_s))


def _seen(off: Vector, s: Vector, midway: Bools, reach: float, rest: int, half: int) -> Ints:
    """Return the rows for the fit of the start of the motion; if enough, only those before a stop `midway`.

    An inferred scaling does not show the ramps around a stop, so the fit does not extend across one.
    """
    row = np.arange(rest + 1, len(off))
    far = row[off[row] >= SEEN * reach][:1]
    seen = row[(row < (far[0] if len(far) else len(off))) & (s[row] > SLOW) & (off[row] > reach)]
    halt = row[midway[row]][:1]
    before = seen[seen < halt[0] - half] if len(halt) else seen
    return before if len(before) >= 3 else seen


def _instant(t_s: Vector, nominal: Vector, halted: Bools, began: float, vague_s: float) -> tuple[float, float]:
    """Return start and end of the time at which nominal time was `began`: equal, unless rows are `halted` there.

    A ramp to the halt is part of it, as far as nominal time is within `vague_s` of `began`: the robot may have left on
    it, too slowly to be seen.
    """
    halt = np.flatnonzero(halted & (np.abs(nominal - began) <= vague_s))
    if len(halt):
        first = min(int(nominal.searchsorted(began - vague_s)), int(halt[0]))
        last = min(int(halt[-1]) + 1, len(t_s) - 1)
        return float(t_s[first]), float(t_s[last])
    rising = np.concatenate([[True], nominal[1:] > nominal[:-1]])
    when = float(np.interp(began, nominal[rising], t_s[rising]))
    return when, when


def _off(part: RobotRun, at: int, place_m: Vector, over_s: float, period_s: float) -> tuple[Vector, float]:
    """Return the averaged distance of each row from the resting position, and the tolerance of rest, m."""
    over = round(over_s / period_s) | 1
    smooth = _averaged(part.xyz_m, over)
    stood = smooth[: at + 1]
    jitter = median(lengths(stood[over:] - stood[:-over])) if at >= over else 0.0
    reach = max(REST_M, 3.0 * jitter)
    rest_m = _rest(stood, part.scaling[: at + 1], place_m, reach, round(REST_S / period_s))
    return lengths(smooth - rest_m), reach


def _averaged(xyz_m: Points, rows: int) -> Points:
    """Return the moving mean over `rows` rows (odd); over fewer at the ends."""
    half = min(rows // 2, (len(xyz_m) - 1) // 2)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(xyz_m - xyz_m[0], axis=0)])
    row = np.arange(len(xyz_m))
    reach = np.minimum(half, np.minimum(row, len(xyz_m) - 1 - row))
    return np.asarray(xyz_m[0] + (total[row + reach + 1] - total[row - reach]) / (2 * reach + 1)[:, None])


def _rest(xyz_m: Points, scaling: Vector, place_m: Vector, reach: float, enough: int) -> Vector:
    """Return the resting position of a robot that may have been stopped before it arrived or after it left.

    It is at the place, if at least `enough` rows are there; else the median position.
    """
    free = ~(scaling <= BLOCKED)  # unknown counts as free
    among = xyz_m[free] if free.any() else xyz_m
    distance = lengths(among - place_m)
    near = among[distance <= max(reach, 2.0 * float(distance.min()))]
    return np.asarray(np.median(near if len(near) >= min(enough, len(among)) else among, axis=0))


def _known(scaling: Vector, off: Vector, reach: float, half: int) -> Vector:
    """Return the scaling with unknown rows filled by the nearest known one; 0 where the robot is stopped midway."""
    known = np.flatnonzero(scaling > BLOCKED)  # scaling 0 is not extended to unknown rows
    if len(known) == len(scaling):
        return scaling
    s = fill_nearest(scaling, known) if len(known) else np.ones(len(scaling))
    s = np.where(scaling <= BLOCKED, 0.0, s)
    row = np.arange(len(s))
    moved = np.abs(off[np.minimum(row + half, len(s) - 1)] - off[np.maximum(row - half, 0)])
    return np.where(np.isnan(scaling) & (off > reach) & (moved < reach), 0.0, s)


def fill_nearest(s: Vector, known: Ints) -> Vector:
    """Return `s` (T,) with every unknown entry replaced by the nearest of the `known` ones (indices, ascending)."""
    row = np.arange(len(s))
    right = np.minimum(np.searchsorted(known, row), len(known) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.where(np.abs(known[left] - row) <= np.abs(known[right] - row), known[left], known[right])
    return np.asarray(s[nearer])
