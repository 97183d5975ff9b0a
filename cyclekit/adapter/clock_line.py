"""Linear relation between two clocks, from messages with a send time of one clock and a receive time of the other.

A message cannot arrive before it was sent, so the line lies below all (sent, received) points. The line with the least
total distance to them is an edge of their lower convex hull (E. Olson, A Passive Solution to the Sensor Synchronization
Problem, 2010). The minimum delay cannot be separated from a clock offset and remains in the result.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector

MAX_DRIFT = 5e-3
"""Maximum relative drift of a clock (worst published: 0.3 %); delays that grow faster have another cause."""
MAX_RATE = 0.05
"""Maximum relative deviation of simulated time from the receiver's clock; used only where a line fits."""
EXPLAINED = 0.1
"""Maximum typical distance of stamps from such a line, as a share of the clocks' relative drift over the log."""


def least_delays(delay_s: Vector, parts: int) -> Ints:
    """Return the row with the minimum delay, (N,), of each of up to `parts` consecutive parts, ascending."""
    size = -(-delay_s.size // parts)
    whole = delay_s.size // size * size
    rows = delay_s[:whole].reshape(-1, size).argmin(axis=1) + np.arange(0, whole, size)
    return rows if whole == delay_s.size else np.append(rows, whole + delay_s[whole:].argmin())


def slope_under(sent_s: Vector, received_s: Vector, *, same_s: float = 0.0) -> float:
    """Return the slope of the line below all points with the least total delay; 1 for a single point.

    Args:
        sent_s: Send times, shape (N,), s, in any order.
        received_s: Receive times, shape (N,), s.
        same_s: Send times no farther apart than this count as one, s; the smallest delay among them is used.
    """
    order = np.lexsort((received_s, sent_s))
    hull: list[tuple[float, float]] = []
    for px, py in zip(sent_s[order].tolist(), received_s[order].tolist(), strict=True):
        if hull and px - hull[-1][0] <= same_s:
            continue
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2], hull[-1]
            if (bx - ax) * (py - ay) > (by - ay) * (px - ax):
                break
            hull.pop()
        hull.append((px, py))
    if len(hull) < 2:
        return 1.0
    corners = np.array(hull)
    edge = int(np.clip(np.searchsorted(corners[:, 0], sent_s.mean()), 1, len(corners) - 1))
    rise = corners[edge] - corners[edge - 1]
    return float(rise[1] / rise[0])
