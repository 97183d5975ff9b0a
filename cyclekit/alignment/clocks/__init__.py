"""One clock per session: how each log's time maps to session time, and how well that is known.

Session time is the robot log's time, counted from its first row: t_session = rate * t_log + offset. What the logs or
the cell file say decides; where nothing does, the recordings are taken to start together, and that is said aloud.
Here are the mappings alone, on arrays; `recording_clocks` chooses which one a log gets.
"""

from __future__ import annotations

from cyclekit.alignment.clocks.coarse import REACH_S, coarse_fit
from cyclekit.alignment.clocks.fit import ASSUMED, ClockFit, ClockStart, Method, fit_clock, follow, lower_envelope
from cyclekit.alignment.clocks.motion import fit_motion
from cyclekit.alignment.clocks.pairs import fit_events, fit_pairs

__all__ = [
    "ASSUMED", "REACH_S", "ClockFit", "ClockStart", "Method", "coarse_fit", "fit_clock", "fit_events", "fit_motion",
    "fit_pairs", "follow", "lower_envelope",
]  # fmt: skip
