"""Usual dwell at each place from its standstills, and the signal that marks the end of the process.

A standstill consists of the process, sometimes a wait before or after it, and sometimes a stop by the safety system;
motion does not show where one ends and the next begins. A signal that changes within the process (a gripper output, a
register, a PLC event) has a constant time from its last change to the departure in all standstills that nothing
prolonged; in the others, it gives the time at which the robot was ready to leave. Arrival and departure come from
`arrivals`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.segmentation.arrivals import Stand, Stands
    from cyclekit.segmentation.executions import Execution

VARIES, BLUR_S = 6.0, 0.05
"""Maximum excess of a dwell over the usual one: this multiple of the spread of short standstills, plus the uncertainty
of a standstill, s."""
AHEAD_S = 0.1
"""Minimum time, s, from a signal's last change to the departure: a later change may be an effect of the motion."""
STEADY_S = 0.05
"""Maximum spread, s, of these times for a signal that marks the process."""
OFTEN = 0.5
"""Minimum share of the standstills at a place in which the signal changes."""


class Sign(NamedTuple):
    """Signal that marks the process at a place; usual and maximum time from its last change to the end, s."""

    signal: str
    after_s: float
    most_s: float


class Dwell(NamedTuple):
    """The process at a place: usual duration, s; maximum duration, s, beyond which the rest is a wait; its signal."""

    usual_s: float
    most_s: float
    sign: Sign | None = None

    def ready_s(self, stand: Stand) -> float | None:
        """Return the time at which the robot was ready to leave; None without a signal."""
        if self.sign is None or (changed := dict(stand.changes).get(self.sign.signal)) is None:
            return None
        return changed + self.sign.after_s

    def overdue_s(self, stand: Stand) -> float | None:
        """Return the time from which a standstill exceeds its process; None if it does not."""
        ready = self.ready_s(stand)
        if ready is not None and self.sign is not None:
            return ready if stand.left_s - ready > self.sign.most_s - self.sign.after_s else None
        return stand.arrived_s + self.usual_s if stand.lasts_s > self.most_s else None


def usual_dwells(executions: Sequence[Execution], stands: Stands) -> dict[str, Dwell]:
    """Return the usual dwell per place: the 10 % quantile of the standstills that no stop prolonged.

    As a standstill may include a wait, the short ones show the process, and their spread shows its variation. The first
    and last standstill of an execution are excluded, as the robot waits for the next cycle there.
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
    """Return the usual value of durations that may be prolonged, and the maximum without prolongation, s."""
    low, middle = np.quantile(lasts_s, (0.1, 0.3)).tolist()
    return low, low + VARIES * (middle - low) + BLUR_S


def _sign(stands: Sequence[Stand]) -> Sign | None:
    """Return the signal with the most constant time from its last change to departure, if any is constant enough."""
    left = [stand for stand in stands if stand.left_s == stand.free_s]  # not stopped at departure
    after_s: dict[str, list[float]] = {}
    for stand in left:
        for name, at_s in stand.changes:
            after_s.setdefault(name, []).append(stand.left_s - at_s)
    often = {name: mine for name, mine in after_s.items() if len(mine) >= max(3, OFTEN * len(left))}
    signs = [Sign(name, *_usual(mine)) for name, mine in sorted(often.items())]
    steady = (sign for sign in signs if sign.after_s >= AHEAD_S and sign.most_s - sign.after_s <= VARIES * STEADY_S)
    return min(steady, key=lambda sign: sign.most_s - sign.after_s, default=None)
