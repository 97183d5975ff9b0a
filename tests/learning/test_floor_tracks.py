"""Trackers that know x and y only: their logs work the whole way with distances in the plane; every result says so."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from fabricated import fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.config import Cell, Source
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import texts
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.dataset.unknown_height import in_plane, inputs_in_plane
from cyclekit.estimate.robot.safety import scaling_of
from cyclekit.estimate.robot.support import Support
from cyclekit.estimate.rollout import estimate
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.safety_function import read_zones
from cyclekit.learning.training import train
from cyclekit.storage.atomic import write_parquet

SAID = "the height of the operator is unknown in all samples: distances to him are those in the plane there"
NUMBERS = st.floats(-5, 5)


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A cell whose samples know no height of the operator."""
    dataset = fabricate_dataset(tmp_path_factory.mktemp("flat") / "dataset", executions=8, seed=1)
    for file in (dataset.path / "samples").glob("*.parquet"):
        unknown = pl.lit(None, pl.Float64)
        write_parquet(pl.read_parquet(file).with_columns(human_z_m=unknown, human_goal_z_m=pl.lit(0.0)), file)
    text = (dataset.path / CARD).read_text(encoding="utf-8")
    (dataset.path / CARD).write_text(text.replace('"rate":', '"method": "own", "rate":'), encoding="utf-8")
    return Dataset.open(dataset.path)


def test_training_estimate_zones_and_evaluation_work_on_the_floor(flat: Dataset):
    model = train(flat, ModelSpec.of(batch=256, epochs=4))
    assert model.card.rows.train > 500
    assert SAID in texts(model.card.warnings)
    (found,) = estimate(model, flat, [TaskSequence("round", ("conveyor", "left", "conveyor"))])
    assert found.support > 0.9
    assert found.safety_loss_s > 0.0
    assert SAID in found.warnings
    zones = read_zones(model, flat)
    assert zones.notes[0] == SAID
    assert zones.rule == "distance TCP to operator on the floor"
    assert SAID in evaluate(model, flat, boosting=False).notes


def test_the_scaling_is_that_of_the_distance_in_the_plane_wherever_the_tcp_is(staircase: Any):
    human = np.array([[2.0, 0.0, np.nan], [2.0, 0.0, np.nan], [np.nan, np.nan, np.nan]])
    robot = np.array([[0.3, 0.0, 0.1], [0.3, 0.0, 1.9], [0.3, 0.0, 0.4]])
    assert scaling_of(staircase, robot, human).tolist() == [0.5, 0.5, 1.0]


def test_support_on_the_floor_is_that_of_the_cells_of_the_floor():
    robot, human = np.array([[0.3, 0.0, 0.4]]), np.array([[2.0, 0.1, np.nan]])
    support = Support(robot, human)
    asked = np.array([[2.0, 0.1, np.nan], [4.0, 0.1, np.nan], [np.nan, np.nan, np.nan]])
    assert support.near_logged(np.repeat(robot, 3, axis=0), asked).tolist() == [True, False, True]


@given(st.lists(st.tuples(*[NUMBERS] * 5, st.booleans()), min_size=1))
def test_only_unknown_heights_are_replaced_and_distances_are_those_in_the_plane(rows: list[tuple[Any, ...]]):
    x = np.array([[*row[:5], np.nan if row[5] else 1.0] for row in rows])
    before = x.copy()
    placed = in_plane(x[:, :3], x[:, 3:])
    assert np.array_equal(x, before, equal_nan=True)
    assert np.array_equal(inputs_in_plane(x)[:, 3:], placed)
    is_flat = np.isnan(x[:, 5])
    assert np.array_equal(placed[~is_flat], x[~is_flat, 3:])
    apart = np.linalg.norm(placed - x[:, :3], axis=1)
    assert apart[is_flat] == pytest.approx(np.hypot(*(x[is_flat, 3:5] - x[is_flat, :2]).T))


def test_the_card_of_a_dataset_of_floor_tracks_is_json_and_says_that_heights_are_unknown(tmp_path: Path):
    t_s = np.arange(0.0, 30.0, 0.1)
    robot = {"t": t_s, "x": 0.5 + 0.5 * np.clip(np.sin(t_s), -0.5, 0.5), "y": 0 * t_s, "z": 0 * t_s + 0.4}
    pl.DataFrame(robot).write_csv(tmp_path / "robot.csv")
    x = np.interp(t_s, [0, 5, 8, 15, 18, 30], [1, 1, 3, 3, 1, 1])  # stays at 1 m, at 3 m, at 1 m
    pl.DataFrame({"t": t_s, "x": x, "y": 0 * t_s + 0.3 + 0.001 * np.sin(7 * t_s)}).write_csv(tmp_path / "people.csv")
    where = {"time": "t", "x": "x", "y": "y"}
    sources = (
        Source("robot.csv", "csv", "robot", map={**where, "z": "z"}),
        Source("people.csv", "csv", "people", clock_offset_s=0.0, map=where),
    )
    report = ingest([tmp_path / "robot.csv", tmp_path / "people.csv"], tmp_path / "out", cell=Cell(sources=sources))
    card = json.loads((tmp_path / "out" / CARD).read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert {place["xyz_m"][2] for place in card["human_places"].values()} == {0.0}
    assert any("heights are unknown: distances are horizontal" in text for text in report.warnings)
    samples = Dataset.open(tmp_path / "out").samples()
    assert (samples["human_x_m"].null_count(), samples["human_z_m"].count()) == (0, 0)
