"""The sides of a polygon are where the mean of all polygons that explain the samples has them."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, PolygonCard, RegionCard, SideCard
from cyclekit.learning.rules.cuts import LimitRows
from cyclekit.learning.rules.polygons.polygon_mean import mean_polygons, without_idle
from cyclekit.learning.rules.polygons.polygons import best_polygon
from cyclekit.learning.rules.samples.quantities import quantities
from cyclekit.learning.rules.samples.regions import polygon_corners
from cyclekit.learning.rules.samples.rows import RuleRows

STEPS = {0.3: 0, 1.0: 1}
CORNERS_M = np.array([(1.0, -0.5), (2.2, -0.6), (2.4, 0.7), (1.2, 0.8)])


def rows_of(
    seed: int, *, passes: int = 40, noise_m: float = 0.0, to_m: tuple[float, float] = (3.0, 1.5), parts: int = 0
) -> RuleRows:
    """Straight passes over the floor, ten samples a second; slow within CORNERS_M.

    With `parts`, the log has that many rows from one sample to the next, which date the changes.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(30) / 29
    ends = rng.uniform([0.4, -1.3], to_m, (2, passes, 2))
    xy = (ends[0][:, None] + (ends[1] - ends[0])[:, None] * t[:, None]).reshape(-1, 2)
    human = np.column_stack([xy + rng.normal(0.0, noise_m, xy.shape), np.zeros(len(xy))])
    number = np.repeat(np.arange(passes), len(t))
    rows = RuleRows.made(np.zeros_like(human), human, np.where(is_slow(xy), 0, 1), number, stretch=number)
    for row in np.flatnonzero((rows.before >= 0) & (rows.level != rows.level[rows.before])) if parts else ():
        at = rows.sample[[rows.before[row], row]]
        part = np.arange(parts + 1) / parts
        slow = is_slow(xy[at[0]] + part[:, None] * (xy[at[1]] - xy[at[0]]))
        change = int(np.flatnonzero(slow[1:] != slow[:-1])[0])
        rows.dated[row] = part[change : change + 2]
    return rows


def is_slow(xy_m: np.ndarray) -> np.ndarray:
    way = np.roll(CORNERS_M, -1, axis=0) - CORNERS_M
    to = xy_m[:, None] - CORNERS_M
    return (way[:, 0] * to[..., 1] - way[:, 1] * to[..., 0] > 0).all(axis=1)


def fitted(rows: RuleRows) -> tuple[LimitCard, ...]:
    polygon = best_polygon(LimitRows(rows.positions, rows.level == 0, np.ones(len(rows))))
    assert polygon is not None
    return (LimitCard(scaling=0.3, within=RegionCard(polygons=(polygon,))),)


def off_m(limits: tuple[LimitCard, ...]) -> float:
    """Error of the worst corner."""
    seen = np.array(polygon_corners(limits[0].within.polygons[0]))
    return max(float(np.linalg.norm(seen - corner, axis=1).min()) for corner in CORNERS_M)


@pytest.mark.parametrize("seeds", [(6,), pytest.param((6, 7), marks=pytest.mark.slow)])
def test_the_time_of_changes_places_corners_to_millimetres(seeds: tuple[int, ...]) -> None:
    off, widths = [], []
    for parts in (0, 12):
        for seed in seeds:
            rows = rows_of(seed, passes=60, parts=parts)
            found, _ = mean_polygons(fitted(rows), rows, STEPS, seed=0)
            assert len(found[0].within.polygons[0].sides) == len(CORNERS_M)
            off.append(off_m(found))
            widths.append(np.mean([(at.high or 0.0) - (at.low or 0.0) for at in quantities(found).values()]))
    count = len(seeds)
    assert max(off[:count]) < 0.015
    assert max(off[count:]) < 0.005
    assert max(widths[count:]) < 0.7 * min(widths[:count])


def test_a_side_beyond_the_corner_of_its_neighbours_is_left_out() -> None:
    square = [(0.0, 1.0), (np.pi / 2, 1.0), (np.pi, 1.0), (3 * np.pi / 2, 1.0)]
    for out_m, sides in ((1.6, 4), (1.2, 5)):  # the corner is 1.414 m away
        every = sorted([*square, (np.pi / 4, out_m)])
        polygon = PolygonCard(sides=tuple(SideCard(angle_rad=a, metres=MetresCard(value=at)) for a, at in every))
        assert len(without_idle(polygon).sides) == sides


@pytest.mark.parametrize(
    ("noise_m", "parts"), [*(pytest.param(noise_m, 0, marks=pytest.mark.slow) for noise_m in (0.0, 0.03)), (0.03, 12)]
)
def test_intervals_of_sides_hold(noise_m: float, parts: int) -> None:
    held = []
    for seed in range(20, 23):
        rows = rows_of(seed, passes=25, noise_m=noise_m, parts=parts)
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
    rows = rows_of(1, to_m=(1.8, 0.3))
    found, known = mean_polygons(fitted(rows), rows, STEPS, seed=0)
    assert len(known) == 2
    assert polygon_corners(found[0].within.polygons[0]) is None
    assert all(metres.low is not None for metres in quantities(found).values())
