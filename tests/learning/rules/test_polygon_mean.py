"""The sides of a polygon are where the mean of all polygons that explain the samples has them."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec import structs

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, PolygonCard, RegionCard, SideCard
from cyclekit.learning.rules.cuts import LimitRows
from cyclekit.learning.rules.polygon_mean import mean_polygons
from cyclekit.learning.rules.polygons import best_polygon
from cyclekit.learning.rules.quantities import quantities
from cyclekit.learning.rules.regions import polygon_corners
from cyclekit.learning.rules.rows import RuleRows

STEPS = {0.3: 0, 1.0: 1}
CORNERS_M = np.array([(1.0, -0.5), (2.2, -0.6), (2.4, 0.7), (1.2, 0.8)])


def rows_of(seed: int, *, passes: int = 40, noise_m: float = 0.0) -> RuleRows:
    """Straight passes over the floor, ten samples a second; slow within CORNERS_M."""
    rng = np.random.default_rng(seed)
    t = np.arange(30) / 29
    ends = rng.uniform([0.4, -1.3], [3.0, 1.5], (2, passes, 2))
    xy = (ends[0][:, None] + (ends[1] - ends[0])[:, None] * t[:, None]).reshape(-1, 2)
    way = np.roll(CORNERS_M, -1, axis=0) - CORNERS_M
    to = xy[:, None] - CORNERS_M
    slow = (way[:, 0] * to[..., 1] - way[:, 1] * to[..., 0] > 0).all(axis=1)
    human = np.column_stack([xy + rng.normal(0.0, noise_m, xy.shape), np.zeros(len(xy))])
    number = np.repeat(np.arange(passes), len(t))
    return RuleRows.made(np.zeros_like(human), human, np.where(slow, 0, 1), number, stretch=number)


def fitted(rows: RuleRows) -> tuple[LimitCard, ...]:
    polygon = best_polygon(LimitRows(rows.positions, rows.level == 0, np.ones(len(rows))))
    assert polygon is not None
    return (LimitCard(scaling=0.3, within=RegionCard(polygons=(polygon,))),)


def off_m(limits: tuple[LimitCard, ...]) -> float:
    """Error of the worst corner."""
    seen = np.array(polygon_corners(limits[0].within.polygons[0]))
    return max(float(np.linalg.norm(seen - corner, axis=1).min()) for corner in CORNERS_M)


def test_the_mean_polygon_is_nearer_to_the_truth_than_the_best() -> None:
    before, after = [], []
    for seed in range(6, 10):
        rows = rows_of(seed, passes=60)
        limits = fitted(rows)
        before.append(off_m(limits))
        after.append(off_m(mean := mean_polygons(limits, rows, STEPS, seed=0)[0]))
        assert len(mean[0].within.polygons[0].sides) == len(CORNERS_M)
    assert np.mean(after) < 0.9 * np.mean(before)


@pytest.mark.parametrize("noise_m", [0.0, 0.03])
def test_intervals_of_sides_hold(noise_m: float) -> None:
    held = []
    for seed in range(20, 24):
        rows = rows_of(seed, passes=25, noise_m=noise_m)
        found, known = mean_polygons(fitted(rows), rows, STEPS, seed=0)
        assert known == set(quantities(found))
        polygon = found[0].within.polygons[0]
        seen = polygon_corners(polygon)
        assert seen is not None
        for number, side in enumerate(polygon.sides):
            middle = (np.array(seen[number - 1]) + np.array(seen[number])) / 2
            normal = np.array([np.cos(side.angle_rad), np.sin(side.angle_rad)])
            along = np.array([-normal[1], normal[0]])
            # where the line through the middle of the side, along its normal, meets the true polygon
            cross = [
                float(np.linalg.solve(np.column_stack([normal, a - b]), a - middle)[0])
                for a, b in zip(CORNERS_M, np.roll(CORNERS_M, -1, axis=0), strict=True)
                if abs(along @ (b - a)) > 0.5 * np.linalg.norm(b - a)
            ]
            at_m = side.metres.value + min(cross, key=abs)
            assert side.metres.low is not None
            assert side.metres.high is not None
            held.append(side.metres.low <= at_m <= side.metres.high)
    assert np.mean(held) >= 0.85


def test_a_polygon_without_samples_inside_stays() -> None:
    rows = rows_of(0)
    fast = RuleRows.made(rows.at_m[:, :3], rows.at_m[:, 3:], np.ones(len(rows)), rows.execution)
    side = SideCard(angle_rad=0.1, metres=MetresCard(value=1.0))
    limits = (LimitCard(scaling=0.3, within=RegionCard(polygons=(PolygonCard(sides=(side,)),))),)
    assert mean_polygons(limits, fast, STEPS, seed=0)[0] == limits


def test_an_open_polygon_has_intervals_too() -> None:
    rows = rows_of(1)
    limits = fitted(rows)
    open_to = PolygonCard(sides=limits[0].within.polygons[0].sides[:2])
    region = structs.replace(limits[0].within, polygons=(open_to,))
    found, known = mean_polygons((structs.replace(limits[0], within=region),), rows, STEPS, seed=0)
    assert len(known) == 2
    assert all(metres.low is not None for metres in quantities(found).values())
