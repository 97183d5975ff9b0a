"""An unseen operator who serves several places in turn, as agendas: one for each order of service."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.joint.legs import Agenda, AgendaLeg, needs_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import CouplingCard, InTurnCard, SourceCard


def in_turn_agendas(card: CouplingCard | None, robots: Sequence[Agenda]) -> tuple[list[Agenda], list[list[int]]]:
    """Return the agendas of an operator who serves several places in turn, and those beside each agenda of the robot.

    Args:
        card: Who waits for whom.
        robots: Agendas of the robot.

    Returns:
        The distinct agendas; and for each of `robots` the numbers of those that its cycles use in turn, each as often
        as its order was logged. Both are empty if no operator serves in turn.
    """
    if card is None or card.in_turn is None:
        return [], []
    sources = {source.signal: source for source in card.sources if source.signal in card.in_turn.signals}
    found: list[Agenda] = []
    mine: list[list[int]] = []
    for robot in robots:
        brought = _brought(robot, list(sources.values()))
        numbers: dict[tuple[int, ...], int] = {}
        mine.append([])
        for order in possible_orders(card.in_turn.orders, [source.signal for source, _ in brought]):
            if order not in numbers:
                numbers[order] = len(found)
                found.append(_agenda(card.in_turn, [brought[part] for part in order]))
            mine[-1].append(numbers[order])
    return found, mine


def possible_orders(logged: Sequence[tuple[int, ...]], places: Sequence[str]) -> list[tuple[int, ...]]:
    """Return the logged orders of service that lead to no deadlock, each as often as it was logged.

    The robot brings no part to a place before the one there was served, and no later part before that. A logged order
    of more parts counts without the last ones; one of fewer is repeated.

    Args:
        logged: Orders of service: numbers of parts, in the order in which the robot brought them.
        places: Place of each part that the robot brings now, in order.

    Returns:
        The orders; that in which the parts are brought if no logged one is possible.
    """
    found = [_of_length(order, len(places)) for order in logged]
    found = [order for order in found if _is_possible(order, places)]
    return found or [tuple(range(len(places)))]


def _of_length(order: tuple[int, ...], count: int) -> tuple[int, ...]:
    blocks = range(0, count, len(order))
    return tuple(first + part for first in blocks for part in order if first + part < count)


def _is_possible(order: tuple[int, ...], places: Sequence[str]) -> bool:
    """Return whether each part is served before the next one comes to its place, and no later part before it."""
    at = {part: number for number, part in enumerate(order)}
    for part, place in enumerate(places):
        following = next((other for other in range(part + 1, len(places)) if places[other] == place), None)
        if following is not None and any(at[other] < at[part] for other in range(following, len(places))):
            return False
    return True


def _brought(robot: Agenda, sources: Sequence[SourceCard]) -> list[tuple[SourceCard, int]]:
    """Return the source of each part that the robot brings, and its number at its place, in order."""
    by_event: dict[tuple[str, ...], SourceCard] = {
        (source.after[0].place, source.after[0].event): source for source in sources
    }
    return [
        (by_event[event[1:3]], event[3]) for event, _ in robot.events if event[0] == "robot" and event[1:3] in by_event
    ]


def _agenda(card: InTurnCard, served: Sequence[tuple[SourceCard, int]]) -> Agenda:
    legs, first_s = [], np.array(card.first_s)
    for number, (source, turn) in enumerate(served):
        own_s = np.array(card.gap_s) if number else first_s
        passes = (("signal", source.signal, source.brings, turn),)
        needs = needs_of(source.after, turn)
        legs.append(AgendaLeg(number, "", np.empty((0, 3)), own_s=own_s, name="in turn", needs=needs, passes=passes))
    return Agenda("signal", tuple(legs) or (AgendaLeg(-1, "", np.empty((0, 3))),), ("in turn",) * len(legs))
