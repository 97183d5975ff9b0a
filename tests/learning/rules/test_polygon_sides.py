"""A polygon has the fewest sides that the samples do not contradict."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.learning.rules.polygons.polygon_fit import PolygonSamples, PolygonState, normals
from cyclekit.learning.rules.polygons.polygon_sides import needed

CORNERS_M = np.array([(1.0, -0.5), (2.2, -0.6), (2.4, 0.7), (1.2, 0.8)])


def samples_of(seed: int, count: int = 1500) -> PolygonSamples:
    """Positions on the floor, inside or outside of CORNERS_M."""
    floor = np.random.default_rng(seed).uniform([0.7, -0.9], [2.7, 1.1], (count, 2))
    inside = sides_of(CORNERS_M)
    depth = (inside.out_m[:, None] - normals(inside.angle_rad) @ floor.T).min(axis=0)
    return PolygonSamples(floor, np.where(depth > 0, 1.0, -1.0), np.full(count, 0.005), np.zeros((count, 2)))


def sides_of(corners_m: np.ndarray) -> PolygonState:
    way = np.roll(corners_m, -1, axis=0) - corners_m
    angle = np.arctan2(-way[:, 0], way[:, 1])
    return PolygonState(angle, corners_m + way / 2)


def off_m(state: PolygonState) -> float:
    """Largest distance of a corner of the truth from the line of the nearest two sides."""
    away = np.abs(state.out_m[:, None] - normals(state.angle_rad) @ CORNERS_M.T)
    return float(np.sort(away, axis=0)[1].max())


@pytest.mark.parametrize("seed", [1, 2])
def test_two_sides_in_place_of_one_become_one(seed: int) -> None:
    bent = np.insert(CORNERS_M, 2, (2.36, 0.05), axis=0)  # the side from 2.2 to 2.4 m with a corner of 0.06 m
    assert len(sides_of(bent).angle_rad) == 5
    found = needed(sides_of(bent), samples_of(seed), np.random.default_rng(0))
    assert len(found.angle_rad) == 4
    assert off_m(found) < 0.02


def test_a_missing_side_is_added() -> None:
    found = needed(sides_of(CORNERS_M).without(1), samples_of(3), np.random.default_rng(0))
    assert len(found.angle_rad) == 4
    assert off_m(found) < 0.02


def test_sides_that_no_sample_shows_are_left_out() -> None:
    every = samples_of(4)
    seen = PolygonSamples(*(each[every.floor_m[:, 0] < 2.0] for each in every))
    found = needed(sides_of(CORNERS_M), seen, np.random.default_rng(0))
    assert len(found.angle_rad) == 3


def test_an_error_of_the_reaction_time_makes_no_further_sides() -> None:
    """Operators at 1.5 m/s in both directions, seen 30 ms late."""
    samples = samples_of(5, 3000)
    way = np.random.default_rng(6).normal(size=samples.floor_m.shape)
    pace = 0.15 * way / np.linalg.norm(way, axis=1)[:, None]
    late = samples._replace(floor_m=samples.floor_m + 0.3 * pace, pace_m=pace)
    found = needed(sides_of(CORNERS_M), late, np.random.default_rng(0))
    assert len(found.angle_rad) == 4
    assert found.late == pytest.approx(0.3, abs=0.05)
    assert off_m(found) < 0.02
