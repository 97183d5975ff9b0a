"""Waits of the robot for a machine that no signal reports: the time since it left the same place before.

It loads the machine and goes away; when it comes back it waits until the machine is done. The longer it was away, the
shorter it waits, so its standstills vary while the time since its last departure does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.coupling import Turns
from cyclekit.learning.coupling.conditions.departures import Condition
from cyclekit.learning.coupling.events.visits import Event

if TYPE_CHECKING:
    from cyclekit.learning.coupling.conditions.departures import Departures
    from cyclekit.learning.coupling.conditions.lags import Causes
    from cyclekit.schema import Vector

MIN_WAITS = 5
"""Minimum number of waits."""
STEADY = 0.5
"""Maximum spread of the time since the robot's last departure, as a share of the spread of its standstills."""
OBEYED, EARLY_S = 0.98, 0.25
"""Minimum share of departures that are not earlier than this, s, before the shortest process time."""


def after_own(event: Event, gate: Departures) -> list[Condition]:
    """Return the conditions of a gate that an event of its own agent allows.

    These are the robot's last departure from the place, or at every second visit (to unload) that of the visit before.
    It waits at the place or short of it: where it comes from may be the place itself.
    """
    there = gate.gate.at == "leave" or gate.gate.short
    if not there or event != Event("robot", gate.gate.place, "leaves"):
        return []
    return [Condition(event, 1), Condition(event, 0, Turns(every=2, first=1, event_every=2))]


def is_steady(gate: Departures, causes: Causes, since: Vector) -> bool:
    """Return whether the time since the robot's own departure is a process time.

    It varies less than the robot's standstills where it decided, and the robot never goes much earlier.

    Args:
        gate: The departures.
        causes: Their causes, the tested one last.
        since: Time from the event to each compared departure, s.
    """
    decided = causes.share.argmax(axis=0) == len(causes.share) - 1
    if decided.sum() < MIN_WAITS:
        return False
    stood = (gate.left_s - gate.own_s)[gate.seen]
    (shortest, longest), (low, high) = (np.quantile(each[decided], (0.1, 0.9)) for each in (since, stood))
    obeyed = np.mean(since[np.isfinite(since)] >= shortest - EARLY_S - (longest - shortest))
    return bool(longest - shortest < STEADY * (high - low) and obeyed >= OBEYED)
