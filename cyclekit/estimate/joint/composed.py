"""The operator's orders for work with more or fewer coupled visits than any log, composed from parts of logged orders.

A coupled visit is one of the robot at a place where one agent waits for the other; each has its visit of the operator.
Between two of them, the operator goes where he went between the same two in some log.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import CouplingCard

PAIRED = 0.9
"""Minimum share of the logged executions in which robot and operator make their coupled visits in the same order."""
MIN_EXECUTIONS = 5
ORDERS = 40
"""Number of composed orders; the cycles use them in turn."""
Order = tuple[str, ...]


def pairs_of(coupling: CouplingCard | None) -> dict[str, str]:
    """Return the place of the operator that belongs to each coupled place of the robot, if there is one for each."""
    found: dict[str, set[str]] = defaultdict(set)
    for gate in coupling.gates if coupling else ():
        for one in gate.conditions:
            if {gate.agent, one.agent} == {"robot", "operator"}:
                robot, operator = (gate, one) if gate.agent == "robot" else (one, gate)
                found[robot.place].add(operator.place)
    if any(len(places) > 1 for places in found.values()):
        return {}
    pairs = {robot: next(iter(places)) for robot, places in found.items()}
    return pairs if len(set(pairs.values())) == len(pairs) else {}


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
        if mine != expected[: len(mine)]:
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
