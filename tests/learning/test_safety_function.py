"""The safety function read back: thresholds where a distance rules, the floor where it does not, hysteresis."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from known_cells import LEVELS, THRESHOLDS_M
from matplotlib.colors import to_hex
from matplotlib.patches import Polygon, Rectangle
from msgspec import structs
from ruled import box, near, ruled

from cyclekit.api.zones import read_safety_function
from cyclekit.dataset.cards import note
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import DatasetError, ModelError
from cyclekit.learning.rules.samples.distances import TO_BASE
from cyclekit.learning.rules.shapes import RuleShape, around, shapes_of
from cyclekit.learning.safety_function import read_zones
from cyclekit.learning.safety_function.fit import (
    ScalingSamples,
    by_distance,
    by_place,
    crossings,
    hysteresis,
    thresholds,
)
from cyclekit.plots.colours import scaling_hex
from cyclekit.plots.floor import SHADE
from cyclekit.plots.labels import place_labels

if TYPE_CHECKING:
    from pathlib import Path

HELD = ruled((0.0, near(0.8, TO_BASE), None), (0.5, box(1.0, 2.0, None, 1.0), box(0.9, 2.1, None, 1.1)))
NAME = "distance TCP to operator"


def rows(scaling: Any, *, count: int = 20_000, noise_m: float = 0.0) -> ScalingSamples:
    """Positions all over a cell; `scaling` of (robot, human)."""
    rng = np.random.default_rng(1)
    robot = rng.uniform((-0.5, -0.6, 0.0), (0.6, 0.6, 0.5), (count, 3))
    human = np.column_stack([rng.uniform(-2, 4, count), rng.uniform(-3, 3, count), np.full(count, 0.2)])
    s = scaling(robot, human)
    return ScalingSamples(
        robot, human + rng.normal(0, noise_m, human.shape), s, np.arange(count) // 500, np.arange(count) / 10
    )


def by_the_paper(robot: np.ndarray, human: np.ndarray) -> np.ndarray:
    return np.array(LEVELS)[np.searchsorted(THRESHOLDS_M, np.linalg.norm(robot - human, axis=1))]


@pytest.mark.parametrize(("noise_m", "within_m"), [(0.0, 0.02), (0.05, 0.05)])
def test_thresholds_are_found_with_and_without_noise(noise_m: float, within_m: float):
    found = thresholds(rows(by_the_paper, noise_m=noise_m), LEVELS, NAME)
    assert [entry.metres for entry in found] == pytest.approx(THRESHOLDS_M, abs=within_m)
    assert all(entry.low <= entry.metres <= entry.high for entry in found)
    assert [(entry.slower, entry.faster) for entry in found] == list(pairwise(LEVELS))


def passing(noise_m: float, late_s: float = 0.0) -> ScalingSamples:
    """Somebody who comes and goes along a line and is near for most of the time; s has a threshold at 1.2 m."""
    t_s = np.arange(0.0, 3000.0, 0.1)

    def apart_m(t_s: np.ndarray) -> np.ndarray:
        return 1.13 + ((1 - np.cos(t_s)) / 2) ** (2 + np.sin(t_s))  # leaves faster than he comes

    rng = np.random.default_rng(0)
    human = np.column_stack([apart_m(t_s), 0 * t_s, 0 * t_s]) + rng.normal(0, noise_m, (len(t_s), 3))
    scaling = np.where(apart_m(t_s - late_s) < 1.2, 0.0, 1.0)
    return ScalingSamples(np.zeros((len(t_s), 3)), human, scaling, np.arange(len(t_s)) // 1000, t_s)


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
    alone = ScalingSamples(made.robot_m, made.human_m, made.scaling, np.arange(30_000), made.t_s)
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
    made = ScalingSamples(np.zeros((len(x), 3)), human, s, np.zeros(len(x), dtype=np.int64), t_s)
    assert hysteresis(made, (0.0, 1.0), NAME) == pytest.approx(0.3, abs=0.08)
    at_once = ScalingSamples(made.robot_m, human, np.where(x < 1.5, 0.0, 1.0), made.execution, t_s)
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
    curve, floor = found.plot().axes[:2]
    assert curve.get_xlabel() == f"{NAME}, m"
    assert [label.get_text() for label in curve.get_xticklabels()] == [f"{metres:.2f}" for metres in THRESHOLDS_M]
    drawn = {kind: [one for one in floor.get_children() if isinstance(one, kind)] for kind in (Rectangle, Polygon)}
    assert len([one for one in drawn[Rectangle] if one.get_alpha() == SHADE]) == len(found.floor_m)
    # the rule as shapes: a line around the tool's path for each threshold, in the colour of its speed
    assert [to_hex(one.get_edgecolor()) for one in drawn[Polygon]] == [scaling_hex(s) for s in reversed(LEVELS[:-1])]
    texts = {one.get_text() for one in floor.texts}
    assert {"base", *(label.text for label in place_labels(logged.places))} <= texts
    assert "stop (speed 0 %) when the operator is nearer than" in found.plot().get_supxlabel()


def test_a_rectangle_of_the_rule_is_whole_in_the_picture_also_where_nobody_was_logged(logged: Dataset, staircase: Any):
    staircase.levels = LEVELS
    corners = ((-3.0, -4.0), (-2.0, -4.0), (-2.0, 3.5), (-3.0, 3.5))
    found = replace(read_zones(staircase, logged), shapes=(RuleShape(0.5, False, "rectangle", corners),))
    figure = found.plot()
    figure.draw_without_rendering()
    (x_low, x_high), (y_low, y_high) = figure.axes[1].get_xlim(), figure.axes[1].get_ylim()
    assert x_low < -3.0 < x_high
    assert y_low < -4.0 < 3.5 < y_high
    assert "50 %" in [one.get_text() for one in figure.axes[1].texts]
    nobody = replace(found, floor_m=np.empty((0, 2)), floor_scaling=np.empty(0))
    assert len(nobody.plot().axes) >= 2


def test_an_outline_around_a_path_is_where_its_nearest_point_is_as_far_as_the_threshold():
    path = np.random.default_rng(0).uniform((-0.5, -0.3), (0.6, 0.4), (50, 2))
    outline = np.array(around(path, 1.2))
    nearest = np.linalg.norm(outline[:, None] - path, axis=2).min(axis=1)
    np.testing.assert_allclose(nearest, 1.2, atol=1e-9)


def test_a_rule_has_shapes_in_the_order_in_which_they_are_drawn():
    found = shapes_of(HELD.rule, np.empty((0, 2)), within_m=3.0)
    assert [(one.level, one.leaving, one.name) for one in found] == [
        (0.5, False, "rectangle"),
        (0.5, True, "rectangle"),
        (0.0, False, TO_BASE),
    ]
    assert found[0].outline_m == ((1.0, -3.0), (2.0, -3.0), (2.0, 1.0), (1.0, 1.0))  # an edge that nobody crossed
    np.testing.assert_allclose(np.linalg.norm(found[2].outline_m, axis=1), 0.8)


def test_what_shows_no_staircase_is_refused(logged: Dataset, staircase: Any, tmp_path: Path):
    staircase.levels = ()
    with pytest.raises(ModelError, match="shows no staircase"):
        read_zones(staircase, logged)
    staircase.levels = LEVELS
    empty = Dataset(tmp_path, structs.replace(logged.card, files=None))
    (tmp_path / "samples").mkdir()
    logged.samples().head(100).write_parquet(tmp_path / "samples" / "s.parquet")
    assert pl.read_parquet(tmp_path / "samples" / "s.parquet").height == 100
    with pytest.raises(DatasetError, match="100 samples have both positions"):
        read_zones(staircase, empty)


def test_distances_in_a_doubted_pose_are_marked_before_the_numbers(logged: Dataset, staircase: Any, monkeypatch):
    staircase.levels = LEVELS
    monkeypatch.setattr("cyclekit.api.zones.trained_of", lambda model: model)
    monkeypatch.setattr("cyclekit.api.zones.predictor_of", lambda model: model)
    read = read_safety_function.__wrapped__  # without the check of types: the staircase is no trained model
    assert read(staircase, logged).doubts == ()
    doubted = Dataset(logged.path, structs.replace(logged.card, warnings=(note("frame-assumed"),)))
    found = read(staircase, doubted)
    assert found.doubts[0].startswith("RED pose: the tracker's pose is not given")
    assert repr(found).splitlines()[0].endswith(found.doubts[0])
    assert found.to_dict()["doubts"] == found.doubts
    assert "RED pose" in " ".join(text.get_text() for text in found.plot().texts)
