"""Finds stops by people and protective stops in standstills at places, if the scaling was not logged.

An inferred scaling is unknown while the robot stands at a place, so a wait and a stop look the same. Once levels and
people are known they differ: a robot that stood while people were where they usually stop it, until they left, was
stopped by them. A robot that stood after its process with nobody near, which is rare at that place, and left without a
change of a signal, had a protective stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.derive.causes.cause_samples import HALTED
from cyclekit.derive.causes.causes import usual_scaling
from cyclekit.scaling.run_scaling import HALTED_S
from cyclekit.segmentation.time_account import paused_time

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from cyclekit.derive.causes.cause_samples import Rows
    from cyclekit.derive.causes.causes import Evidence
    from cyclekit.derive.second_pass import SessionToSample
    from cyclekit.schema import Bools, Vector
    from cyclekit.segmentation.arrivals import PlaceStandstill
    from cyclekit.segmentation.dwell import Dwell

MAX_RESTART_S = 0.5
"""Maximum time, s, from the departure of people to the restart of the robot they stopped."""
MAX_ABSENCE_S = 1.0
"""Maximum absence of people, s, that does not let the robot restart."""
MIN_NEAR_SHARE = 0.8
"""Minimum share of the time from arrival to process in which people stop the robot."""
MAX_STOP_SHARE, MIN_STANDSTILLS = 0.1, 20
"""Maximum share of standstills at a place with a protective stop; minimum number of standstills for the share."""
MAX_AFTER_SIGNAL_S = 0.5
"""Maximum time, s, from the change of a signal to the departure of a robot that waited for it."""


class StopAtPlace(NamedTuple):
    """Start and end of a stop in a run, session seconds."""

    run: int
    first_s: float
    last_s: float


class _Overdue(NamedTuple):
    """A standstill that continues with nobody near after the signal that ends its process."""

    place: str
    stop: StopAtPlace


def stops_at_places(
    sessions: Iterable[tuple[SessionToSample, Rows]], dwells: Mapping[str, Dwell], evidence: Evidence
) -> list[StopAtPlace]:
    """Return the stops at places of robots with inferred scaling.

    Args:
        sessions: Sessions with their samples.
        dwells: Usual dwell at each place.
        evidence: Positions at which people usually stop the robot.
    """
    if evidence.usual is None:
        return []
    stops, overdue, visits = list[StopAtPlace](), list[_Overdue](), dict[str, int]()
    for session, rows in sessions:
        near = _Near(rows, usual_scaling(rows, evidence))
        for run, place, standstill, first_s, dwell in _standstills_of(session, dwells):
            visits[place] = visits.get(place, 0) + 1
            if paused_time(session.runs[run], first_s, standstill.left_s) > 0.0:
                continue  # its process may have been paused
            found = _by_people(run, standstill, first_s, dwell, near)
            stops += found
            if not found and (late := _overdue(run, standstill, dwell, near)) is not None:
                overdue.append(_Overdue(place, late))
    for place in {one.place for one in overdue}:
        seldom = [one.stop for one in overdue if one.place == place]
        if len(seldom) <= MAX_STOP_SHARE * max(visits[place], MIN_STANDSTILLS):
            stops += seldom
    return stops


def _standstills_of(
    session: SessionToSample, dwells: Mapping[str, Dwell]
) -> Iterator[tuple[int, str, PlaceStandstill, float, Dwell]]:
    """Yield run, place, standstill between two motions, last time of visible motion before it, s, and the dwell."""
    for execution in session.executions:
        run = session.runs[execution.run]
        for visit in execution.visits[1:-1] if run.is_inferred else ():
            standstill = session.standstills[execution.run, visit.first, visit.last]
            if not standstill.halted:  # otherwise it is a known stop
                dwell = dwells[visit.place].of(execution)
                yield execution.run, visit.place, standstill, run.time_at(visit.first), dwell


class _Near:
    """Times at which people were where they usually stop the robot."""

    def __init__(self, rows: Rows, lowest: Vector) -> None:
        self._t_s, self._known, self._near = rows.t_s, np.isfinite(lowest), lowest <= HALTED

    def during(self, first_s: float, last_s: float) -> tuple[Vector, Bools] | None:
        """Return the sample times in a period and whether people were near at each; None if unknown."""
        part = slice(*np.searchsorted(self._t_s, [first_s, last_s]).tolist())
        if part.start == part.stop or not self._known[part].all():
            return None
        return self._t_s[part], self._near[part]


def _by_people(run: int, standstill: PlaceStandstill, first_s: float, dwell: Dwell, near: _Near) -> list[StopAtPlace]:
    """Return the stops by people just before the arrival at a place and just before the departure."""
    found = []
    since_s, ready_s = dwell.excess_from_s(standstill), dwell.ready_s(standstill)
    if since_s is not None and (during := near.during(since_s, standstill.left_s)) is not None:
        begin_s = _until(*during, standstill.left_s)
        if begin_s - since_s <= MAX_RESTART_S:
            begin_s = since_s
        if standstill.left_s - begin_s > HALTED_S:
            found.append(StopAtPlace(run, begin_s, standstill.left_s))
    if ready_s is not None:
        arrival_s = min(ready_s, standstill.left_s) - dwell.usual_s
        during = near.during(standstill.arrived_earliest_s, arrival_s)
        if arrival_s - standstill.arrived_earliest_s > MAX_RESTART_S and during is not None:
            begin_s = _until(*during, arrival_s)
            if begin_s - standstill.arrived_earliest_s <= MAX_RESTART_S and float(during[1].mean()) >= MIN_NEAR_SHARE:
                found.append(StopAtPlace(run, min(first_s, standstill.arrived_earliest_s), arrival_s))
    return found


def _until(t_s: Vector, near: Bools, end_s: float) -> float:
    """Return the time since which people were near, ignoring short absences; `end_s` if they left earlier."""
    seen = t_s[near]
    if not len(seen) or end_s - seen[-1] > MAX_RESTART_S:
        return end_s
    apart = np.flatnonzero(np.diff(seen) > MAX_ABSENCE_S)
    return float(seen[apart[-1] + 1] if len(apart) else seen[0])


def _overdue(run: int, standstill: PlaceStandstill, dwell: Dwell, near: _Near) -> StopAtPlace | None:
    """Return the standstill after the process with nobody near; None if there is none, or people are unknown."""
    since_s, ready_s = dwell.excess_from_s(standstill), dwell.ready_s(standstill)
    if since_s is None or ready_s is None or standstill.left_s - since_s <= HALTED_S:
        return None
    if any(standstill.left_s - MAX_AFTER_SIGNAL_S <= at_s for _, at_s in standstill.changes):
        return None
    during = near.during(since_s, standstill.left_s)
    return StopAtPlace(run, since_s, standstill.left_s) if during is not None else None


__all__ = ["StopAtPlace", "stops_at_places"]
