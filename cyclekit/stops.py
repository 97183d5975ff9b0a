"""Where and when a robot stands: its standstills, told from the noise of its own position.

A robot program moves from place to place and stands there while the gripper works. A safety halt stands too, but
somewhere along the way, and only while the scaling is zero. Which standstills are at a place is the business of
`places`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.motion import pieces

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit.motion import Run

    Vector = NDArray[np.float64]

MIN_STOP_S = 0.15
"""A standstill shorter than this is no stop: the reversal of a path takes one or two controller cycles."""
TWITCH_S, TWITCH_M = 0.1, 2e-4
"""A motion that is over within this time and leads no farther than this is noise of the position."""
CRAWL_M_S = 3e-3
"""A robot faster than this moves."""
_CRAWLS = 2_000_000  # speeds that its noise is told from
_PLACES = 20_000  # positions that the place of a stand is told from
FREE_S = 0.1
"""So much nominal time: a dwell of MIN_STOP_S without its edges."""
EDGE_S = 0.03
"""Scaling at the edges of a standstill is not judged: speed follows the scaling a few controller cycles later."""


@dataclass(frozen=True)
class Stop:
    """A standstill of one run, rows `first`..`last` inclusive.

    Attributes:
        free: Scaling was above zero while it stood; None = scaling unknown.
        edge: The run begins or ends here without a standstill: the recorder was switched while the robot just left
            or just arrived. It can be a visit to a place, it cannot make one.
        changes: How often logged signals changed while it stood, those that did.
    """

    run: int
    first: int
    last: int
    xyz_m: tuple[float, float, float]
    free: bool | None
    edge: bool = False
    changes: Mapping[str, int] = field(default_factory=dict)


def standing(run: Run) -> float:
    """Return the speed below which the robot stands, m/s: slower than the noise of its own standstill allows to see.

    It is four times the median speed below CRAWL_M_S, between 0.1 mm/s and CRAWL_M_S: low, because a motion that starts
    jerk-limited is slow for its first milliseconds.
    """
    thin = max(1, run.rows // _CRAWLS)
    crawls = [part.speed_m_s[part.speed_m_s < CRAWL_M_S][::thin] for _, part in pieces(run)]
    crawl = np.concatenate([*crawls, np.empty(0)])
    noise = float(np.median(crawl)) if len(crawl) else 0.0
    return min(max(4.0 * noise, 1e-4), CRAWL_M_S)


def find_stops(run: Run, number: int) -> list[Stop]:
    """Return the standstills of a run of at least MIN_STOP_S and its two edges, in order."""
    stops, times = [], []
    for stand in _stands(run, standing(run)):
        short = stand.last_s - stand.first_s < MIN_STOP_S
        if short and stand.first != 0 and stand.last != run.rows - 1:
            continue
        x, y, z = _resting_place(run, stand.first, stand.last)
        stops.append(Stop(number, stand.first, stand.last, (x, y, z), _free(run, stand), short))
        times.append((stand.first_s, stand.last_s))
    return _with_changes(run, stops, np.array(times).reshape(-1, 2))


def _with_changes(run: Run, stops: list[Stop], times_s: NDArray[np.float64]) -> list[Stop]:
    """Return the stops with how often each signal changed from the first to the last time (N, 2) of each."""
    found: list[dict[str, int]] = [{} for _ in stops]
    for name, when in run.changes.items():
        many = np.searchsorted(when, times_s[:, 1], side="right") - np.searchsorted(when, times_s[:, 0])
        for i in np.flatnonzero(many).tolist():
            found[i][name] = int(many[i])
    return [replace(stop, changes=mine) if mine else stop for stop, mine in zip(stops, found, strict=True)]


@dataclass
class _Stand:
    """Rows `first`..`last` in which a robot is slow, with the times and places of both."""

    first: int
    last: int
    first_s: float
    last_s: float
    first_m: Vector
    last_m: Vector


def _stands(run: Run, slow_m_s: float) -> list[_Stand]:
    """Return every standstill; a twitch of the measurement does not end one."""
    found: list[_Stand] = []
    for begin, part in pieces(run):
        still = part.speed_m_s < slow_m_s
        if begin == 0:
            still[0] = True
        if begin + part.rows == run.rows:
            still[-1] = True
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        for a, b in edges.reshape(-1, 2).tolist():
            since, until = float(part.t_s[a]), float(part.t_s[b - 1])
            here = _Stand(begin + a, begin + b - 1, since, until, part.xyz_m[a], part.xyz_m[b - 1])
            if found and (found[-1].last + 1 == here.first or _is_twitch(found[-1], here)):
                found[-1].last, found[-1].last_s, found[-1].last_m = here.last, here.last_s, here.last_m
            else:
                found.append(here)
    return found


def _is_twitch(before: _Stand, after: _Stand) -> bool:
    brief = after.first_s - before.last_s < TWITCH_S
    return bool(brief and np.linalg.norm(after.first_m - before.last_m) < TWITCH_M)


def _resting_place(run: Run, first: int, last: int) -> tuple[float, float, float]:
    """Return the median position of a stand; of a long one that of every so many rows."""
    places = [part.xyz_m[:: max(1, (last - first) // _PLACES)] for _, part in pieces(run, first, last)]
    x, y, z = np.median(np.concatenate(places), axis=0)
    return float(x), float(y), float(z)


def _free(run: Run, stand: _Stand) -> bool | None:
    """Tell whether the robot was allowed to move while it stood, None if that is unknown.

    So where its program would have gone on by FREE_S meanwhile. In less it need not have been seen to move: while
    the safety system lets go, the scaling is above zero for a while before the motion is fast enough to be told from
    noise, most of all where the path itself is slow.
    """
    known, nominal_s = False, 0.0
    for _, part in pieces(run, stand.first, stand.last):
        inside = np.isfinite(part.scaling)
        inside &= (part.t_s > stand.first_s + EDGE_S) & (part.t_s < stand.last_s - EDGE_S)
        known = known or bool(inside.any())
        step_s = np.diff(part.t_s, append=part.t_s[-1:])
        nominal_s += float((part.scaling[inside] * step_s[inside]).sum())
    return nominal_s >= FREE_S if known else None
