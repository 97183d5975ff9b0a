"""The safety function read back: thresholds where a distance rules, the floor where it does not, hysteresis."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
import polars as pl
import pytest
from known_cells import LEVELS, THRESHOLDS_M

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import DatasetError, ModelError
from cyclekit.learning.safety_function import read_zones, zones_svg
from cyclekit.learning.safety_function.fit import Rows, by_distance, by_place, crossings, hysteresis, thresholds

if TYPE_CHECKING:
    from pathlib import Path

NAME = "distance TCP to operator"


def rows(scaling: Any, *, count: int = 20_000, noise_m: float = 0.0) -> Rows:
    """Positions all over a cell; `scaling` of (robot, human)."""
    rng = np.random.default_rng(1)
    robot = rng.uniform((-0.5, -0.6, 0.0), (0.6, 0.6, 0.5), (count, 3))
    human = np.column_stack([rng.uniform(-2, 4, count), rng.uniform(-3, 3, count), np.full(count, 0.2)])
    s = scaling(robot, human)
    return Rows(robot, human + rng.normal(0, noise_m, human.shape), s, np.arange(count) // 500, np.arange(count) / 10)


def by_the_paper(robot: np.ndarray, human: np.ndarray) -> np.ndarray:
    return np.array(LEVELS)[np.searchsorted(THRESHOLDS_M, np.linalg.norm(robot - human, axis=1))]


@pytest.mark.parametrize(("noise_m", "within_m"), [(0.0, 0.02), (0.05, 0.05)])
def test_thresholds_are_found_with_and_without_noise(noise_m: float, within_m: float):
    found = thresholds(rows(by_the_paper, noise_m=noise_m), LEVELS, NAME)
    assert [entry.metres for entry in found] == pytest.approx(THRESHOLDS_M, abs=within_m)
    assert all(entry.low <= entry.metres <= entry.high for entry in found)
    assert [(entry.slower, entry.faster) for entry in found] == list(pairwise(LEVELS))


def passing(noise_m: float, late_s: float = 0.0) -> Rows:
    """Somebody who comes and goes along a line and is near for most of the time; s has a threshold at 1.2 m."""
    t_s = np.arange(0.0, 3000.0, 0.1)

    def apart_m(t_s: np.ndarray) -> np.ndarray:
        return 1.13 + ((1 - np.cos(t_s)) / 2) ** (2 + np.sin(t_s))  # leaves faster than he comes

    rng = np.random.default_rng(0)
    human = np.column_stack([apart_m(t_s), 0 * t_s, 0 * t_s]) + rng.normal(0, noise_m, (len(t_s), 3))
    scaling = np.where(apart_m(t_s - late_s) < 1.2, 0.0, 1.0)
    return Rows(np.zeros((len(t_s), 3)), human, scaling, np.arange(len(t_s)) // 1000, t_s)


@pytest.mark.parametrize("late_s", [0.0, 0.08])
def test_noise_moves_the_staircase_of_least_error_and_not_the_crossings(late_s: float):
    made = passing(0.04, late_s)
    (fitted,), _ = by_distance(made, (0.0, 1.0), NAME)
    assert abs(fitted - 1.2) > 0.015
    (found,) = thresholds(made, (0.0, 1.0), NAME)
    assert found.metres == pytest.approx(1.2, abs=0.006)
    assert found.low <= 1.2 <= found.high
    assert found.high - found.low < 0.02


def test_without_noise_the_staircase_of_least_error_stays():
    (fitted,), _ = by_distance(passing(0.0), (0.0, 1.0), NAME)
    (found,) = thresholds(passing(0.0), (0.0, 1.0), NAME)
    assert found.metres == fitted == pytest.approx(1.2, abs=0.002)
    assert found.high - found.low < 0.003


def test_crossings_are_taken_within_one_execution_where_no_sample_is_missing():
    made = passing(0.0)
    every = crossings(made, (0.0, 1.0), NAME)
    assert len(every.metres) > 900
    at = np.flatnonzero(np.diff(made.scaling) != 0)
    assert len(crossings(made.of(np.delete(np.arange(30_000), at)), (0.0, 1.0), NAME).metres) == 0
    alone = Rows(made.robot_m, made.human_m, made.scaling, np.arange(30_000), made.t_s)
    assert len(crossings(alone, (0.0, 1.0), NAME).metres) == 0


def test_too_few_crossings_say_nothing():
    few = passing(0.04).of(np.arange(1200))
    assert 0 < len(crossings(few, (0.0, 1.0), NAME).metres) < 60
    (found,) = thresholds(few, (0.0, 1.0), NAME)
    assert found.metres == by_distance(few, (0.0, 1.0), NAME)[0][0]


def test_zones_on_the_floor_are_explained_by_the_floor_and_not_by_a_distance():
    made = rows(lambda _, human: np.where((human[:, 0] > 1) & (human[:, 1] < 0.4), 0.0, 1.0))
    assert by_place(made) > 0.99
    assert by_distance(made, (0.0, 1.0), NAME)[1] < 0.5


def test_hysteresis_is_the_distance_between_falling_and_rising():
    t_s = np.arange(0.0, 600.0, 0.1)
    x = 2.0 + 1.0 * np.sin(t_s / 1.5)
    s = np.empty(len(x))
    held = 1.0
    for i, metres in enumerate(x):
        held = 0.0 if metres < 1.5 else 1.0 if metres > 1.8 else held
        s[i] = held
    human = np.column_stack([x, 0 * x, 0 * x])
    made = Rows(np.zeros((len(x), 3)), human, s, np.zeros(len(x), dtype=np.int64), t_s)
    assert hysteresis(made, (0.0, 1.0), NAME) == pytest.approx(0.3, abs=0.08)
    at_once = Rows(made.robot_m, human, np.where(x < 1.5, 0.0, 1.0), made.execution, t_s)
    assert hysteresis(at_once, (0.0, 1.0), NAME) == pytest.approx(0.0, abs=0.08)


def test_the_cell_of_the_paper_is_read_back_and_drawn(logged: Dataset, staircase: Any):
    staircase.levels = LEVELS
    found = read_zones(staircase, logged)
    assert found.is_distance
    assert found.rule == NAME
    assert [entry.metres for entry in found.thresholds] == pytest.approx(THRESHOLDS_M, abs=0.02)
    assert found.thresholds_of_network == pytest.approx(THRESHOLDS_M, abs=0.02)
    assert abs(found.hysteresis_m) < 0.03
    assert sum(found.shares) == pytest.approx(1.0)
    assert any("no safety proof" in note for note in found.notes)
    page = ElementTree.fromstring(zones_svg(found))
    drawn = [element for element in page.iter() if element.tag.endswith("rect")]
    assert len(drawn) == len(found.thresholds) + len(found.floor_m)


def test_what_shows_no_staircase_is_refused(logged: Dataset, staircase: Any, tmp_path: Path):
    staircase.levels = ()
    with pytest.raises(ModelError, match="shows no staircase"):
        read_zones(staircase, logged)
    staircase.levels = LEVELS
    empty = Dataset(tmp_path, {**logged.card, "files": None})
    (tmp_path / "samples").mkdir()
    logged.samples().head(100).write_parquet(tmp_path / "samples" / "s.parquet")
    assert pl.read_parquet(tmp_path / "samples" / "s.parquet").height == 100
    with pytest.raises(DatasetError, match="100 samples have both positions"):
        read_zones(staircase, empty)
