"""Scaling of each run: logged by the robot or by the safety system, else inferred from the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cyclekit.dataset.cards import Note, note
from cyclekit.scaling.infer.override import HALTED, Reference, infer_overrides
from cyclekit.scaling.levels import find_staircase
from cyclekit.scaling.safety_override import logged_apart
from cyclekit.segmentation.arrivals import REST_M, PlaceStandstills, place_standstills, unchanged
from cyclekit.segmentation.dwell import Dwell, usual_dwells
from cyclekit.segmentation.motion import InferredScaling, halted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Place
    from cyclekit.dataset.sessions import Session
    from cyclekit.parallel.engine import Engine
    from cyclekit.scaling.safety_override import SafetyOverride
    from cyclekit.schema import Progress, Vector
    from cyclekit.segmentation.executions import Execution
    from cyclekit.segmentation.stored_run import Run

HALTED_S = 0.3
"""Minimum time, s, that a robot has left but not moved to count as stopped."""
AFTER = 3
"""Number of rows after a stop at which the scaling is that of the next level."""
SAME, FULL = 0.05, 0.97
"""Tolerance for equal scalings; minimum scaling of full speed."""
COMMONER = 2.0
"""Minimum ratio of a scaling's frequency after stops to that after usual standstills, for it to indicate a stop."""
CLEAR = 5.0
"""Minimum remaining distance of a robot stopped short of a place, in standard deviations of the noise."""
MIN_IN_MOTION = 0.3
"""Minimum ratio of stops in mid-motion to stops at places."""
LEAVING_S = 2.0
"""Maximum time after a departure, s, in which the scaling must be known."""
SPARSE = 10
"""Levels are searched in every tenth row, as they are held for seconds."""


def with_scaling(
    runs: Sequence[Run],
    executions: Sequence[Execution],
    places: Mapping[str, Place],
    sessions: Sequence[Session],
    overrides: Sequence[SafetyOverride | None],
    progress: Progress,
    engine: Engine,
) -> tuple[list[Run], list[Note], PlaceStandstills]:
    """Return the runs, with the scaling inferred if not logged, notes on the inference, and standstills already known.

    Args:
        runs: All runs.
        executions: Their executions, from `find_executions`.
        places: All places.
        sessions: All sessions; reference sessions were recorded without a person in the cell.
        overrides: Override in the separate log of the safety system, for each session.
        progress: Called with fraction and text.
        engine: Runs the inference.
    """
    silent = [number for number, run in enumerate(runs) if not run.knows_scaling]
    if not silent:
        return list(runs), [], {}
    alone = [number for session in sessions if session.reference for number in session.runs]
    parts, references = infer_overrides(runs, executions, alone, lambda done: progress(done, "speed override"), engine)
    if not references:
        return list(runs), [note("scaling-unknown", silent=len(silent), runs=len(runs))], {}
    done = [run if run.knows_scaling else run.with_scaling(found) for run, found in zip(runs, parts, strict=True)]
    apart, notes = logged_apart(runs, parts, sessions, overrides)
    left = [number for number in silent if number not in apart]
    after_halt = scalings_after_stops(
        [part.scaling for n in left for part in sorted(parts[n], key=lambda part: part.first)]
    )
    with_people = (session for session in sessions if any("people" in one.tables for one in session.recordings))
    watched = {number for session in with_people for number in session.runs}.intersection(left)
    mine = [execution for execution in executions if execution.run in watched]
    standstills = place_standstills(done, mine, places)
    halts = halts_at_places(done, mine, standstills, after_halt)
    halted_rows = {n: [(one.first, one.first + len(one.scaling) - 1) for one in halts[n]] for n in left}
    known = unchanged(standstills, done, halted_rows)
    for number in left:
        done[number] = runs[number].with_scaling([*parts[number], *halts[number]])
    for number, part in apart.items():
        done[number] = runs[number].with_scaling([part], logged_apart=True)
    return done, [*notes, *([_inferred(len(left), len(runs), references)] if left else [])], known


def _inferred(silent: int, runs: int, references: Mapping[str, Sequence[Reference]]) -> Note:
    """Return a note on the references."""
    flat = [reference for found in references.values() for reference in found]
    slowed = sorted(task for task, found in references.items() if any(reference.slowed < 1.0 for reference in found))
    alone = sum(reference.alone for reference in flat)
    return note(
        "scaling-inferred",
        silent=silent, runs=runs, references=len(flat), alone=alone, never_at_full_speed=", ".join(slowed),
    )  # fmt: skip


class _Left(NamedTuple):
    """Departure after a long standstill, rows `begin` to `left` of a run, and the first scaling after it."""

    run: int
    begin: int
    left: int
    scaling: float


