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
    from collections.abc import Mapping, Sequence

    from cyclekit.schema import Vector
    from cyclekit.segmentation.arrivals import PlaceStandstill, PlaceStandstills
    from cyclekit.segmentation.executions import Execution

VARIES, BLUR_S = 6.0, 0.05
"""Maximum excess of a dwell over the usual one: this multiple of the spread of short standstills, plus the uncertainty
of a standstill, s."""
MIN_LEAD_S = 0.1
"""Minimum time, s, from a signal's last change to the departure: a later change may be an effect of the motion."""
STEADY_S = 0.05
"""Maximum spread, s, of these times for a signal that marks the process."""
OFTEN = 0.5
"""Minimum share of the standstills at a place in which the signal changes."""

MIN_EXECUTIONS = 5
"""Minimum number of executions of the same work with a process time of their own."""
APART_S, APART = 0.2, 0.1
"""Minimum difference of process times between works, s and as a share; and maximum spread of the standstills of a work
whose standstills are the process: waits scatter more."""


class EndSignal(NamedTuple):
    """Signal that marks the process at a place; usual and maximum time from its last change to the end, s."""

    signal: str
    after_s: float
    max_s: float


class Dwell(NamedTuple):
    """The process at a place: usual duration, s; maximum duration, s, beyond which the rest is a wait; its signal.

    `of_work`: the process in executions of other work, by their places, sorted, if its duration depends on that.
    """

    usual_s: float
    max_s: float
    end_signal: EndSignal | None = None
    of_work: Mapping[tuple[str, ...], Dwell] | None = None

    def of(self, execution: Execution) -> Dwell:
        """Return the process in an execution."""
        return (self.of_work or {}).get(_work(execution), self)

    def ready_s(self, standstill: PlaceStandstill) -> float | None:
        """Return the time at which the robot was ready to leave; None without a signal."""
        if self.end_signal is None or (changed := dict(standstill.changes).get(self.end_signal.signal)) is None:
            return None
        return standstill.after(changed, self.end_signal.after_s)

    def excess_from_s(self, standstill: PlaceStandstill) -> float | None:
        """Return the time from which a standstill exceeds its process; None if it does not."""
        ready = self.ready_s(standstill)
        if ready is not None and self.end_signal is not None:
            return ready if standstill.left_s - ready > self.end_signal.max_s - self.end_signal.after_s else None
        longest_s = standstill.after(standstill.arrived_earliest_s, self.max_s)
        return standstill.after(standstill.arrived_s, self.usual_s) if standstill.left_s > longest_s else None


def usual_dwells(executions: Sequence[Execution], standstills: PlaceStandstills) -> dict[str, Dwell]:
    """Return the usual dwell per place: the 10 % quantile of the standstills that no stop prolonged.

    As a standstill may include a wait, the short ones show the process, and their spread shows its variation. The first
    and last standstill of an execution are excluded, as the robot waits for the next cycle there.
    """
    seen: dict[str, list[PlaceStandstill]] = {}
    by_work: dict[str, dict[tuple[str, ...], list[list[float]]]] = {}
    for execution in executions:
        mine: dict[str, list[float]] = {}
        for visit in execution.visits[1:-1]:
            standstill = standstills[execution.run, visit.first, visit.last]
            seen.setdefault(visit.place, []).append(standstill)
            if not standstill.halted:
                mine.setdefault(visit.place, []).append(standstill.lasts_s)
        for place, lasts_s in mine.items():
            by_work.setdefault(place, {}).setdefault(_work(execution), []).append(lasts_s)
    dwells = {}
    for place, there in seen.items():
        unhindered = [standstill.lasts_s for standstill in there if not standstill.halted]
        low, most = _usual(unhindered or [min(standstill.lasts_s for standstill in there)])
        dwell = Dwell(low, min(most, 1.5 * low + 0.2), _end_signal(there))
        dwells[place] = dwell._replace(of_work=_of_works(by_work.get(place, {}), dwell))
    return dwells


def _work(execution: Execution) -> tuple[str, ...]:
    return tuple(sorted(visit.place for visit in execution.visits))


def _of_works(
    by_work: Mapping[tuple[str, ...], list[list[float]]], dwell: Dwell
) -> Mapping[tuple[str, ...], Dwell] | None:
    """Return the process of each work whose standstills, one list per execution, are steady; None if they are alike.

    Steady standstills of works that differ by more than they scatter are as logged: they need no other proof.
    """
    steady = {}
    for work, lasts_s in by_work.items():
        low, middle = np.quantile(np.concatenate(lasts_s), (0.1, 0.5)).tolist()
        if len(lasts_s) >= MIN_EXECUTIONS and middle - low <= APART_S + APART * low:
            steady[work] = lasts_s
    lows = {work: _usual(np.concatenate(lasts_s)) for work, lasts_s in steady.items()}
    usual_s = [low for low, _ in lows.values()]
    if len(lows) < 2 or max(usual_s) - min(usual_s) <= APART_S + APART * min(usual_s):
        return None
    return {work: Dwell(low, min(most, 1.5 * low + 0.2), dwell.end_signal) for work, (low, most) in lows.items()}


def _usual(lasts_s: Sequence[float] | Vector) -> tuple[float, float]:
    """Return the usual value of durations that may be prolonged, and the maximum without prolongation, s."""
    low, middle = np.quantile(lasts_s, (0.1, 0.3)).tolist()
    return low, low + VARIES * (middle - low) + BLUR_S


def _end_signal(standstills: Sequence[PlaceStandstill]) -> EndSignal | None:
    """Return the signal with the most constant time from its last change to departure, if any is constant enough."""
    left = [one for one in standstills if one.left_s == one.departed_earliest_s]  # not stopped at departure
    after_s: dict[str, list[float]] = {}
    for standstill in left:
        for name, at_s in standstill.changes:
            after_s.setdefault(name, []).append(standstill.left_s - at_s)
    often = {name: mine for name, mine in after_s.items() if len(mine) >= max(3, OFTEN * len(left))}
    signals = [EndSignal(name, *_usual(mine)) for name, mine in sorted(often.items())]
    steady = (one for one in signals if one.after_s >= MIN_LEAD_S and one.max_s - one.after_s <= VARIES * STEADY_S)
    return min(steady, key=lambda one: one.max_s - one.after_s, default=None)
