"""Samples of another rate than 10 Hz: nothing that is told in seconds, and nothing that is learned, takes it for 10."""

from __future__ import annotations

import json
import shutil
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import polars as pl
import pytest
from fabricated import LEVELS, fabricate_dataset
from matplotlib.colors import to_hex

from cyclekit.cli.facts import page
from cyclekit.dataset.cards import TrainingCard, plain
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import DatasetError, ModelError
from cyclekit.estimate.cycle.transit import transit_table
from cyclekit.inspect.describe import describe
from cyclekit.learning.divided_rows import _enough
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.labelling import staircase_of
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.safety_function.fit import ScalingSamples, hysteresis
from cyclekit.learning.training import train
from cyclekit.plots.colours import scaling_hex
from cyclekit.plots.levels import levels_figure
from cyclekit.replay import write_replay
from cyclekit.replay.words import slowdowns
from cyclekit.report.findings import losses
from cyclekit.report.floor import floor_plan
from cyclekit.scaling.levels import find_staircase, label_in_time
from cyclekit.storage.atomic import write_parquet

RATES = (2.0, 5.0, 10.0, 20.0, 50.0)


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
    (path / CARD).write_text(json.dumps(plain(ten.card) | {"rate_hz": 5.0}), encoding="utf-8")
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
        found.append(
            hysteresis(ScalingSamples(*copies, numbers, np.tile(t_s, 12)), (0.0, 1.0), "distance TCP to operator")
        )
    assert found == [pytest.approx(0.2, abs=0.06)] * 2


def test_a_horizon_is_that_many_seconds_at_any_rate(five):
    spec = ModelSpec(problem="ahead", network="regressor", horizon_s=1.0, epochs=1, hidden=(4,), norm="none")
    model = train(five, spec)
    assert model.card.rate_hz == 5.0
    rows = evaluate(model, five, boosting=False).metrics.rows
    held = five.samples(model.card.split.test)
    ends = 5 * held["execution"].n_unique()  # the last second of each has nothing ahead of it
    assert rows <= held.height - ends
    assert rows > held.height - 2 * ends - held["scaling"].null_count() - held["human_x_m"].null_count()


def test_a_model_that_looks_back_is_not_asked_at_another_rate(ten, five):
    spec = ModelSpec.of(problem="ahead", network="lstm-1", horizon_s=1.0, epochs=1, norm="none")
    model = train(five, spec)
    with pytest.raises(ModelError, match=r"5 Hz.*10 Hz"):
        evaluate(model, ten)


def held(rate_hz: float, ramp_s: float, noise: float, *, rare: bool) -> np.ndarray:
    """A staircase for eight minutes at a rate: holds of 3 to 12 s, ramps between; one level, if it is rare, for 3 s."""
    rng = np.random.default_rng(7)
    level, at_s, values = len(LEVELS) - 1, [0.0, 6.0], [1.0, 1.0]
    for number in range(60):
        usual = [i for i in range(len(LEVELS)) if i != level and not (rare and i == 1)]
        after = 1 if rare and number == 30 else int(rng.choice(usual))
        begin = at_s[-1] + max(abs(LEVELS[after] - LEVELS[level]) * ramp_s, 1e-6)
        at_s += [begin, begin + (3.0 if rare and number == 30 else rng.uniform(3, 12))]
        values += [LEVELS[after]] * 2
        level = after
    signal = np.interp(np.arange(0, at_s[-1], 1 / rate_hz), at_s, values)
    return signal + rng.normal(0, noise, signal.size)


@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("ramp_s", [0.0, 5.0])
@pytest.mark.parametrize(("noise", "rare"), [(0.002, True), (0.02, False)])
def test_the_same_staircase_is_found_at_any_rate(rate_hz, ramp_s, noise, rare):
    found = find_staircase(held(rate_hz, ramp_s, noise, rare=rare), rate_hz=rate_hz)
    usual = find_staircase(held(10.0, ramp_s, noise, rare=rare))
    assert found.levels == pytest.approx(LEVELS, abs=0.01)
    assert found.share == pytest.approx(usual.share, abs=0.02)
    assert found.is_staircase


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_slow_ramp_is_on_no_level_at_any_rate(rate_hz):
    ramp = np.interp(np.arange(0, 16, 1 / rate_hz), [0, 5, 10, 16], [1.0, 1.0, 0.0, 0.0])
    labels = label_in_time(ramp, (0.0, 1.0), np.zeros(ramp.size, np.int64), rate_hz=rate_hz)
    on = np.flatnonzero(labels < 0) / rate_hz
    assert on.min() == pytest.approx(5.0, abs=max(0.3, 1.1 / rate_hz))
    assert on.max() == pytest.approx(10.0, abs=max(0.3, 1.1 / rate_hz))


