"""Standstills at places that were halts: where people were while the robot stood, after its process or before it.

A scaling that was not logged says nothing while the robot stands at a place, and a wait looks like a halt. When levels
and people are known, both can be told apart: a robot that stood where people usually stop it, until they left, was
stopped by them. One that stood after its process, with nobody near, where that is seldom and no signal changed before
it left, was stopped as well: by a protective stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.derive.causes import lowest_usual
from cyclekit.derive.seen_slow import HALTED
from cyclekit.scaling.run_scaling import HALTED_S
from cyclekit.segmentation.time_account import paused_time

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from cyclekit.derive.causes import Evidence
    from cyclekit.derive.seen_slow import Rows
    from cyclekit.derive.session_samples import SessionToSample
    from cyclekit.schema import Bools, Vector
    from cyclekit.segmentation.arrivals import PlaceStandstill
    from cyclekit.segmentation.dwell import Dwell

GOES_S = 0.5
"""A robot that people stopped goes on within this time after they left."""
AWAY_S = 1.0
"""People who are away for no longer did not let the robot go on."""
MOST = 0.8
"""Of the time from arrival to the process, the part in which people must have stopped the robot."""
SELDOM, LEAST = 0.1, 20
"""A protective stop prolongs at most this part of the standstills at a place, of at least so many."""
SIGNAL_S = 0.5
"""A signal that changes within this time before the robot leaves may be what it waited for."""


class HaltAtPlace(NamedTuple):
    """From when to when a run was halted, session seconds."""

    run: int
    first_s: float
    last_s: float


class _Overdue(NamedTuple):
    """A standstill that goes on after the end of its process, which a signal told, with nobody near."""

    place: str
    halt: HaltAtPlace


def halts_told(
    sessions: Iterable[tuple[SessionToSample, Rows]], dwells: Mapping[str, Dwell], evidence: Evidence
) -> list[HaltAtPlace]:
    """Return when robots of inferred scaling were halted at places.

    Args:
        sessions: Those with samples, and these.
        dwells: The usual dwell at each place.
        evidence: What tells where people stop the robot.
    """
    if evidence.usual is None:
        return []
    halts, overdue, visits = list[HaltAtPlace](), list[_Overdue](), dict[str, int]()
    for work, mine in sessions:
        near = _Near(mine, lowest_usual(mine, evidence))
        for run, place, stand, first_s in _stood(work):
            visits[place] = visits.get(place, 0) + 1
            if paused_time(work.runs[run], first_s, stand.left_s) > 0.0:
                continue  # its process may have been paused
            found = _by_people(run, stand, first_s, dwells[place], near)
            halts += found
            if not found and (late := _overdue(run, stand, dwells[place], near)) is not None:
                overdue.append(_Overdue(place, late))
    for place in {one.place for one in overdue}:
        seldom = [one.halt for one in overdue if one.place == place]
        if len(seldom) <= SELDOM * max(visits[place], LEAST):
            halts += seldom
    return halts


def _stood(work: SessionToSample) -> Iterator[tuple[int, str, PlaceStandstill, float]]:
    """Yield run, place and stand of each standstill between two motions, and when the robot was last seen to move."""
    for execution in work.executions:
        run = work.runs[execution.run]
        for visit in execution.visits[1:-1] if run.is_inferred else ():
            stand = work.standstills[execution.run, visit.first, visit.last]
            if not stand.halted:  # else it is known
                yield execution.run, visit.place, stand, run.time_at(visit.first)


class _Near:
    """Where people were where they stop the robot."""

    def __init__(self, rows: Rows, lowest: Vector) -> None:
        self._t_s, self._known, self._near = rows.t_s, np.isfinite(lowest), lowest <= HALTED

    def during(self, first_s: float, last_s: float) -> tuple[Vector, Bools] | None:
        """Return the times of the samples within a time, and in which of them people were near; None where unknown."""
        part = slice(*np.searchsorted(self._t_s, [first_s, last_s]).tolist())
        if part.start == part.stop or not self._known[part].all():
            return None
        return self._t_s[part], self._near[part]


def _by_people(run: int, stand: PlaceStandstill, first_s: float, dwell: Dwell, near: _Near) -> list[HaltAtPlace]:
    """Return when people halted a robot that arrived at a place, or was about to leave it."""
    found = []
    since_s, ready_s = dwell.excess_from_s(stand), dwell.ready_s(stand)
    if since_s is not None and (during := near.during(since_s, stand.left_s)) is not None:
        begin_s = _until(*during, stand.left_s)
        if begin_s - since_s <= GOES_S:
            begin_s = since_s
        if stand.left_s - begin_s > HALTED_S:
            found.append(HaltAtPlace(run, begin_s, stand.left_s))
    if ready_s is not None:
        arrival_s = min(ready_s, stand.left_s) - dwell.usual_s
        during = near.during(stand.arrived_earliest_s, arrival_s)
        if arrival_s - stand.arrived_earliest_s > GOES_S and during is not None:
            begin_s = _until(*during, arrival_s)
            if begin_s - stand.arrived_earliest_s <= GOES_S and float(during[1].mean()) >= MOST:
                found.append(HaltAtPlace(run, min(first_s, stand.arrived_earliest_s), arrival_s))
    return found


def _until(t_s: Vector, near: Bools, end_s: float) -> float:
    """Return since when people were near, short absences aside; an end, where they had left GOES_S before it."""
    seen = t_s[near]
    if not len(seen) or end_s - seen[-1] > GOES_S:
        return end_s
    apart = np.flatnonzero(np.diff(seen) > AWAY_S)
    return float(seen[apart[-1] + 1] if len(apart) else seen[0])


def _overdue(run: int, stand: PlaceStandstill, dwell: Dwell, near: _Near) -> HaltAtPlace | None:
    """Return since when a robot stood after its process with nobody near; None where it did not, or that is unknown."""
    since_s, ready_s = dwell.excess_from_s(stand), dwell.ready_s(stand)
    if since_s is None or ready_s is None or stand.left_s - since_s <= HALTED_S:
        return None
    if any(stand.left_s - SIGNAL_S <= at_s for _, at_s in stand.changes):
        return None
    during = near.during(since_s, stand.left_s)
    return HaltAtPlace(run, since_s, stand.left_s) if during is not None else None


__all__ = ["HaltAtPlace", "halts_told"]
