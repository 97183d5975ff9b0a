"""The operator's orders for work with more or fewer coupled visits than any log, composed from parts of logged orders.

A coupled visit is one of the robot at a place where one agent waits for the other; each has its visit of the operator.
Between two of them, the operator goes where he went between the same two in some log.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cyclekit.dataset.cards import CouplingCard

PAIRED = 0.9
"""Minimum share of the logged executions in which robot and operator make their coupled visits in the same order."""
MIN_EXECUTIONS = 5
ORDERS = 40
"""Number of composed orders; the cycles use them in turn."""
Order = tuple[str, ...]


def coupled_places(coupling: CouplingCard | None) -> list[tuple[str, str | None]]:
    """Return the places of robot and operator of each wait of one for the other.

    Where the robot waits for a signal that the operator does not give, he has no place. Its waits for its own machine
    are left out.
    """
    found: list[tuple[str, str | None]] = []
    for gate in coupling.gates if coupling else ():
        for one in gate.conditions:
            if gate.agent == "robot" and one.agent != "robot":
                found.append((gate.place, one.place if one.agent == "operator" else None))
            elif gate.agent == "operator" and one.agent == "robot":
                found.append((one.place, gate.place))
    return found


def pairs_of(coupling: CouplingCard | None) -> dict[str, str]:
    """Return the place of the operator that belongs to each coupled place of the robot, if there is one for each."""
    both = {(robot, operator) for robot, operator in coupled_places(coupling) if operator is not None}
    pairs = dict(both)
    return pairs if len(both) == len(pairs) == len(set(pairs.values())) else {}


def continued(logged: Sequence[tuple[Sequence[str], Order]], coupling: CouplingCard | None) -> list[Order]:
    """Return the operator's orders, each with what he did not come to because the execution ended.

    A robot with more work after its last coupled visit than was logged would else find him standing at his place there
    until the end, or would not find him at all. He comes to each coupled visit, and goes on from the last one as in
    some execution in which he left that place, up to the next coupled visit, which belongs to other work.

    Args:
        logged: Places of robot and operator in each logged execution.
        coupling: Who waits for whom.
    """
    anchors = {operator for _, operator in coupled_places(coupling) if operator is not None}
    pairs = pairs_of(coupling)
    missing = _missing(logged, pairs)
    tails: dict[str, list[Order]] = defaultdict(list)
    for _, order in logged:
        for number, place in enumerate(order[:-1]):
            later = order[number + 1 :]
            ends = next((n for n, other in enumerate(later) if other in anchors), len(later))
            tails[place].append(later[:ends])
    turns: Counter[str] = Counter()
    found = []
    for (_, order), more in zip(logged, missing, strict=True):
        order += more
        last = order[-1] if order else ""
        some = [tail for tail in tails[last] if tail] if last in anchors else []
        found.append(order + some[turns[last] % len(some)] if some else order)
        turns[last] += 1
    return found


def _missing(logged: Sequence[tuple[Sequence[str], Order]], pairs: Mapping[str, str]) -> list[Order]:
    """Return the operator's coupled visits that an execution ended before; none if he does not come to each anyway."""
    anchors = set(pairs.values())
    found, fits = [], 0
    for robot, order in logged:
        mine, expected = _coupled(order, anchors), [pairs[place] for place in robot[1:] if place in pairs]
        fits += (fit := _all_but_last(mine, expected))
        found.append(tuple(expected[len(mine) :]) if fit else ())
    return found if fits >= PAIRED * len(logged) else [()] * len(logged)


def _all_but_last(mine: Sequence[str], expected: Sequence[str]) -> bool:
    """Return whether the operator made the expected coupled visits; the execution may have ended before the last."""
    return list(mine) == list(expected[: len(mine)]) and len(mine) >= len(expected) - 1


def _coupled(order: Sequence[str], anchors: Collection[str]) -> list[str]:
    return [place for place in order if place in anchors]


def composed_orders(
    asked: Sequence[str], logged: Sequence[tuple[Sequence[str], Sequence[str]]], pairs: Mapping[str, str]
) -> list[Order]:
    """Return orders of the operator for an order of the robot; none where the logs do not tell.

    Args:
        asked: Places of the robot, from its first position.
        logged: Places of robot and operator in each logged execution.
        pairs: Place of the operator that belongs to each coupled place of the robot.
    """
    coupled = [pairs[place] for place in asked[1:] if place in pairs]
    anchors = set(pairs.values())
    parts: dict[tuple[str, str], list[Order]] = defaultdict(list)
    fits = 0
    for robot, operator in logged:
        at = [number for number, place in enumerate(operator) if place in anchors]
        mine = [operator[number] for number in at]
        expected = [pairs[place] for place in robot[1:] if place in pairs]
        if not _all_but_last(mine, expected):
            continue
        fits += 1
        whole = len(mine) == len(expected)  # else the execution ended before his last visit
        bounds = [-1, *at, *([len(operator)] if whole else [])]
        ways = pairwise(["", *mine, *([""] if whole else [])])
        for (first, last), (start, goal) in zip(pairwise(bounds), ways, strict=True):
            parts[start, goal].append(tuple(operator[first + 1 : last]))
    wanted = list(pairwise(["", *coupled, ""]))
    parts.setdefault(wanted[-1], [()])
    if not coupled or fits < max(MIN_EXECUTIONS, PAIRED * len(logged)) or any(way not in parts for way in wanted):
        return []
    rng = np.random.default_rng(0)
    drawn = [[parts[way][number] for number in rng.integers(len(parts[way]), size=ORDERS)] for way in wanted]
    return [
        tuple(place for part, goal in zip(chosen, [*coupled, ""], strict=True) for place in (*part, goal) if place)
        for chosen in zip(*drawn, strict=True)
    ]
