"""Data in which signals of people are searched for (`operator_signals`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.signals import SignalChanges
    from cyclekit.schema import Ints, Vector

AT_ONCE_S = 0.012
"""Maximum delay, s, at which a signal may be cause or effect of the level; such signals are tried after all others."""
ROWS = 1.25
"""The same, in rows of the log: a field and the speed that it lowers at once change in the same row."""


@dataclass(frozen=True)
class SignalEvidence:
    """Data of some sessions: N samples, and the times of changes of level and signals, at the log's rate.

    The times of different sessions do not overlap.

    Attributes:
        t_s: Time, shape (N,).
        level: Index of the commanded level, -1 = unknown, shape (N,).
        place: The robot's TCP on the floor, shape (N, 2), m.
        task: Number of the robot's task, shape (N,).
        execution: Number of the execution, shape (N,).
        falls_s, rises_s: Times when the level began to fall and to rise, s.
        signals: Changes of each signal.
        levels: Levels of the scaling, ascending.
        period_s: Time between rows of the robot log, s: no delay below it can be seen.
        begins_s: Times at which the robot log begins, or goes on after a gap, s.
    """

    t_s: Vector
    level: Ints
    place: Vector
    task: Ints
    execution: Ints
    falls_s: Vector
    rises_s: Vector
    signals: Mapping[str, SignalChanges]
    levels: Sequence[float]
    period_s: float = 0.0
    begins_s: Vector = field(default_factory=lambda: np.empty(0))

    @property
    def at_once_s(self) -> float:
        """Maximum delay, s, at which a signal may be cause or effect of the level."""
        return max(AT_ONCE_S, ROWS * self.period_s)
