"""The line from a header's clock to the recorder's: nothing arrives before it was sent, so it lies under the cloud.

Of all lines that no message arrives before, the one is taken that is nearest to the cloud on the whole (E. Olson, A
Passive Solution to the Sensor Synchronization Problem, 2010): an edge of its lower convex hull. The least delay
cannot be told from an offset, and stays in it. Which clock a topic gets is the business of `clocks`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_DRIFT = 5e-3
"""The worst clock that anybody published ran 0.3 % off; delays that grow faster are no clock."""
MAX_RATE = 0.05
"""Simulated time runs up to this much faster or slower than the recorder's and is followed, where a line fits it."""
EXPLAINED = 0.1
"""A line at such a rate fits if messages typically lie above it by less than this share of how far the clocks part."""
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


def least_delays(delay_s: Array) -> npt.NDArray[np.int64]:
    """Return the row of the least delay in each of up to PARTS consecutive parts of a recording, ascending."""
    size = -(-delay_s.size // PARTS)
    whole = delay_s.size // size * size
    rows = delay_s[:whole].reshape(-1, size).argmin(axis=1) + np.arange(0, whole, size)
    return rows if whole == delay_s.size else np.append(rows, whole + delay_s[whole:].argmin())


def line_under(stamp_s: Array, receive_s: Array, *, drifts: bool = True) -> ClockLine:
    """Return the line under the cloud of (header, receive) times.

    Args:
        stamp_s: Header times, shape (N,), N >= 1, finite, s; in the order of receipt.
        receive_s: When each was received, shape (N,), finite, s.
        drifts: False = a rate of 1 (for a recording too short to tell one).
    """
    x0, y0 = float(stamp_s[0]), float(receive_s[0])
    x, y = stamp_s - x0, receive_s - y0
    lowest = least_delays(y - x)
    rate = _slope(x[lowest], y[lowest]) if drifts and lowest.size > 1 else 1.0
    rate = float(np.clip(rate, 1.0 - MAX_RATE, 1.0 + MAX_RATE))
    above = y - rate * x
    level = float(above.min())
    late = middle(above[:: max(1, above.size // _TYPICAL)]) - level
    apart = abs(rate - 1.0)
    fits = apart < MAX_DRIFT or (apart < MAX_RATE and late < EXPLAINED * apart * float(np.ptp(x)))
    return ClockLine(y0 + level - rate * x0, rate, late, stamp_s.size, fits)


def _slope(x: Array, y: Array) -> float:
    """Return the slope of the lower hull's edge below the middle of the cloud."""
    order = np.lexsort((y, x))
    hull: list[tuple[float, float]] = []
    for px, py in zip(x[order].tolist(), y[order].tolist(), strict=True):
        if hull and px <= hull[-1][0]:
            continue
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2], hull[-1]
            if (bx - ax) * (py - ay) > (by - ay) * (px - ax):
                break
            hull.pop()
        hull.append((px, py))
    if len(hull) < 2:
        return 1.0
    middle = next((k for k in range(1, len(hull) - 1) if hull[k][0] >= float(x.mean())), len(hull) - 1)
    (ax, ay), (bx, by) = hull[middle - 1], hull[middle]
    return (by - ay) / (bx - ax)
