"""When the operator came to a standstill or went from it, where the tracker lost him just then.

He was last seen standing, and is seen again on his way or elsewhere: the way between takes as long as people walk, and
he stood for the rest of the time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.people.tracks import OCCLUDED_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Vector

WALK_M_S = 1.2
"""Usual walking speed, m/s."""


def standstill_times(t_s: Vector, at_m: Floats, spans: Sequence[tuple[int, int]]) -> Floats:
    """Return start and end of each standstill, shape (M, 2), s.

    Args:
        t_s: Times, shape (T,), s.
        at_m: Positions on the floor, shape (T, 2), m; NaN = not seen. A gap of more than OCCLUDED_S tells nothing.
        spans: First and last row of each of the M standstills.
    """
    times_s = np.array([(t_s[a], t_s[b]) for a, b in spans]).reshape(-1, 2)
    seen = np.flatnonzero(np.isfinite(at_m).all(axis=1))
    stands = np.zeros(len(t_s), bool)
    for a, b in spans:
        stands[max(a - 1, 0) : b + 2] = True  # his speed is not known beside a gap
    for number, (a, b) in enumerate(spans):
        for side, edge, step in ((0, a, -1), (1, b, 1)):
            other = int(np.searchsorted(seen, edge)) + step
            if 0 <= other < len(seen) and abs(int(seen[other]) - edge) == 1:
                edge, other = int(seen[other]), other + step
            if not 0 <= other < len(seen) or abs(int(seen[other]) - edge) == 1:
                continue
            row = int(seen[other])
            gap_s = abs(float(t_s[row] - t_s[edge]))
            spare_s = gap_s - float(np.linalg.norm(at_m[row] - at_m[edge])) / WALK_M_S
            if gap_s <= OCCLUDED_S and spare_s > 0.0:  # if he stands when seen again, he may have stood at either
                times_s[number, side] = t_s[edge] + step * (0.5 * spare_s if stands[row] else spare_s)
    return times_s


__all__ = ["standstill_times"]
