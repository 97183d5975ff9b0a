"""Two conditions combined: slow while the operator is nearer than a threshold, or in a rectangle."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import MetresCard, NearerCard, RegionCard
from cyclekit.learning.rules.families.distance import nearer
from cyclekit.learning.rules.families.family import Family
from cyclekit.learning.rules.families.rectangle import at_any_angle, straight
from cyclekit.learning.rules.samples.distances import DISTANCES, TO_LINK
from cyclekit.learning.rules.samples.regions import inside

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclekit.learning.rules.cuts import LimitRows

    _Rectangle = Callable[[LimitRows, RegionCard | None], RegionCard]

_ROUNDS = 10
_PURE = 0.995
"""Minimum share of slow samples nearer than the threshold at the start."""
_GAIN = 2e-4
"""Minimum gain of a second condition, as a share of the samples."""


def _fit(rows: LimitRows, start: RegionCard | None, distance: str, rectangle: _Rectangle) -> RegionCard:
    if start is not None and not (start.nearer and start.rectangles):
        return rectangle(rows, start) if start.rectangles else nearer(rows, None, distance)
    if start is not None:  # a rectangle found by chance explains less than the distance alone
        both = _alternating(rows, RegionCard(nearer=start.nearer), start, distance, rectangle)
        return min(both, nearer(rows, None, distance), key=rows.wrong)
    single = [nearer(rows, None, distance), rectangle(rows, None)]
    begins = [_purely_slow(rows, distance), single[0], _near_outside(rows, single[1], distance)]
    best = min((_alternating(rows, begin, None, distance, rectangle) for begin in begins), key=rows.wrong)
    least = rows.wrong(best) + _GAIN * float(rows.weight.sum())
    return next((region for region in single if rows.wrong(region) <= least), best)


def _alternating(
    rows: LimitRows, near: RegionCard, start: RegionCard | None, distance: str, rectangle: _Rectangle
) -> RegionCard:
    """Return the union of both conditions, each fitted in turn to the rows that the other leaves."""
    zone, wrong = start, np.inf
    for _ in range(_ROUNDS):
        zone = rectangle(rows.where(~inside(near, rows.positions)), zone if zone and zone.rectangles else None)
        near = nearer(rows.where(~inside(zone, rows.positions)), None, distance)
        found = RegionCard(nearer=near.nearer, rectangles=zone.rectangles)
        missed = rows.wrong(found)
        if missed >= wrong:
            break
        wrong = missed
    return found


def _near_outside(rows: LimitRows, zone: RegionCard, distance: str) -> RegionCard:
    return nearer(rows.where(~inside(zone, rows.positions)), None, distance)


def _purely_slow(rows: LimitRows, distance: str) -> RegionCard:
    """Return the largest threshold within which almost all samples are slow."""
    order = np.argsort(rows.positions.apart_m[distance], kind="stable")
    weight = rows.weight[order]
    share = np.cumsum(weight * rows.slow[order]) / np.maximum(np.cumsum(weight), 1e-9)
    pure = np.flatnonzero(share >= _PURE)
    metres = float(rows.positions.apart_m[distance][order][pure[-1]]) if len(pure) else np.inf
    if not np.isfinite(metres):
        return RegionCard()
    return RegionCard(nearer=(NearerCard(distance=distance, metres=MetresCard(value=metres)),))


MIXTURE = {
    f"{name}, or {kind}": Family(partial(_fit, distance=name, rectangle=fit), (name,), mixed=True)
    for kind, fit in (("rectangle on the floor", straight), ("turned rectangle on the floor", at_any_angle))
    for name in (*DISTANCES, TO_LINK)
}
