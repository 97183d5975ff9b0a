"""A distance: slow while the operator is nearer than a threshold."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from cyclekit.dataset.cards.rule import NearerCard, RegionCard
from cyclekit.learning.rules.cuts import best_cut
from cyclekit.learning.rules.families.family import Family
from cyclekit.learning.rules.samples.distances import DISTANCES, TO_LINK

if TYPE_CHECKING:
    from cyclekit.learning.rules.cuts import LimitRows


def nearer(rows: LimitRows, start: RegionCard | None, distance: str) -> RegionCard:
    """Return the region nearer than the best threshold; empty if the threshold is never crossed."""
    del start
    metres = best_cut(rows.positions.apart_m[distance], rows.slow, rows.weight).card()
    return RegionCard() if metres is None else RegionCard(nearer=(NearerCard(distance=distance, metres=metres),))


DISTANCE = {name: Family(partial(nearer, distance=name), (name,)) for name in (*DISTANCES, TO_LINK)}
