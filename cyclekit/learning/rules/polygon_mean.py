"""Places the sides of a polygon: the mean of all polygons that explain the samples, and intervals from these.

Sides that few operators crossed can be shifted and turned by centimetres without a sample on the wrong side, and any
corner depends on two sides. The mean of such polygons is nearer to the truth than the best one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import structs
from scipy.special import ndtr

from cyclekit.dataset.cards.rule import MetresCard, PolygonCard, SideCard
from cyclekit.learning.rules.brackets import BOUNDS, decided_by, spread_m
from cyclekit.learning.rules.quantities import RulePlace

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards.rule import LimitCard
    from cyclekit.learning.rules.rows import RuleRows
    from cyclekit.schema import Bools, Floats, Vector

NEAR_M = 0.25
"""Maximum distance, m, of samples from the fitted polygon."""
EXACT_M = 0.002
"""Standard deviation of positions without noise, m."""
WRONG = 0.001
"""Prior probability that a sample's level is wrong."""
SWEEPS, FIRST = 2000, 500
"""Number of times that each side is moved, and of those at the start that are not counted."""
NEEDED = 8.0
"""Minimum log-likelihood that a side must add."""
NEAR_FIT = 0.1
"""Prior standard deviation of a side from the fitted one, rad and m: samples may hardly show it."""
_STEP, _ANY_SIZE = 1.7, 0.3
"""Size of a step, in standard deviations of the side; share of steps of any size."""
_MOST, _DECADES = 0.1, 2.5
"""Largest such step, rad and m, and decades of smaller ones."""


class _Samples(NamedTuple):
    """K samples: floor position (K, 2), m, 1 = inside or -1 = outside, (K,), standard deviation (K,), m."""

    floor_m: Floats
    side: Vector
    spread_m: Vector


class _Sides(NamedTuple):
    """S sides: angle of the normal (S,), rad, and a point (S, 2), m, about which it turns."""

    angle_rad: Vector
    through_m: Floats


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
            on = decided_by(limit, rows, steps[limit.scaling], until=until)
            slow = rows.level == steps[limit.scaling]
            polygons = tuple(_mean(polygon, rows, on, slow, seed) for polygon in region.polygons)
            changed = structs.replace(changed, **{name: structs.replace(region, polygons=polygons)})
            known |= {
                RulePlace(limit.scaling, until, "polygon", item, edge)
                for item, polygon in enumerate(polygons)
                for edge in range(len(polygon.sides))
            }
        found.append(changed)
    return tuple(found), frozenset(known)


def _mean(polygon: PolygonCard, rows: RuleRows, on: Bools, slow: Bools, seed: int) -> PolygonCard:
    """Return the mean polygon given the samples `on`, which are inside where `slow`."""
    on = on & np.isfinite(rows.floor_m[:, 0])
    if not (on & slow).any():
        return polygon
    angle = np.array([side.angle_rad for side in polygon.sides])
    out = np.array([side.metres.value for side in polygon.sides])
    middle = rows.floor_m[on & slow].mean(axis=0)
    begin = _Sides(angle, middle + _normals(angle) * (out - _normals(angle) @ middle)[:, None])
    near = np.flatnonzero(on)[np.abs(_depths(begin, angle, 0.0 * out, rows.floor_m[on]).min(axis=0)) < NEAR_M]
    spread = spread_m(rows, float(np.hypot(rows.noise_m, EXACT_M)), rows.floor_m)[near]
    samples = _Samples(rows.floor_m[near], np.where(slow[near], 1.0, -1.0), spread)
    begin = _needed(begin, samples)
    turns, moves = _chain(begin, samples, np.random.default_rng(seed))
    angle, move = begin.angle_rad + turns.mean(axis=0), moves.mean(axis=0)
    low, _, high = np.quantile(moves, BOUNDS, axis=0)
    at = np.einsum("sk,sk->s", _normals(angle), begin.through_m) + move
    sides = [
        SideCard(angle_rad=float(a % (2 * np.pi)), metres=MetresCard(value=v, low=v + lo, high=v + hi))
        for a, v, lo, hi in zip(angle.tolist(), at.tolist(), (low - move).tolist(), (high - move).tolist(), strict=True)
    ]
    return PolygonCard(sides=tuple(sorted(sides, key=lambda side: side.angle_rad)))


