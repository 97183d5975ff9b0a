"""What the simulator refuses, in one class; the border: it knows nothing of cyclekit's own error tree."""

from __future__ import annotations


class SimulationError(ValueError):
    """The simulation cannot be made as asked: the message says what was seen and what to change."""