def halts_at_places(
    runs: Sequence[Run], executions: Sequence[Execution], standstills: PlaceStandstills, after_stops: ScalingsAfterStops
) -> list[list[InferredScaling]]:
    """Return where a standstill at a place was prolonged by a stop of the safety system: scaling 0, not a wait.

    If the robot was stopped just after it left, the motion shows it. Otherwise, the speed at departure decides: a
    person who stopped the robot is still near when it may leave, so it leaves at a scaling that is common after stops;
    a robot that waited for a part leaves at any allowed speed. In a cell with only stop and full speed, the two cannot
    be distinguished: the excess stays a wait. Use only where people were logged: a standstill alone shows no scaling.

    Args:
        runs: Runs with inferred scaling.
        executions: Their executions.
        standstills: Their standstills at places.
        after_stops: Scalings after stops.

    Returns:
        The stopped rows of each run, with scaling 0.
    """
    usual = usual_dwells(executions, standstills)
    halts: list[list[InferredScaling]] = [[] for _ in runs]
    overdue, others = list[_Left](), list[float]()
    for execution in executions:
        run = runs[execution.run]
        for visit in execution.visits[1:]:
            standstill = standstills[execution.run, visit.first, visit.last]
            final = visit is execution.visits[-1]
            dwell = Dwell(0.0, 0.0) if final else usual[visit.place].of(execution)
            arrival_s = standstill.times(dwell.usual_s, dwell.ready_s(standstill))[0]
            end = int(run.row_at(np.array([arrival_s]))[0])
            if _halted_short(run, visit.first, end, standstill.left_s):
                halts[execution.run].append(halted(visit.first, end - 1))
            if final:
                continue
            since_s = dwell.excess_from_s(standstill)
            last_s = run.time_at(visit.last)  # departure may precede visible motion; a robot that moves was not stopped
            if max(standstill.left_s, last_s) - standstill.departed_earliest_s > HALTED_S:  # stopped just as it left
                left_s = standstill.times(dwell.usual_s, dwell.ready_s(standstill))[1]
                begin, left = run.row_at(np.array([left_s, max(standstill.left_s, last_s)])).tolist()
                halts[execution.run] += [halted(begin, left)] if begin <= left else []
                continue
            times = [last_s if since_s is None else since_s, min(standstill.left_s, last_s), last_s + LEAVING_S]
            begin, left, end = run.row_at(np.array(times)).tolist()
            leaving = run.window(visit.last, end).scaling
            known = leaving[np.isfinite(leaving)]
            if len(known) and since_s is None:
                others.append(float(known[0]))
            elif len(known) and begin <= left:
                overdue.append(_Left(execution.run, begin, left, float(known[0])))
    stopped = [one for one in overdue if after_stops.indicates_stop(one.scaling, others)]
    if len(after_stops.scaling) >= MIN_IN_MOTION * len(stopped):
        for one in stopped:
            halts[one.run].append(halted(one.begin, one.left))
    return halts


def _halted_short(run: Run, first: int, arrived: int, left_s: float) -> bool:
    """Tell whether a robot that was not seen to move from row `first` on was halted short of where it then arrived."""
    left = int(run.row_at(np.array([left_s]))[0])
    if arrived >= left or run.time_at(arrived) - run.time_at(first) <= HALTED_S:
        return False
    before, after = run.window(first, arrived - 1).xyz_m, run.window(arrived, left).xyz_m
    noise = [xyz.std(axis=0) / np.sqrt(len(xyz)) for xyz in (before, after)]
    way = float(np.linalg.norm(np.median(before, axis=0) - np.median(after, axis=0)))
    return way > max(REST_M, CLEAR * float(np.linalg.norm(noise)))


class ScalingsAfterStops(NamedTuple):
    """Scalings after stops in mid-motion, shape (N,); `lowest`: the lowest level at which the robot moves."""

    scaling: Vector
    lowest: float

    def indicates_stop(self, scaling: float, others: Sequence[float]) -> bool:
        """Return whether a robot that leaves at a scaling was stopped: it is commoner after stops than in `others`."""
        seen = np.append(self.scaling, self.lowest)  # prior without stops: the person is still near
        after = float((np.abs(seen - scaling) < SAME).mean())
        usual = (np.count_nonzero(np.abs(np.array(others) - scaling) < SAME) + 1.0) / (len(others) + 1.0)
        return bool(scaling < FULL and after > COMMONER * usual)


def scalings_after_stops(scaling: Sequence[NDArray[np.floating[Any]]]) -> ScalingsAfterStops:
    """Return the scalings at which the robot continues after stops.

    Args:
        scaling: Scaling of each motion, in order of time.
    """
    levels = find_staircase(np.concatenate([values[::SPARSE] for values in scaling] or [np.empty(0)])).levels
    moving = [float(level) for level in levels if level > HALTED]
    found: list[Vector] = [np.empty(0)]
    for values in scaling:
        ends = np.flatnonzero((values[:-AFTER] <= HALTED) & (values[1 : 1 - AFTER or None] > HALTED)) + AFTER
        found.append(values[ends].astype(np.float64))
    after = np.concatenate(found)
    return ScalingsAfterStops(after[after > HALTED], moving[0] if len(moving) > 1 else 1.0)
