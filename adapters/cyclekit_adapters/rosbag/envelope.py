"""The line from a header's clock to the recorder's: nothing arrives before it was sent, so it lies under the cloud.

How the line is found: `cyclekit.adapter.clock_line`. Which clock a topic gets is decided in `clocks`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cyclekit.adapter.clock_line import EXPLAINED, MAX_DRIFT, MAX_RATE, least_delays, slope_under

Array = npt.NDArray[np.float64]

PARTS = 512
_TYPICAL = 20_000  # messages looked at for the typical delay


@dataclass(frozen=True)
class ClockLine:
    """t_receive = rate * t_header + offset_s, for the messages that took no longer than they must.

    Attributes:
        delay_s: Median of what messages took longer.
        steps: Messages in whose delays the line was looked for.
        fits: False = the clocks move apart by more than clocks do, and no line follows them.
    """

    offset_s: float
    rate: float
    delay_s: float
    steps: int
    fits: bool = True

    @property
    def drifts(self) -> bool:
        """Whether the rate is one that clocks have; else the time is simulated, or made up."""
        return abs(self.rate - 1.0) < MAX_DRIFT

    def of(self, stamp_s: Array) -> Array:
        """Return header times, shape (N,), in the recorder's clock."""
        return self.rate * stamp_s + self.offset_s


def middle(values: Array) -> float:
    """Return the median, the upper of two; `numpy.median` would import a part of numpy that nothing here needs."""
    return float(np.partition(values, values.size // 2)[values.size // 2])


def line_under(stamp_s: Array, receive_s: Array, *, drifts: bool = True) -> ClockLine:
    """Return the line under the cloud of (header, receive) times.

    Args:
        stamp_s: Header times, shape (N,), N >= 1, finite, s; in the order of receipt.
        receive_s: When each was received, shape (N,), finite, s.
        drifts: False = a rate of 1 (for a recording too short to tell one).
    """
    x0, y0 = float(stamp_s[0]), float(receive_s[0])
    x, y = stamp_s - x0, receive_s - y0
    lowest = least_delays(y - x, PARTS)
    rate = slope_under(x[lowest], y[lowest]) if drifts and lowest.size > 1 else 1.0
    rate = float(np.clip(rate, 1.0 - MAX_RATE, 1.0 + MAX_RATE))
    above = y - rate * x
    level = float(above.min())
    late = middle(above[:: max(1, above.size // _TYPICAL)]) - level
    apart = abs(rate - 1.0)
    fits = apart < MAX_DRIFT or (apart < MAX_RATE and late < EXPLAINED * apart * float(np.ptp(x)))
    return ClockLine(y0 + level - rate * x0, rate, late, stamp_s.size, fits)
