"""Signals that the robot or its program sets: they show no people (`operator_signals`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.signals import OUTPUT, REGISTER, SignalChanges
from cyclekit.derive.signals.signal_responses import flips_s_of, mirrors

if TYPE_CHECKING:
    from cyclekit.derive.signals.signal_evidence import SignalEvidence
    from cyclekit.schema import Bools, Ints

CELL_M = 0.05
"""Grid size of the robot's places, m."""
PROGRAM = 0.97
"""Minimum balanced accuracy with which the robot's task and place predict a signal that the program sets."""


def not_set_by_robot(evidence: SignalEvidence) -> dict[str, SignalChanges]:
    """Return the signals that are no outputs and mirror none."""
    own = [name for name in evidence.signals if name == REGISTER or name.startswith(OUTPUT)]
    own_s = np.sort(np.concatenate([np.empty(0), *(flips_s_of(evidence.signals[name]) for name in own)]))
    return {
        name: changes
        for name, changes in evidence.signals.items()
        if not (name in own or mirrors(flips_s_of(changes), own_s))
    }


def of_program(evidence: SignalEvidence, on: Bools) -> bool:
    """Return whether the robot's task and place predict a signal, on held-out executions."""
    cells = np.floor(evidence.place / CELL_M)
    _, group = np.unique(np.column_stack([evidence.task, np.nan_to_num(cells)]), axis=0, return_inverse=True)
    even = evidence.execution % 2 == 0
    right = np.zeros(len(on), np.bool_)
    for learn in (even, ~even):
        right[~learn] = (_usual_state(group.ravel(), on, learn) == on)[~learn]
    return bool(on.any() and not on.all() and (right[on].mean() + right[~on].mean()) / 2 >= PROGRAM)


def _usual_state(group: Ints, state: Bools, learn: Bools) -> Bools:
    """Return for each sample the more frequent state of its group in the training samples, shape (N,)."""
    count = int(group.max(initial=0)) + 1
    on, every = (np.bincount(group[learn], weight, count) for weight in (state[learn].astype(np.float64), None))
    return np.asarray(2 * on > every)[group]