def _needed(sides: _Sides, samples: _Samples) -> _Sides:
    """Return the sides without those that samples hardly show: these may lie anywhere beyond the others."""
    while len(sides.angle_rad) > 1:
        depths = _depths(sides, sides.angle_rad, np.zeros_like(sides.angle_rad), samples.floor_m)
        without = [_fit(np.delete(depths, side, axis=0), samples) for side in range(len(depths))]
        if _fit(depths, samples) - max(without) > NEEDED:
            break
        sides = _Sides(*(np.delete(each, int(np.argmax(without)), axis=0) for each in sides))
    return sides


def _chain(begin: _Sides, samples: _Samples, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return turns, rad, and moves, m, of the sides, each shape (draws, S), drawn by the Metropolis method."""
    turn, move = np.zeros_like(begin.angle_rad), np.zeros_like(begin.angle_rad)
    depths = _depths(begin, begin.angle_rad, move, samples.floor_m)
    fit = _fit(depths, samples)
    drawn: list[Floats] = []
    scales: Floats | None = None
    for sweep in range(SWEEPS):
        scales = _spreads(drawn) if sweep == FIRST else scales
        for side in range(len(turn)):
            step = _step(None if scales is None else scales[side], rng)
            one = _Sides(begin.angle_rad[[side]], begin.through_m[[side]])
            tried = depths.copy()
            tried[side] = _depths(one, one.angle_rad + turn[side] + step[0], move[[side]] + step[1], samples.floor_m)[0]
            new, was = _fit(tried, samples), np.array([turn[side], move[side]])
            prior = float((was @ was - (was + step) @ (was + step)) / (2 * NEAR_FIT**2))
            if np.log(rng.random()) < new - fit + prior:
                depths, fit = tried, new
                turn[side], move[side] = turn[side] + step[0], move[side] + step[1]
        drawn.append(np.array([turn, move]))
    turns, moves = np.array(drawn[FIRST:]).swapaxes(0, 1)
    return turns, moves


def _spreads(drawn: Sequence[Floats]) -> Floats:
    """Return how turn and move of each side vary in the last draws, as a factor of their covariance, (S, 2, 2)."""
    each = np.array(drawn[len(drawn) // 2 :]).transpose(2, 1, 0)
    return np.array([np.linalg.cholesky(np.cov(one) + 1e-10 * np.eye(2)) for one in each])


def _step(spread: Floats | None, rng: np.random.Generator) -> Vector:
    """Return a random turn, rad, and move, m, of a side: of any size, or mostly as the side varies."""
    if spread is None or rng.random() < _ANY_SIZE:
        return np.asarray(_MOST * 10.0 ** -rng.uniform(0.0, _DECADES, 2) * rng.normal(size=2))
    return np.asarray(_STEP * spread @ rng.normal(size=2))


def _depths(sides: _Sides, angle_rad: Vector, move_m: Vector, floor_m: Floats) -> Floats:
    """Return how far points (K, 2), m, lie within each side at another angle, moved outwards, shape (S, K), m."""
    normal = _normals(angle_rad)
    out = np.einsum("sk,sk->s", normal, sides.through_m) + move_m
    return np.asarray(out[:, None] - normal @ floor_m.T)


def _normals(angle_rad: Vector) -> Floats:
    return np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])


def _fit(depths: Floats, samples: _Samples) -> float:
    """Return the log-likelihood of the samples, given how far each lies within each side (S, K), m."""
    right = ndtr(samples.side * depths.min(axis=0) / samples.spread_m)
    return float(np.log(WRONG + (1.0 - WRONG) * right).sum())
