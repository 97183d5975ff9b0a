"""What the robot of all sessions did: places, executions, speed scaling, and usual dwells."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards import note
from cyclekit.derive.second_pass import SessionToSample
from cyclekit.scaling.run_scaling import with_scaling
from cyclekit.scaling.set_override import MIN_SLOW, never_changes, slow_share
from cyclekit.segmentation.arrivals import PlaceStandstills, place_standstills, unchanged
from cyclekit.segmentation.dwell import Dwell, usual_dwells
from cyclekit.segmentation.executions import Execution, find_executions, find_visits
from cyclekit.segmentation.places import find_places, with_turns
from cyclekit.segmentation.standstills import find_standstills
from cyclekit.segmentation.waits import with_waits
from cyclekit.storage.parquet import keeping

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import Cell
    from cyclekit.dataset.cards import Note
    from cyclekit.dataset.dataset import Place
    from cyclekit.dataset.sessions import Session
    from cyclekit.derive.causes.stops_at_places import StopAtPlace
    from cyclekit.derive.first_pass import FirstPassResult
    from cyclekit.derive.over_sessions import Passes
    from cyclekit.parallel.engine import Engine
    from cyclekit.schema import Ints, Progress
    from cyclekit.segmentation.standstills import Standstill
    from cyclekit.segmentation.stored_run import Run

MANY_EXECUTIONS, ONCE = 10, 3
"""Minimum number of executions, and of places found in just one of them, for a note."""
KEPT_BYTES = 160 << 20
"""Cache of decoded rows while the scaling is inferred: the fastest repetitions of a motion are all over the log."""


def numbered(results: Sequence[FirstPassResult]) -> list[Session]:
    """Return the sessions, each with the indices of its runs in the list of all runs."""
    sessions: list[Session] = []
    count = 0
    for result in results:
        sessions.append(replace(result.session, runs=tuple(range(count, count + len(result.runs)))))
        count += len(result.runs)
    return sessions


class RobotInSessions(NamedTuple):
    """Runs, places and executions of the robot in all sessions.

    Attributes:
        runs: All runs; a session has the indices of its own.
        places: All places.
        executions: Executions of each run, in order of time.
        warnings: Notes on the scaling and the places.
        known: Standstills at places that are already known for these runs.
    """

    runs: Sequence[Run]
    places: Mapping[str, Place]
    executions: Sequence[Sequence[Execution]]
    warnings: list[Note]
    known: PlaceStandstills

    def with_stops(self, stops: Sequence[StopAtPlace], known: PlaceStandstills) -> RobotInSessions:
        """Return the same with runs halted at some times; `known`: the standstills without these stops."""
        spans: dict[int, list[tuple[float, float]]] = {}
        for stop in stops:
            spans.setdefault(stop.run, []).append((stop.first_s, stop.last_s))
        runs = [run.with_halts(spans[n]) if n in spans else run for n, run in enumerate(self.runs)]
        rows = {n: [tuple(self.runs[n].row_at(np.array(span)).tolist()) for span in mine] for n, mine in spans.items()}
        return self._replace(runs=runs, known=unchanged(known, self.runs, rows))


def robot_of(
    results: Sequence[FirstPassResult], sessions: Sequence[Session], cell: Cell, engine: Engine, progress: Progress
) -> RobotInSessions:
    """Find places and executions in all sessions, and the scaling where it was not logged."""
    runs: list[Run] = []
    standstills: list[Standstill] = []
    for result in results:
        standstills += [replace(stop, run=stop.run + len(runs)) for stop in result.standstills]
        runs += result.runs
    find = partial(_robot, results=results, sessions=sessions, cell=cell, engine=engine)
    if never_changes([runs[number] for session in sessions if not session.reference for number in session.runs]):
        silent = [run.with_set_override() for run in runs]
        stops = [stop for number, run in enumerate(silent) for stop in find_standstills(run, number)]
        robot = find(silent, stops, progress=lambda done, told: progress(0.5 * done, told))
        if (share := slow_share(robot.runs)) >= MIN_SLOW:
            return robot._replace(warnings=[note("scaling-constant", share=share), *robot.warnings])
    return find(runs, standstills, progress=progress)


def _robot(
    runs: list[Run],
    standstills: list[Standstill],
    *,
    results: Sequence[FirstPassResult],
    sessions: Sequence[Session],
    cell: Cell,
    engine: Engine,
    progress: Progress,
) -> RobotInSessions:
    """Find the same in runs with their standstills."""
    marks = [marks for result in results for marks in result.marks]
    places, executions = _divided(runs, standstills, marks, cell)
    with keeping(KEPT_BYTES):
        overrides = [result.override for result in results]
        scaled, warnings, standing = with_scaling(runs, executions, places, sessions, overrides, progress, engine)
        known = [number for number, run in enumerate(scaled) if run.knows_scaling and not run.is_inferred]
        new = {number for number in known if not runs[number].knows_scaling}
        if new:  # now that the scaling is known, protective stops are not standstills of the program
            standstills = [stop for stop in standstills if stop.run not in new]
            standstills += [stop for number in sorted(new) for stop in find_standstills(scaled[number], number)]
            places, executions = _divided(scaled, sorted(standstills, key=lambda stop: stop.run), marks, cell)
            standing = {}  # places may have moved
    by_run: list[list[Execution]] = [[] for _ in scaled]
    for found in sorted(executions, key=lambda found: found.visits[0].first if found.visits else 0):
        by_run[found.run].append(found)
    return RobotInSessions(scaled, places, by_run, [*warnings, *visited_once(places, executions)], standing)


def _divided(
    runs: Sequence[Run], standstills: list[Standstill], marks: Sequence[Ints], cell: Cell
) -> tuple[dict[str, Place], list[Execution]]:
    """Return the places and executions of runs."""
    places = find_places(runs, standstills, cell.places, all_named=cell.all_places_named)
    visits = find_visits(standstills, places, runs)
    if all(len({visit.place for visit in seen}) < 2 for seen in visits):  # at most one place with standstills
        standstills = with_turns(runs, standstills)
        places = find_places(runs, standstills, cell.places, all_named=cell.all_places_named)
        visits = find_visits(standstills, places, runs)
    executions = find_executions(visits, places, cell.executions, marks)
    return places, with_waits(executions, standstills, runs) + _whole_runs(runs, executions)


def visited_once(places: Mapping[str, Place], executions: Sequence[Execution]) -> list[Note]:
    """Return a note if several found places were visited in just one of many executions: stops midway look like that.

    A door or an emergency stop that the logged scaling does not show leaves such standstills.
    """
    if len(executions) < MANY_EXECUTIONS:
        return []
    often = Counter(place for one in executions for place in {visit.place for visit in one.visits})
    once = [name for name, place in places.items() if place.inferred and often[name] == 1]
    return [note("places-once", count=len(once), of=len(places))] if len(once) >= ONCE else []


def _whole_runs(runs: Sequence[Run], executions: Sequence[Execution]) -> list[Execution]:
    """Return an execution for each run without tasks, so that it can be inspected and replayed."""
    covered = {execution.run for execution in executions}
    return [Execution(number, (), False) for number in range(len(runs)) if number not in covered]


def with_standstills(
    passes: Passes, sessions: Sequence[Session], robot: RobotInSessions
) -> tuple[list[SessionToSample], dict[str, Dwell]]:
    """Return the input of the sample pass for each session, and the usual dwell at each place."""
    known: dict[int, PlaceStandstills] = {}
    for key, one in robot.known.items():
        known.setdefault(key[0], {})[key] = one
    works = [
        SessionToSample(
            session,
            {number: robot.runs[number] for number in session.runs},
            [found for number in session.runs for found in robot.executions[number]],
            {key: one for number in session.runs for key, one in known.get(number, {}).items()},
        )
        for session in sessions
    ]
    standstills = passes.over(partial(_place_standstills, places=robot.places), works, "standstills")
    every = {key: standstill for mine in standstills for key, standstill in mine.items()}
    dwells = usual_dwells([found for mine in robot.executions for found in mine], every)
    return [replace(work, standstills=mine) for work, mine in zip(works, standstills, strict=True)], dwells


def _place_standstills(work: SessionToSample, *, places: Mapping[str, Place]) -> PlaceStandstills:
    return place_standstills(work.runs, work.executions, places, known=work.standstills)
