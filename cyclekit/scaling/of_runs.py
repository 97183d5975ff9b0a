"""Scaling of each run: logged, by the robot or by the safety system, else inferred from its motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cyclekit.dataset.cards import Note, note
from cyclekit.scaling.infer.override import Reference, infer_overrides
from cyclekit.scaling.levels import find_staircase
from cyclekit.scaling.safety_override import logged_apart
from cyclekit.segmentation.arrivals import Stands, stands_of
from cyclekit.segmentation.dwell import usual_dwells
from cyclekit.segmentation.motion import InferredScaling

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

HALTED, HALTED_S = 0.02, 0.3
"""Scaling at or below this is a halt; a robot that has left and is not seen to move for longer is halted."""
AFTER = 3
"""So many rows after a halt the scaling is that of the next level."""
SAME, FULL = 0.05, 0.97
"""Scalings that differ by less are alike; above FULL nothing slows the robot."""
COMMONER = 2.0
"""A speed tells of a halt where it is so many times as common after halts as after standstills of the usual time."""
LEAVING_S = 2.0
"""How soon after a departure the scaling must be known to say whether the robot left slowed."""
SPARSE = 10
"""Levels are looked for in every tenth row: they are held for seconds."""


def with_scaling(
    runs: Sequence[Run],
    executions: Sequence[Execution],
    places: Mapping[str, Place],
    sessions: Sequence[Session],
    overrides: Sequence[SafetyOverride | None],
    progress: Progress,
    engine: Engine,
) -> tuple[list[Run], list[Note]]:
    """Return the runs, with the scaling inferred where none was logged, and the notes on that.

    Args:
        runs: All runs.
        executions: Their executions, from `segment`.
        places: All places.
        sessions: Which runs were recorded without a person in the cell.
        overrides: What the safety system of each session logged in a log of its own.
        progress: Told fraction and text.
        engine: Who infers.
    """
    silent = [number for number, run in enumerate(runs) if not run.knows_scaling]
    if not silent:
        return list(runs), []
    alone = [number for session in sessions if session.reference for number in session.runs]
    parts, references = infer_overrides(runs, executions, alone, lambda done: progress(done, "speed override"), engine)
    if not references:
        return list(runs), [note("scaling-unknown", silent=len(silent), runs=len(runs))]
    done = [run if run.knows_scaling else run.with_scaling(found) for run, found in zip(runs, parts, strict=True)]
    apart, notes = logged_apart(runs, parts, sessions, overrides)
    left = [number for number in silent if number not in apart]
    after_halt = scalings_after_halts(
        [part.scaling for n in left for part in sorted(parts[n], key=lambda part: part.first)]
    )
    mine = [execution for execution in executions if execution.run in set(left)]
    with_people = (session for session in sessions if any("people" in one.tables for one in session.recordings))
    watched = {number for session in with_people for number in session.runs}
    mine = [execution for execution in mine if execution.run in watched]
    halts = halts_at_places(done, mine, stands_of(done, mine, places), after_halt)
    for number in left:
        done[number] = runs[number].with_scaling([*parts[number], *halts[number]])
    for number, part in apart.items():
        done[number] = runs[number].with_scaling([part], logged_apart=True)
    return done, [*notes, *([_inferred(len(left), len(runs), references)] if left else [])]


def _inferred(silent: int, runs: int, references: Mapping[str, Sequence[Reference]]) -> Note:
    """Say what the references are."""
    flat = [reference for found in references.values() for reference in found]
    slowed = sorted(task for task, found in references.items() if any(reference.slowed < 1.0 for reference in found))
    alone = sum(reference.alone for reference in flat)
    return note(
        "scaling-inferred",
        silent=silent, runs=runs, references=len(flat), alone=alone, never_at_full_speed=", ".join(slowed),
    )  # fmt: skip


class _Left(NamedTuple):
    """A departure after a long standstill, rows `begin` to `left` of a run, and the scaling that is first seen."""

    run: int
    begin: int
    left: int
    scaling: float


def halts_at_places(
    runs: Sequence[Run], executions: Sequence[Execution], stands: Stands, after_halts: AfterHalts
) -> list[list[InferredScaling]]:
    """Return where the inferred scaling of each run is 0, since a stand was prolonged by a halt and not by waiting.

    A robot that was halted a hair after it left shows so itself. Else both look alike. But who halted the robot is
    still near when it may leave, so it leaves as it goes on after the halts that are seen; a robot that waited for a
    part leaves at whatever speed is allowed. Where both are alike (a cell that knows only halt and full speed) they
    cannot be told apart: there the excess stays waiting. Ask only where people were logged: a standstill alone tells no
    scaling.

    Args:
        runs: Runs of inferred scaling.
        executions: Their executions.
        stands: Their stands.
        after_halts: How the robot goes on after halts.

    Returns:
        Of each run, the rows at which it was halted so.
    """
    usual = usual_dwells(executions, stands)
    halts: list[list[InferredScaling]] = [[] for _ in runs]
    overdue, others = list[_Left](), list[float]()
    for execution in executions:
        run = runs[execution.run]
        for visit in execution.visits[1:-1]:
            stand, dwell = stands[execution.run, visit.first, visit.last], usual[visit.place]
            since_s = dwell.overdue_s(stand)
            last_s = run.time_at(visit.last)  # it may leave before it is seen to: what is seen to move was not halted
            if max(stand.left_s, last_s) - stand.free_s > HALTED_S:  # seen to be halted as it left
                left_s = stand.process(dwell.usual_s, dwell.ready_s(stand))[1]
                begin, left = run.row_at(np.array([left_s, max(stand.left_s, last_s)])).tolist()
                halts[execution.run] += [_halt(begin, left)] if begin <= left else []
                continue
            times = [last_s if since_s is None else since_s, min(stand.left_s, last_s), last_s + LEAVING_S]
            begin, left, end = run.row_at(np.array(times)).tolist()
            leaving = run.window(visit.last, end).scaling
            known = leaving[np.isfinite(leaving)]
            if len(known) and since_s is None:
                others.append(float(known[0]))
            elif len(known) and begin <= left:
                overdue.append(_Left(execution.run, begin, left, float(known[0])))
    for one in overdue:
        if after_halts.tells(one.scaling, others):
            halts[one.run].append(_halt(one.begin, one.left))
    return halts


def _halt(first: int, last: int) -> InferredScaling:
    none = np.zeros(last + 1 - first)
    return InferredScaling(first, none, none, none.astype(np.int8))


class AfterHalts(NamedTuple):
    """At which scaling the robot goes on after halts in mid-motion, shape (N,); `lowest`: the lowest it moves at."""

    scaling: Vector
    lowest: float

    def tells(self, scaling: float, others: Sequence[float]) -> bool:
        """Tell whether a robot that leaves at a scaling was halted: after halts that is commoner than at `others`."""
        seen = np.append(self.scaling, self.lowest)  # where no halt is seen: who stopped it is still near
        after = float((np.abs(seen - scaling) < SAME).mean())
        usual = (np.count_nonzero(np.abs(np.array(others) - scaling) < SAME) + 1.0) / (len(others) + 1.0)
        return bool(scaling < FULL and after > COMMONER * usual)


def scalings_after_halts(scaling: Sequence[NDArray[np.floating[Any]]]) -> AfterHalts:
    """Return at which scaling the robot goes on after a halt.

    Args:
        scaling: Scaling of stretches of motion, in the order of time.
    """
    levels = find_staircase(np.concatenate([values[::SPARSE] for values in scaling] or [np.empty(0)])).levels
    moving = [float(level) for level in levels if level > HALTED]
    found: list[Vector] = [np.empty(0)]
    for values in scaling:
        ends = np.flatnonzero((values[:-AFTER] <= HALTED) & (values[1 : 1 - AFTER or None] > HALTED)) + AFTER
        found.append(values[ends].astype(np.float64))
    after = np.concatenate(found)
    return AfterHalts(after[after > HALTED], moving[0] if len(moving) > 1 else 1.0)
