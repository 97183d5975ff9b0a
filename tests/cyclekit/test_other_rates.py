"""Samples of another rate than 10 Hz: nothing that is told in seconds, and nothing that is learned, takes it for 10."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from fabricated import LEVELS, fabricate_dataset

from cyclekit.atomic import write_parquet
from cyclekit.cli.facts import page
from cyclekit.dataset import CARD, Dataset
from cyclekit.describe import describe
from cyclekit.errors import ModelError
from cyclekit.evaluate import evaluate
from cyclekit.labelling import staircase_of
from cyclekit.models.spec import ModelSpec
from cyclekit.replay import write_replay
from cyclekit.report.findings import losses
from cyclekit.report.floor import floor_plan
from cyclekit.train import train
from cyclekit.zones.fit import Rows, hysteresis


@pytest.fixture(scope="module")
def ten(tmp_path_factory):
    return fabricate_dataset(tmp_path_factory.mktemp("ten") / "dataset", executions=8, rounds=2)


@pytest.fixture(scope="module")
def five(ten, tmp_path_factory):
    """The same cell with every second sample."""
    path = tmp_path_factory.mktemp("five") / "dataset"
    shutil.copytree(ten.path, path)
    for file in (path / "samples").glob("*.parquet"):
        rows = pl.read_parquet(file)
        write_parquet(rows.filter(pl.int_range(pl.len()).over("execution") % 2 == 0), file)
    (path / CARD).write_text(json.dumps(ten.card | {"rate_hz": 5.0}), encoding="utf-8")
    return Dataset.open(path)


def test_seconds_of_the_report_do_not_depend_on_the_rate(ten, five):
    both = [losses(each.samples(), each.executions.height) for each in (ten, five)]
    assert both[1][0].seconds == pytest.approx(both[0][0].seconds, rel=0.1)
    often, seldom = (floor_plan(each, each.samples()) for each in (ten, five))
    assert seldom.seen[:, 2].sum() == pytest.approx(often.seen[:, 2].sum(), rel=0.02)
    assert seldom.lost[:, 2].sum() == pytest.approx(often.lost[:, 2].sum(), rel=0.05)


def test_a_replay_of_few_samples_a_second_has_no_gaps_and_the_same_misses(ten, five, tmp_path):
    class Wrong:
        problem = "now"

        def predict(self, x):
            return np.full(len(x), 0.9)

    often, seldom = (write_replay(each, "1", tmp_path / "x.rrd", model=Wrong()) for each in (ten, five))
    assert seldom.gaps == often.gaps == 0
    costs = [sum(miss.seconds for miss in facts.misses) for facts in (often, seldom)]
    assert costs[1] == pytest.approx(costs[0], rel=0.1)


def test_inspect_says_the_rate(five):
    assert " at 5 Hz;" in page(describe(five.path))


def test_the_levels_are_found_at_another_rate(five):
    assert staircase_of(five, five.samples()).levels == pytest.approx(LEVELS, abs=0.005)


def test_hysteresis_is_read_from_speeds_in_metres_per_second(ten, five):
    """With thresholds shifted outwards while the operator comes: both rates show it, and not a wrong speed."""
    found = []
    for each in (ten, five):
        rows = each.samples().filter(pl.col("human_x_m").is_not_null() & pl.col("robot_x_m").is_not_null())
        place = [rows.select(f"{who}_{axis}_m" for axis in "xyz").to_numpy() for who in ("robot", "human")]
        number = rows["execution"].rank("dense").cast(pl.Int64).to_numpy()
        t_s = rows["t_s"].to_numpy()
        apart = np.linalg.norm(place[0] - place[1], axis=1)
        speed = np.diff(apart, prepend=np.nan) / np.diff(t_s, prepend=np.nan)
        scaling = (apart > np.where(speed > 0, 1.6, 1.4)).astype(float)
        copies = [np.concatenate([part] * 12) for part in (*place, scaling)]
        numbers = np.concatenate([number + 100 * copy for copy in range(12)])
        found.append(hysteresis(Rows(*copies, numbers, np.tile(t_s, 12)), (0.0, 1.0), "distance TCP to operator"))
    assert found == [pytest.approx(0.2, abs=0.06)] * 2


def test_a_horizon_is_that_many_seconds_at_any_rate(five):
    spec = ModelSpec(problem="ahead", network="regressor", horizon_s=1.0, epochs=1, hidden=(4,), norm="none")
    model = train(five, spec)
    assert model.card["rate_hz"] == 5.0
    rows = evaluate(model, five).metrics.rows
    held = five.samples(model.card["split"]["test"])
    ends = 5 * held["execution"].n_unique()  # the last second of each has nothing ahead of it
    assert rows <= held.height - ends
    assert rows > held.height - 2 * ends - held["scaling"].null_count() - held["human_x_m"].null_count()


def test_a_model_that_looks_back_is_not_asked_at_another_rate(ten, five):
    spec = ModelSpec.of(problem="ahead", network="lstm-1", horizon_s=1.0, epochs=1, norm="none")
    model = train(five, spec)
    with pytest.raises(ModelError, match=r"5 Hz.*10 Hz"):
        evaluate(replace(model, card=model.card | {"split": model.card["split"]}), ten)
