"""Short standstills of the operator: a stop where he is always quick, and elsewhere a hesitation.

A task of one second takes less when he becomes quicker. Where many stays are hardly longer than the shortest one that
counts everywhere, shorter ones count too; else a place would be visited less and less often.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.people.activity import OperatorStandstills
from cyclekit.people.tracks import STILL_S, nearest_places

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from cyclekit.dataset.dataset import Place
    from cyclekit.schema import Bools

HARDLY_LONGER = 2.0
"""A stay up to so many times STILL_S is hardly longer."""
MIN_QUICK, QUICK = 5, 0.1
"""Minimum number of such stays at a place, and minimum share of its stays."""
EDGE_S = 0.15
"""A standstill this close to the start or end of an execution extends beyond it, s."""


def quick_places(standstills: Iterable[OperatorStandstills], places: Mapping[str, Place]) -> set[str]:
    """Return the places where many stays are hardly longer than STILL_S, so that shorter ones count too."""
    stays_s: dict[str, list[float]] = defaultdict(list)
    for mine in standstills:
        for name, took_s, inside in zip(nearest_places(mine.at_m, places), mine.took_s, _inside(mine), strict=True):
            if name is not None and inside and took_s >= STILL_S:
                stays_s[name].append(took_s)
    quick = {name: np.count_nonzero(np.array(times) < HARDLY_LONGER * STILL_S) for name, times in stays_s.items()}
    return {name for name, count in quick.items() if count >= max(MIN_QUICK, QUICK * len(stays_s[name]))}


def without_hesitations(
    mine: OperatorStandstills, places: Mapping[str, Place], quick: Collection[str]
) -> OperatorStandstills:
    """Return standstills without those shorter than STILL_S, except those at places that are cut or in `quick`.

    A standstill at the start or end of what is known is cut: it lasted at least so long.
    """
    at = nearest_places(mine.at_m, places)
    at_place, at_quick = (np.array([name in some for name in at], np.bool_) for some in (places, quick))
    return mine.only((mine.took_s >= STILL_S) | np.where(_inside(mine), at_quick, at_place))


def _inside(mine: OperatorStandstills) -> Bools:
    """Return which standstills are not at the start or end of what is known of the execution, shape (M,)."""
    begin_s, end_s = mine.known_s
    times = mine.times_s
    return np.asarray((times[:, 0] > begin_s + EDGE_S) & (times[:, 1] < end_s - EDGE_S))
