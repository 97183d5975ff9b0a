"""Line from a header's clock to the recorder's, below all points, as no message arrives before it is sent.

`cyclekit.adapter.clock_line` finds the line; `clocks` chooses the clock of a topic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cyclekit.adapter.clock_line import EXPLAINED, MAX_DRIFT, MAX_RATE, least_delays, slope_under

Array = npt.NDArray[np.float64]

PARTS = 512
_TYPICAL = 20_000  # maximum number of messages used for the typical delay


@dataclass(frozen=True)
class ClockLine:
    """t_receive = rate * t_header + offset_s, for the messages with minimum delay.

    Attributes:
        delay_s: Median delay above the minimum, s.
        steps: Number of messages used for the fit.
        fits: False if the clocks drift apart faster than clocks do, and no line fits.
    """

    offset_s: float
    rate: float
    delay_s: float
    steps: int
    fits: bool = True

    @property
    def drifts(self) -> bool:
        """True if the rate is plausible for a clock; otherwise the time is simulated or artificial."""
        return abs(self.rate - 1.0) < MAX_DRIFT

    def of(self, stamp_s: Array) -> Array:
        """Return header times, shape (N,), s, in the recorder's clock."""
        return self.rate * stamp_s + self.offset_s


def middle(values: Array) -> float:
    """Return the median, the upper one of two; `numpy.median` would import more of numpy."""
    return float(np.partition(values, values.size // 2)[values.size // 2])


def line_under(stamp_s: Array, receive_s: Array, *, drifts: bool = True) -> ClockLine:
    """Return the line below all (header, receive) points.

    Args:
        stamp_s: Header times, shape (N,), N >= 1, finite, s; in the order of receipt.
        receive_s: Receive times, shape (N,), finite, s.
        drifts: False = use rate 1 (for a recording too short to fit a rate).
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
