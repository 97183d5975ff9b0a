"""Places the sides of a polygon: the mean of all polygons that explain the samples, and intervals from these.

Sides that few operators crossed can be shifted and turned by centimetres without a sample on the wrong side, and any
corner depends on two sides. The mean of such polygons is nearer to the truth than the best one. Where the log shows
when the level changed between two samples, the positions just before and after that time replace both samples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.rule import MetresCard, PolygonCard, SideCard
from cyclekit.learning.rules.edges.brackets import BOUNDS, decided_by
from cyclekit.learning.rules.polygons.polygon_fit import NEAR_M, PolygonSamples, PolygonState, depths_of, normals, walk
from cyclekit.learning.rules.polygons.polygon_sides import needed
from cyclekit.learning.rules.samples.quantities import RulePlace
from cyclekit.learning.rules.samples.regions import polygon_corners

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.dataset.cards.rule import LimitCard
    from cyclekit.learning.rules.samples.rows import RuleRows

EXACT_M = 0.002
"""Standard deviation of positions without noise, m; and an error that all may share, such as one cycle."""
SWEEPS, FIRST = 2000, 500
"""Number of times that each side is moved, and of those at the start that are not counted."""


def mean_polygons(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int], *, seed: int
) -> tuple[tuple[LimitCard, ...], frozenset[RulePlace]]:
    """Return a rule with mean polygons and intervals of their sides, and which sides these are.

    Args:
        limits: The fitted rule.
        rows: Rows to which it was fitted.
        steps: Index of each level.
        seed: Seed of the sampling.
    """
    found: list[LimitCard] = []
    known: set[RulePlace] = set()
    for limit in limits:
        changed = limit
        for name, until in (("within", False), ("until", True)):
            region = getattr(limit, name)
            if region is None or not region.polygons:
                continue
            samples = _samples(limit, rows, steps[limit.scaling], until=until)
            polygons = tuple(_mean(polygon, samples, seed) for polygon in region.polygons)
            changed = structs.replace(changed, **{name: structs.replace(region, polygons=polygons)})
            known |= {
                RulePlace(limit.scaling, until, "polygon", item, edge)
                for item, polygon in enumerate(polygons)
                for edge in range(len(polygon.sides))
            }
        found.append(changed)
    return tuple(found), frozenset(known)


def _samples(limit: LimitCard, rows: RuleRows, step: int, *, until: bool) -> PolygonSamples:
    """Return the samples that show whether a region of a limit holds; at dated changes, the positions beside them."""
    before = rows.before
    gap = np.maximum(1, rows.sample - rows.sample[before])[:, None]
    pace = np.where((before >= 0)[:, None], np.nan_to_num(rows.floor_m - rows.floor_m[before]) / gap, 0.0)
    on = decided_by(limit, rows, step, until=until) & np.isfinite(rows.floor_m[:, 0])
    at, other = rows.dated, rows.level[before]
    change = on & np.isfinite(at[:, 0]) & (other >= step) & ((other == step) != (rows.level == step))
    change &= np.isfinite(rows.floor_m[before, 0])
    after = np.flatnonzero(change)
    on[after], on[before[after]] = False, False
    start, way = rows.floor_m[before[after]], rows.floor_m[after] - rows.floor_m[before[after]]
    beside = [start + part[:, None] * way for part in at[after].T]
    floor = np.concatenate([rows.floor_m[on], *beside])
    slow = np.concatenate([rows.level[on], other[after], rows.level[after]]) == step
    spread = np.full(len(floor), float(np.hypot(rows.noise_m, EXACT_M)))
    paces = np.concatenate([pace[on], pace[after], pace[after]])
    return PolygonSamples(floor, np.where(slow, 1.0, -1.0), spread, paces)


def _mean(polygon: PolygonCard, samples: PolygonSamples, seed: int) -> PolygonCard:
    """Return the mean polygon given the samples."""
    if not (samples.side > 0).any():
        return polygon
    angle = np.array([side.angle_rad for side in polygon.sides])
    out = np.array([side.metres.value for side in polygon.sides])
    middle = samples.floor_m[samples.side > 0].mean(axis=0)
    begin = PolygonState(angle, normals(angle) * out[:, None]).about(middle)
    near = np.abs(depths_of(begin, samples).min(axis=0)) < NEAR_M
    samples, rng = PolygonSamples(*(each[near] for each in samples)), np.random.default_rng(seed)
    begin = needed(begin, samples, rng).about(middle)
    drawn = walk(begin, samples, rng, SWEEPS, adapt=FIRST)
    turns, moves = drawn.turn_rad[FIRST:], drawn.move_m[FIRST:]
    angle, move = begin.angle_rad + turns.mean(axis=0), moves.mean(axis=0)
    low, _, high = np.quantile(moves, BOUNDS, axis=0)
    low, high = move - np.hypot(move - low, EXACT_M), move + np.hypot(high - move, EXACT_M)
    at = np.einsum("sk,sk->s", normals(angle), begin.through_m) + move
    sides = [
        SideCard(angle_rad=float(a % (2 * np.pi)), metres=MetresCard(value=v, low=v + lo, high=v + hi))
        for a, v, lo, hi in zip(angle.tolist(), at.tolist(), (low - move).tolist(), (high - move).tolist(), strict=True)
    ]
    return without_idle(PolygonCard(sides=tuple(sorted(sides, key=lambda side: side.angle_rad))))


def without_idle(polygon: PolygonCard) -> PolygonCard:
    """Return a polygon without sides that lie beyond the corner of their neighbours: in the mean they bound nothing."""
    while len(polygon.sides) > 3 and (found := polygon_corners(polygon)) is not None:
        normal = normals(np.array([side.angle_rad for side in polygon.sides]))
        way = np.array(found) - np.roll(found, 1, axis=0)
        length = normal[:, 0] * way[:, 1] - normal[:, 1] * way[:, 0]
        if length.min() > 0.0:
            break
        idle = int(length.argmin())
        polygon = PolygonCard(sides=(*polygon.sides[:idle], *polygon.sides[idle + 1 :]))
    return polygon
