"""The line from one clock to another, from two stamps per message: sent by one clock, received by the other.

No message arrives before it was sent, so the line lies below the cloud of (sent, received) stamps. Of all lines below
it the nearest on the whole is taken, an edge of the cloud's lower convex hull (E. Olson, A Passive Solution to the
Sensor Synchronization Problem, 2010). The least delay cannot be told from an offset and stays in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector

MAX_DRIFT = 5e-3
"""The worst published clock is 0.3 % off; delays that grow faster are no clock."""
MAX_RATE = 0.05
"""Simulated time runs up to this much faster or slower than the receiver's and is followed, where a line fits it."""
EXPLAINED = 0.1
"""A line at such a rate fits if stamps typically lie above it by less than this share of what the clocks move apart."""


def least_delays(delay_s: Vector, parts: int) -> Ints:
    """Return the row of the least delay, (N,), in each of up to `parts` consecutive parts, ascending."""
    size = -(-delay_s.size // parts)
    whole = delay_s.size // size * size
    rows = delay_s[:whole].reshape(-1, size).argmin(axis=1) + np.arange(0, whole, size)
    return rows if whole == delay_s.size else np.append(rows, whole + delay_s[whole:].argmin())


def slope_under(sent_s: Vector, received_s: Vector, *, same_s: float = 0.0) -> float:
    """Return the slope of the line below the cloud: there the sum of the delays is least; 1 for a single stamp.

    Args:
        sent_s: Stamps of the sender, shape (N,), s, in any order.
        received_s: Stamps of the receiver, shape (N,), s.
        same_s: Stamps of the sender that are no farther apart are one, of which the least delay counts.
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
