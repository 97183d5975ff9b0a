"""Standstills of the robot: positions and times.

Two steps: speed selects the parts in which the robot may be at standstill, and the distance covered decides
(`slow_motion`). A program stops at places for its process; a protective stop can occur anywhere, and only while the
scaling is zero. `places` decides which standstills are at a place.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.segmentation.motion import half_window, lengths
from cyclekit.segmentation.slow_motion import AXES, MIN_STOP_S, Stillness, quantum_of, stillness_of
from cyclekit.segmentation.stored_run import Run, pieces

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.schema import Floats, Vector


TWITCH_S, TWITCH_M = 0.1, 2e-4
"""Maximum duration, s (or TWITCH_ROWS if longer), and distance, m, of apparent motion that is only position noise."""
TWITCH_ROWS = 4
CRAWL_M_S = 3e-3
"""Maximum speed, m/s, at which the robot may be at standstill; the distance covered decides (see `Stillness`)."""
APART_S = 0.5
"""Maximum time, s, between slow parts at one position that are joined: noise may split them."""
_CRAWLS = 2_000_000  # maximum number of speeds from which their noise is computed
_PLACES = 20_000  # maximum number of positions from which the place of a standstill is computed
FREE_S = 0.1
"""Nominal time, s, of a dwell of MIN_STOP_S without its edges."""
EDGE_S = 0.03
"""Time at both ends of a standstill, s, in which the scaling is ignored: speed follows it a few controller cycles
later."""


@dataclass(frozen=True)
class Standstill:
    """A standstill of one run, rows `first`..`last` inclusive.

    Attributes:
        free: Whether the scaling was above zero during the standstill; None = scaling unknown.
        edge: Whether the run begins or ends here without a standstill: recording started or stopped as the robot left
            or arrived. An edge can be a visit to a place but cannot establish one.
        changes: Number of changes of each logged signal that changed during the standstill.
    """

    run: int
    first: int
    last: int
    xyz_m: tuple[float, float, float]
    free: bool | None
    edge: bool = False
    changes: Mapping[str, int] = field(default_factory=dict)


def standing(run: Run) -> float:
    """Return the speed below which the robot may be at standstill, m/s; noise hides slower motion.

    It is four times the median of the speeds below CRAWL_M_S, limited to 0.1 mm/s to CRAWL_M_S: low, because a
    jerk-limited motion is slow for its first milliseconds. If positions have a quantum, it is at least AXES quanta per
    speed window, which a robot at standstill between two values shows.
    """
    thin = max(1, run.rows // _CRAWLS)
    crawls, steps = [np.empty(0)], [np.empty(0)]
    for _, part in pieces(run):
        slow = part.speed_m_s < CRAWL_M_S
        crawls.append(part.speed_m_s[slow][::thin])
        steps.append(lengths(np.diff(part.xyz_m, axis=0))[slow[1:] | slow[:-1]][::thin])
    crawl = np.concatenate(crawls)
    noise = float(np.median(crawl)) if len(crawl) else 0.0
    step = min(quantum_of(np.concatenate(steps)), TWITCH_M)
    over_s = 2 * half_window(run.period_s) * run.period_s
    return max(min(max(4.0 * noise, 1e-4), CRAWL_M_S), AXES * step / over_s)


def find_standstills(run: Run, number: int) -> list[Standstill]:
    """Return the standstills of a run of at least MIN_STOP_S and its two edges, in order."""
    stops, times = [], []
    slow = _slow_parts(run, standing(run))
    for still in _standstills(run, slow, stillness_of(run, [(one.first, one.last) for one in slow])):
        short = still.last_s - still.first_s < MIN_STOP_S
        if short and still.first != 0 and still.last != run.rows - 1:
            continue
        x, y, z = _resting_place(run, still.first, still.last)
        stops.append(Standstill(number, still.first, still.last, (x, y, z), _free(run, still), short))
        times.append((still.first_s, still.last_s))
    return _with_changes(run, stops, np.array(times).reshape(-1, 2))


def _with_changes(run: Run, stops: list[Standstill], times_s: Floats) -> list[Standstill]:
    """Return the standstills with the number of changes of each signal between their start and end times (N, 2)."""
    found: list[dict[str, int]] = [{} for _ in stops]
    for name, when in run.changes.items():
        many = np.searchsorted(when, times_s[:, 1], side="right") - np.searchsorted(when, times_s[:, 0])
        for i in np.flatnonzero(many).tolist():
            found[i][name] = int(many[i])
    return [replace(stop, changes=mine) if mine else stop for stop, mine in zip(stops, found, strict=True)]


@dataclass
class _SlowPart:
    """Rows `first`..`last` in which a robot is slow, with times and positions of both."""

    first: int
    last: int
    first_s: float
    last_s: float
    first_m: Vector
    last_m: Vector


def _slow_parts(run: Run, slow_m_s: float) -> list[_SlowPart]:
    """Return every slow part; apparent motion by position noise does not end one."""
    found: list[_SlowPart] = []
    for begin, part in pieces(run):
        still = part.speed_m_s < slow_m_s
        if begin == 0:
            still[0] = True
        if begin + part.rows == run.rows:
            still[-1] = True
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        for a, b in edges.reshape(-1, 2).tolist():
            since, until = float(part.t_s[a]), float(part.t_s[b - 1])
            here = _SlowPart(begin + a, begin + b - 1, since, until, part.xyz_m[a], part.xyz_m[b - 1])
            if found and (found[-1].last + 1 == here.first or _is_twitch(found[-1], here, run.period_s)):
                found[-1] = _both(found[-1], here)
            else:
                found.append(here)
    return found


def _standstills(run: Run, slow: list[_SlowPart], stillness: Stillness) -> list[_SlowPart]:
    """Return the standstills within the slow parts; the edges of the run are kept, even as a single row."""
    found: list[_SlowPart] = []
    for one in _joined(run, slow, stillness, APART_S):
        still = stillness.stretches(run, one.first, one.last, one.last_s - one.first_s)
        ends = [row for row in {0, run.rows - 1} if one.first <= row <= one.last]
        kept = still + [(row, row) for row in ends if not any(a <= row <= b for a, b in still)]
        found += [one if (a, b) == (one.first, one.last) else _slow_part(run, a, b) for a, b in sorted(kept)]
    return _joined(run, found, stillness, stillness.within_s)


def _joined(run: Run, parts: list[_SlowPart], stillness: Stillness, apart_s: float) -> list[_SlowPart]:
    """Return the parts in order; parts less than `apart_s` apart without motion between them are joined."""
    found: list[_SlowPart] = []
    for one in parts:
        brief = bool(found) and one.first_s - found[-1].last_s < apart_s
        there = brief and np.linalg.norm(one.first_m - found[-1].last_m) <= stillness.reach_m
        if found and (there or _is_twitch(found[-1], one, run.period_s)):
            found[-1] = _both(found[-1], one)
        else:
            found.append(one)
    return found


def _both(before: _SlowPart, after: _SlowPart) -> _SlowPart:
    return replace(before, last=after.last, last_s=after.last_s, last_m=after.last_m)


def _slow_part(run: Run, first: int, last: int) -> _SlowPart:
    """Return rows `first` to `last` with times and positions of both."""
    a, b = run.window(first, first), run.window(last, last)
    return _SlowPart(first, last, float(a.t_s[0]), float(b.t_s[0]), a.xyz_m[0], b.xyz_m[0])


def _is_twitch(before: _SlowPart, after: _SlowPart, period_s: float) -> bool:
    brief = after.first_s - before.last_s < max(TWITCH_S, TWITCH_ROWS * period_s)
    return bool(brief and np.linalg.norm(after.first_m - before.last_m) < TWITCH_M)


def _resting_place(run: Run, first: int, last: int) -> tuple[float, float, float]:
    """Return the median position of a standstill, m; of a long one, from every n-th row."""
    places = [part.xyz_m[:: max(1, (last - first) // _PLACES)] for _, part in pieces(run, first, last)]
    x, y, z = np.median(np.concatenate(places), axis=0)
    return float(x), float(y), float(z)


def _free(run: Run, still: _SlowPart) -> bool | None:
    """Return whether the robot was allowed to move during a standstill; None if unknown.

    It was if the program could have advanced by FREE_S of nominal time. Less is not sufficient: when the safety system
    releases the robot, the scaling is above zero for a while before the motion exceeds the noise, in particular on a
    slow path.
    """
    known, nominal_s = False, 0.0
    for _, part in pieces(run, still.first, still.last):
        inside = np.isfinite(part.scaling)
        inside &= (part.t_s > still.first_s + EDGE_S) & (part.t_s < still.last_s - EDGE_S)
        known = known or bool(inside.any())
        step_s = np.diff(part.t_s, append=part.t_s[-1:])
        nominal_s += float((part.scaling[inside] * step_s[inside]).sum())
    return nominal_s >= FREE_S if known else None
