"""Finds whether robot and operator wait in the same departures, if neither waits in all of them.

Departures with a late event show whether they needed it: the agent left just after the event, or before it.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.coupling.conditions.conditions import decided_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.conditions.departures import Condition, Departures, Gate
    from cyclekit.schema import Bools

ALIKE = 0.9
"""Probability that both agents need their event in the same departure; below 1: the deciding cause can be unclear."""
MIN_GAIN = 4.0
"""Minimum gain in log-likelihood: equal to seven matching departures of which half are needed."""


class NeededTogether(NamedTuple):
    """Conditions needed in the same departures: their shared number, and the share of departures that need them."""

    number: int
    needed: float


def needed_together(
    robot: Sequence[Departures], operator: Sequence[Departures]
) -> dict[tuple[Gate, Condition], NeededTogether]:
    """Return the conditions of both agents that are needed in the same departures, as pairs numbered from 1."""
    pairs = [(mine, his, gain_together(mine[1], his[1])) for mine, his in product(_partly(robot), _partly(operator))]
    found: dict[tuple[Gate, Condition], NeededTogether] = {}
    for (mine, my_needs), (his, his_needs), gain in sorted(pairs, key=lambda pair: -pair[2]):
        if gain >= MIN_GAIN and mine not in found and his not in found:
            every = {key: my_needs.get(key, True) and his_needs.get(key, True) for key in my_needs | his_needs}
            needed = round(float(np.mean(list(every.values()))), 4)
            found[mine] = found[his] = NeededTogether(len(found) // 2 + 1, needed)
    return found


Needed = dict[tuple[int, int], bool]
"""Whether a departure needed its event, where known; key: execution and number of the departure."""
_Whose = tuple["Gate", "Condition"]


def _partly(gates: Sequence[Departures]) -> list[tuple[_Whose, Needed]]:
    found: list[tuple[_Whose, Needed]] = []
    for gate in gates:
        if not any(condition.partly for condition in gate.found):
            continue
        decided = decided_by(np.array([gate.left_s - gate.own_s, *gate.since_s.values()]))
        for row, (key, since) in enumerate(gate.since_s.items(), 1):
            if key[0] == gate.gate and key[1].partly:
                later = np.isneginf(since)
                seen = np.flatnonzero(later | (decided == row))
                which = zip(
                    gate.course[seen].tolist(), (gate.occurrence[seen] // key[1].turns.every).tolist(), strict=True
                )
                found.append((key, dict(zip(which, (~later[seen]).tolist(), strict=True))))
    return found


def gain_together(mine: Needed, his: Needed) -> float:
    """Return the gain in log-likelihood of both conditions if each is needed in the same departures as the other."""
    both = [key for key in mine if key in his]
    a, b = (np.array([needed[key] for key in both], np.bool_) for needed in (mine, his))
    alike = float(np.log(np.where(a == b, ALIKE, 1.0 - ALIKE)).sum())
    return alike - 0.5 * (_log_likelihood(a, mine) + _log_likelihood(b, his))


def _log_likelihood(needed: Bools, every: Needed) -> float:
    share = float(np.clip(np.mean(list(every.values())), 0.01, 0.99)) if every else 0.5
    return float(np.log(np.where(needed, share, 1.0 - share)).sum())
