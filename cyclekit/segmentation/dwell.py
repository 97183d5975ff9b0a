"""How long the process at each place takes, from what stands there have in common, and which signal tells when it ends.

A stand is process, then at times waiting (before the process or after it), then at times a safety halt, and motion
shows none of the borders. A signal that changes within the process (a gripper's output, a register, an event of a PLC)
has the same time from its last change to the departure in all stands that nothing prolonged; in any other stand it
tells when the robot was ready to leave. When it arrived and left is the business of `stand`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.segmentation.arrivals import Stand, Stands
    from cyclekit.segmentation.executions import Execution

VARIES, BLUR_S = 6.0, 0.05
"""A stand is process while it is longer than usual by no more than so many times what short ones differ by, plus
what a stand's length is known to."""
AHEAD_S = 0.1
"""A signal that changes nearer than this to the departures may follow the motion: it would change after a halt too."""
STEADY_S = 0.05
"""The times from a signal's last change to the departure differ by no more than this where it tells of the process."""
OFTEN = 0.5
"""Least share of the standstills at a place in which it changes."""


class Sign(NamedTuple):
    """A signal that tells when the process at a place is over, seconds after its last change, usually and at most."""

    signal: str
    after_s: float
    most_s: float


class Dwell(NamedTuple):
    """The process at a place, seconds: how long it takes, how long at most before the rest is waiting, and its sign."""

    usual_s: float
    most_s: float
    sign: Sign | None = None

    def ready_s(self, stand: Stand) -> float | None:
        """Return when the robot was ready to leave, None where no signal tells."""
        if self.sign is None or (changed := dict(stand.changes).get(self.sign.signal)) is None:
            return None
        return changed + self.sign.after_s

    def overdue_s(self, stand: Stand) -> float | None:
        """Return since when a stand has lasted longer than its process, None if it did not; waiting before it may."""
        ready = self.ready_s(stand)
        if ready is not None and self.sign is not None:
            return ready if stand.left_s - ready > self.sign.most_s - self.sign.after_s else None
        return stand.arrived_s + self.usual_s if stand.lasts_s > self.most_s else None


def usual_dwells(executions: Sequence[Execution], stands: Stands) -> dict[str, Dwell]:
    """Return the usual dwell per place: short (the lowest tenth) among the stands that no halt prolonged.

    A stand is process and then, at times, waiting; so the process shows in the short ones, and how much it varies in
    how far they differ. The first and last stand of an execution are not counted: there the robot waits for the next
    cycle.
    """
    seen: dict[str, list[Stand]] = {}
    for execution in executions:
        for visit in execution.visits[1:-1]:
            seen.setdefault(visit.place, []).append(stands[execution.run, visit.first, visit.last])
    dwells = {}
    for place, mine in seen.items():
        unhindered = [stand.lasts_s for stand in mine if not stand.halted]
        low, most = _usual(unhindered or [min(stand.lasts_s for stand in mine)])
        dwells[place] = Dwell(low, min(most, 1.5 * low + 0.2), _sign(mine))
    return dwells


def _usual(lasts_s: Sequence[float]) -> tuple[float, float]:
    """Return the usual time of something that may be prolonged, and its maximum without that."""
    low, middle = np.quantile(lasts_s, (0.1, 0.3)).tolist()
    return low, low + VARIES * (middle - low) + BLUR_S


def _sign(stands: Sequence[Stand]) -> Sign | None:
    """Return the signal whose last change is the steadiest time ahead of the departures from a place, if any is."""
    left = [stand for stand in stands if stand.left_s == stand.free_s]  # and not halted first
    after_s: dict[str, list[float]] = {}
    for stand in left:
        for name, at_s in stand.changes:
            after_s.setdefault(name, []).append(stand.left_s - at_s)
    often = {name: mine for name, mine in after_s.items() if len(mine) >= max(3, OFTEN * len(left))}
    signs = [Sign(name, *_usual(mine)) for name, mine in sorted(often.items())]
    steady = (sign for sign in signs if sign.after_s >= AHEAD_S and sign.most_s - sign.after_s <= VARIES * STEADY_S)
    return min(steady, key=lambda sign: sign.most_s - sign.after_s, default=None)
