"""The operator's tasks from the track: the way to each place, and the standstill there."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import polars as pl

from cyclekit import schema
from cyclekit.people.hesitations import EDGE_S
from cyclekit.people.tracks import nearest_places

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import ExecutionCard
    from cyclekit.dataset.dataset import Place
    from cyclekit.people.activity import OperatorStandstills

AWAY_S = 1.5
"""Minimum absence, s: an operator who returns to a place sooner has not left it."""


class _Visit(NamedTuple):
    place: str
    arrived_s: float
    left_s: float


def operator_tasks(
    cards: Sequence[ExecutionCard],
    standstills: Sequence[OperatorStandstills],
    human_places: Mapping[str, Place],
    until_s: Sequence[float] | None = None,
) -> list[tuple[object, ...]]:
    """Return rows of table TASKS: one per standstill of the operator at one of the places.

    A task starts when the operator leaves the previous place. A standstill at the start of an execution has no
    arrival, one at its end has no end.

    Args:
        cards: Executions of a session.
        standstills: The operator's standstills in each execution.
        human_places: The operator's places.
        until_s: Time up to which standstills are known, session seconds; None: the end of the execution.
    """
    rows = []
    known_s = [card.end_s for card in cards] if until_s is None else until_s
    for card, mine, end_s in zip(cards, standstills, known_s, strict=False):  # task lists have no standstills
        before_s: float | None = card.start_s
        for index, visit in enumerate(_visits(mine, human_places)):
            began = visit.arrived_s <= card.start_s + EDGE_S
            lasts = visit.left_s >= end_s - EDGE_S
            rows.append(
                {
                    "execution": card.execution,
                    "index": index,
                    "task": visit.place,
                    "goal_place": visit.place,
                    "start_s": before_s,
                    "arrival_s": None if began else visit.arrived_s,
                    "end_s": None if lasts else visit.left_s,
                    "agent": "operator",
                }
            )
            before_s = visit.left_s
    if not rows:
        return []
    kinds = {name: schema.TASKS[name].dtype for name in rows[0]}
    return schema.conform(pl.DataFrame(rows, schema=kinds), schema.TASKS).rows()


def _visits(standstills: OperatorStandstills, human_places: Mapping[str, Place]) -> list[_Visit]:
    found: list[_Visit] = []
    at = nearest_places(standstills.at_m, human_places)
    for (arrived_s, left_s), place in zip(standstills.times_s.tolist(), at, strict=True):
        if place is None:
            continue
        if found and found[-1].place == place and arrived_s - found[-1].left_s < AWAY_S:
            found[-1] = found[-1]._replace(left_s=left_s)
        else:
            found.append(_Visit(place, arrived_s, left_s))
    return found
