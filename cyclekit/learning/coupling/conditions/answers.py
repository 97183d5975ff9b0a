"""Signals of somebody whom no log shows, as answers to the robot: the operator has mounted what it brought.

Whoever gives a signal is taken for an agent whose visits are its changes: each comes at the latest of his own work
since the one before it, and of what the robot has done and his lag after that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.coupling import ConditionCard, SourceCard
from cyclekit.learning.coupling.conditions.candidates import early_s, times_of
from cyclekit.learning.coupling.conditions.conditions import KEPT, decided_by, find_answer
from cyclekit.learning.coupling.conditions.departures import Departures, Gate
from cyclekit.learning.coupling.conditions.lags import quantiles, reverse_kaplan_meier

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
    from cyclekit.schema import Bools, Vector

MIN_CHANGES = 10
"""Fewer changes of a signal tell nothing."""
OWN_TOOL, OWN_TOOL_S = 0.9, 0.5
"""A signal whose changes come in the robot's visits of one place, to this part, and within so long of each other after
its arrival (nine in ten of them), is of its own gripper: what it does there is its own work."""


def find_answers(courses: Sequence[ExecutionVisits], event: Event, place: str) -> SourceCard | None:
    """Return how a signal comes after what the robot has done; None where it comes by itself.

    Args:
        courses: Executions without operators.
        event: The change of the signal that the robot waits for.
        place: Where, or before which, it does.
    """
    changes = _changes(courses, event)
    if changes is None or (condition := find_answer(changes, times_of(courses))) is None:
        return None
    step, every = -(-len(changes.left_s) // KEPT), changes.since_s[changes.gate, condition]
    since = np.array([changes.left_s - changes.own_s, every])[:, ::step]
    decided, first, known = decided_by(since), changes.occurrence[::step] == 0, np.isfinite(since)
    mass = reverse_kaplan_meier(np.where(known[1], since[1], 0.0), (decided == 1).astype(np.float64), known[1])
    gap_s, first_s = (own_s_of(since[0, some], decided[some] == 0) for some in (~first, first))
    there = ~np.isnan(every)
    after = ConditionCard(
        agent="robot",
        place=condition.event.place,
        event="arrives" if condition.event.event == "arrives" else "leaves",
        back=condition.back,
        turns=condition.turns,
        lag_s=quantiles(since[1], mass),
        held=float((every[there] >= -early_s(condition)).mean()),
        decided=int((decided == 1).sum()) * step,
    )
    return SourceCard(
        signal=event.place,
        event="cleared" if event.event == "cleared" else "set",
        gap_s=gap_s,
        first_s=first_s,
        taken_by=place,
        after=(after,),
    )


def is_own_tool(courses: Sequence[ExecutionVisits], event: Event, place: str) -> bool:
    """Tell whether a signal tells of the robot's own work at a place, such as that its gripper has closed."""
    since_s, total = list[float](), 0
    for course in courses:
        at = course.events.get(event, np.empty(0))
        total += len(at)
        for visit in course.visits["robot"]:
            if visit.place == place:
                since_s += (at[(at >= visit.arrived_s) & (at <= visit.left_s)] - visit.arrived_s).tolist()
    if len(since_s) < max(MIN_CHANGES, OWN_TOOL * total):
        return False
    early_s, late_s = np.quantile(since_s, (0.05, 0.95))
    return bool(late_s - early_s < OWN_TOOL_S)


def own_s_of(since_s: Vector, decided: Bools) -> tuple[float, ...]:
    """Return own work by its quantiles, s.

    What is shorter than all of it that decided is as short as the shortest time that was seen at all: where the answer
    decided, own work was over.
    """
    if not decided.any():
        return (0.0,)
    mass = reverse_kaplan_meier(since_s, decided.astype(np.float64), np.ones(len(since_s), np.bool_))
    mass[since_s.argmin()] += max(0.0, 1.0 - mass.sum())
    return quantiles(since_s, mass)


def _changes(courses: Sequence[ExecutionVisits], event: Event) -> Departures | None:
    """Return the changes of a signal as departures of whoever gives it."""
    rows = [
        (index, occurrence, before, at)
        for index, course in enumerate(courses)
        for occurrence, (before, at) in enumerate(_pairs(course, event))
    ]
    if len(rows) < MIN_CHANGES:
        return None
    course, occurrence = np.array([row[:2] for row in rows], np.int64).T
    own_s, left_s = np.array([row[2:] for row in rows]).T
    gate = Gate("operator", "leave", event.place)
    return Departures(gate, np.arange(len(rows)), course, occurrence, own_s, left_s, np.full(len(rows), np.nan))


def _pairs(course: ExecutionVisits, event: Event) -> list[tuple[float, float]]:
    """Return each change with the one before it, the first with the start of the execution, s."""
    at = course.events.get(event, np.empty(0)).tolist()
    return list(zip([course.visits["robot"][0].left_s, *at[:-1]], at, strict=bool(at))) if at else []
