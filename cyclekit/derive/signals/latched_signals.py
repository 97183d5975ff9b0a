"""Stops that last until somebody resets them: a guard door or light curtain with a reset (acknowledge) button.

The stop begins when the signal shows a person. It ends when the reset button is pressed (or let go) after the signal
shows nobody again: the manual reset function of ISO 13849-1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.signals import INPUT, SignalChanges

if TYPE_CHECKING:
    from cyclekit.schema import Vector

ON, OFF = "1", "0"
_FREE, _SET, _BEGIN, _RESET = range(4)


def latched(
    signal: SignalChanges, occupied: str, reset: SignalChanges, reset_at: str, begins_s: Vector
) -> SignalChanges:
    """Return a stop as a signal: ON from when a signal is occupied until the reset after it is free again, else OFF.

    The state at the beginning of a log, and after a gap in it, was not logged. If the next change is a reset, somebody
    had a reason to press the button: it was ON.

    Args:
        signal: The signal that starts the stop.
        occupied: Its value while a person is present.
        reset: The signal of the button.
        reset_at: Value to which it changes at the reset.
        begins_s: Times at which logging begins, or goes on after a gap, s.
    """
    sets_s, frees_s = signal.t_s[signal.value == occupied], signal.t_s[signal.value != occupied]
    begins_s = np.append(begins_s, signal.t_s[:1])
    kinds = ((frees_s, _FREE), (sets_s, _SET), (begins_s, _BEGIN), (reset.to(reset_at), _RESET))
    t_s = np.concatenate([times_s for times_s, _ in kinds])
    kind = np.concatenate([np.full(len(times_s), number) for times_s, number in kinds])
    order = np.lexsort((kind, t_s))
    t_s, kind = t_s[order], kind[order]
    ends = np.flatnonzero((kind == _SET) | (kind == _RESET))
    after = np.append(ends, -1)[np.searchsorted(ends, np.arange(len(kind)), side="right")]
    pressed_next = (after >= 0) & (kind[after] == _RESET)
    state, held, on = False, False, np.zeros(len(kind), np.bool_)
    for number, one in enumerate(kind.tolist()):
        held = one == _SET or (held and one != _FREE)
        state = held or (bool(pressed_next[number]) if one == _BEGIN else state and one != _RESET)
        on[number] = state
    last = np.diff(t_s, append=np.inf) > 0.0
    t_s, on = t_s[last], on[last]
    changed = np.diff(on, prepend=~on[:1])
    return SignalChanges(t_s[changed], np.where(on[changed], ON, OFF))


def begins_of(signal: str, robot_begins_s: Vector) -> Vector:
    """Return the times at which logging of a signal begins or goes on after a gap: those of the robot log for its bits.

    Events have no gaps: each change is a row.
    """
    return robot_begins_s if signal.startswith(INPUT) else np.empty(0)
