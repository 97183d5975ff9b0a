"""Visits of the robot from one part that it waited for to the next, across executions: the conveyor may run on.

A part that the robot waited for came at a known time. From there on a *chain* counts the parts, whether they were taken
in the same execution or in one that followed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.coupling.events.part_visits import PartVisits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Bools, Floats, Ints, Vector


class Succession(NamedTuple):
    """Which of E executions follow each other.

    Attributes:
        rows: The executions, ordered by time, shape (E,).
        begin_s: Start of each, in that order, session seconds, shape (E,).
        follows: Whether each follows the one before it with none in between, shape (E,).
    """

    rows: Ints
    begin_s: Vector
    follows: Bools


class PartChains(NamedTuple):
    """Chains of visits.

    Attributes:
        visits: The visits after a known part, up to the next one, by chain; s since the known part came.
        starts_s: Start of the execution at its first visit, shape (C, K), s since the known part; NaN at other visits.
        chained: The visits that are in a chain, by execution and number, shape (E, K).
    """

    visits: PartVisits
    starts_s: Floats
    chained: Bools


def succession(
    sessions: Sequence[str], numbers: Sequence[int], begins_s: Sequence[float], ends_s: Sequence[float]
) -> Succession:
    """Return which executions follow each other.

    In a pause as long as an execution there may have been one that is not known.

    Args:
        sessions: Session of each.
        numbers: Number of each among all logged executions, ordered by time; negative = unknown.
        begins_s: Start of each, session seconds.
        ends_s: Its end.
    """
    number, begin_s, end_s = np.array(numbers), np.array(begins_s, np.float64), np.array(ends_s, np.float64)
    rows = np.argsort(number, kind="stable")
    number, begin_s, end_s, session = number[rows], begin_s[rows], end_s[rows], np.array(sessions)[rows]
    pause_s = begin_s[1:] - end_s[:-1]
    brief = (pause_s >= 0.0) & (pause_s < np.median(end_s - begin_s))
    follows = (number[:-1] >= 0) & (np.diff(number) == 1) & (session[1:] == session[:-1]) & brief
    return Succession(rows, begin_s, np.concatenate([[False], follows]))


def succession_of(courses: Sequence[ExecutionVisits]) -> Succession:
    """Return which executions follow each other."""
    robots = [course.visits["robot"] for course in courses]
    return succession(
        [course.session for course in courses],
        [course.number for course in courses],
        [visits[0].left_s for visits in robots],
        [max(np.fmax(visit.arrived_s, visit.left_s) for visit in visits) for visits in robots],
    )


def part_chains(visits: PartVisits, order: Succession) -> PartChains | None:
    """Return the chains of visits to a place; None if there are none."""
    rows = list[list[tuple[float, float, float]]]([[]])
    chained, known_s = np.zeros(visits.came.shape, np.bool_), np.nan
    for n, begin_s, follows in zip(*order, strict=True):
        if not follows:
            rows.append([])
            known_s = np.nan
        for number in np.flatnonzero(np.isfinite(visits.left[n])):
            if np.isfinite(known_s):
                since_s = begin_s - known_s
                came_s, left_s = visits.came[n, number] + since_s, visits.left[n, number] + since_s
                rows[-1].append((came_s, left_s, np.nan if number else since_s))
                chained[n, number] = True
            if visits.waited[n, number]:
                rows.append([])
                known_s = begin_s + visits.part_s[n, number]
    rows = [each for each in rows if each]
    if not rows:
        return None
    came, left, starts_s = np.full((3, len(rows), max(map(len, rows))), np.nan)
    for n, each in enumerate(rows):
        came[n, : len(each)], left[n, : len(each)], starts_s[n, : len(each)] = np.array(each).T
    return PartChains(PartVisits(came, left, visits.own_s), starts_s, chained)