@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("method", ["plateau", "dbscan"])
def test_a_level_is_held_for_a_second_or_three_samples_at_least(method, rate_hz):
    enough = max(round(rate_hz), 3)
    for samples, levels in ((enough, [0.5, 1.0]), (enough - 1, [1.0])):
        values = np.concatenate([np.ones(int(60 * rate_hz)), np.full(samples, 0.5)])
        assert find_staircase(values, method=method, rate_hz=rate_hz).levels.tolist() == levels


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_slow_down_costs_the_same_at_any_rate(rate_hz):
    t_s = np.arange(0, 20, 1 / rate_hz)
    slow, nobody = (t_s >= 5) & (t_s < 15), [None] * t_s.size
    scaling = np.where(slow, 0.5, 1.0)
    known = {"t_s": t_s, "scaling": scaling, "period_s": 1 / rate_hz, "distance_m": np.ones(t_s.size)}
    run = SimpleNamespace(**known, moving=[True] * t_s.size, robot_task=nobody, human_task=nobody)
    (found,) = slowdowns(run)
    assert found.lost_s == pytest.approx(5.0)


@pytest.mark.parametrize(("rate_hz", "apart_s"), [(2.0, 0.5), (5.0, 0.2), (10.0, 0.2), (20.0, 0.2), (50.0, 0.2)])
def test_starts_in_the_table_of_arrivals_lie_a_fifth_of_a_second_apart(rate_hz, apart_s):
    model = SimpleNamespace(predict=lambda x: np.ones(len(x)), card=TrainingCard())
    task = SimpleNamespace(nominal_s=1.0, xyz_m=np.zeros((11, 3)))
    tracks = SimpleNamespace(xyz_m=np.ones((2, int(10 * rate_hz), 3)), step_s=1 / rate_hz, state=None)
    table = transit_table(model, {"a->b": task}, tracks)
    assert table.start_s == pytest.approx(apart_s)
    starts = np.arange(table.arrival_s.shape[2]) * table.start_s
    within = starts < 8
    assert table.arrival_s[0, 0, within] == pytest.approx(starts[within] + 1.0, abs=1e-5)


@pytest.mark.parametrize(
    ("rate_hz", "history"), [(2.0, (3, 1)), (5.0, (6, 1)), (10.0, (6, 2)), (20.0, (6, 4)), (50.0, (6, 10))]
)
def test_a_recurrent_network_looks_back_one_second_at_any_rate(rate_hz, history):
    spec = ModelSpec.of("ahead", "lstm-1").at_rate(rate_hz)
    assert spec.history == history
    assert (history[0] - 1) * history[1] / rate_hz == pytest.approx(1.0)
    assert ModelSpec.of("ahead", "lstm-1", history=(3, 3)).at_rate(rate_hz).history == (3, 3)
    assert ModelSpec.of().at_rate(rate_hz).history == (1, 1)


@pytest.mark.parametrize("rate_hz", RATES)
def test_ten_seconds_of_log_can_be_learned_from_and_nine_cannot(rate_hz):
    dataset, frame = SimpleNamespace(path="dataset", place="dataset", rate_hz=rate_hz), pl.DataFrame({"scaling": [1.0]})
    enough, few = (MagicMock(__len__=lambda _, s=s: int(s * rate_hz), dropped={}) for s in (10, 9))
    assert _enough(dataset, frame, enough) is enough
    with pytest.raises(DatasetError, match=f"At least {10 * rate_hz:g} are needed, 10 s"):
        _enough(dataset, frame, few)


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_picture_of_levels_shows_two_minutes_in_seconds(rate_hz):
    values = np.tile(np.repeat([1.0, 0.5], int(5 * rate_hz)), 30)
    over_time, shares = levels_figure(values, find_staircase(values, rate_hz=rate_hz), rate_hz=rate_hz).axes
    assert over_time.lines[0].get_xdata()[-1] == pytest.approx(120.0 - 1 / rate_hz)
    assert over_time.get_xlabel() == "time, s"
    assert shares.get_xscale() == "linear"
    assert sum(bar.get_width() for bar in shares.patches) == pytest.approx(100.0, abs=1.0)
    assert {to_hex(bar.get_facecolor()) for bar in shares.patches} == {scaling_hex(0.5), scaling_hex(1.0)}
