"""Error of the simulator, separate from cyclekit's own errors."""

from __future__ import annotations


class SimulationError(ValueError):
    """The simulation is not possible as requested: the message says what was seen and what to change."""
