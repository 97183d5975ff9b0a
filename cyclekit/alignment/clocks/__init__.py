"""One clock per session: the map from each log's time to session time, and its uncertainty.

Session time is the robot log's time, counted from its first row: t_session = rate * t_log + offset. The map comes from
the logs or the cell file; if neither gives it, a common start of the recordings is assumed, with a warning. This folder
contains the fits, on arrays; `recording_clocks` chooses the one for each log.
"""

from __future__ import annotations

from cyclekit.alignment.clocks.fit import ASSUMED, ClockFit, ClockStart, Method, fit_clock, follow, lower_envelope
from cyclekit.alignment.clocks.motion import fit_motion
from cyclekit.alignment.clocks.pairs import fit_events, fit_pairs

__all__ = [
    "ASSUMED", "ClockFit", "ClockStart", "Method", "fit_clock", "fit_events", "fit_motion", "fit_pairs", "follow",
    "lower_envelope",
]  # fmt: skip
