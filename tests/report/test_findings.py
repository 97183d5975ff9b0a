from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from fabricated import LEVELS, THRESHOLDS_M
from matplotlib.colors import to_hex
from matplotlib.patches import Polygon
from msgspec import structs
from report_pages import DistanceModel
from ruled import box, near, ruled

from cyclekit.config import Cell, Furniture
from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.cards.rule import LimitCard, MetresCard, RectangleCard, RegionCard, RuleCard, SignalCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.baseline import logged_cycle
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.networks.weights import Weights
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.samples.distances import TO_TCP
from cyclekit.plots.colours import scaling_hex
from cyclekit.report import findings
from cyclekit.report.calibration import calibration
from cyclekit.report.figures.predictions import CALIBRATION
from cyclekit.report.floor import floor_plan
from cyclekit.report.inputs import PageInputs
from cyclekit.report.maps import lost_map, zone_map
from cyclekit.report.texts import load_texts
from cyclekit.report.why import section


def test_the_levels_and_distances_of_the_true_staircase_are_read_back(dataset):
    found = findings.safety_function(dataset.samples(), dataset.levels, DistanceModel())
    assert found.explained > 0.95
    by_level = {band.scaling: band for band in found.bands}
    limits = (0.0, *THRESHOLDS_M, math.inf)
    for level, low, high in zip(LEVELS, limits, limits[1:], strict=False):
        if level in by_level:
            assert low <= by_level[level].low_m <= by_level[level].high_m <= high
    assert np.abs(found.predicted - found.logged).mean() < 0.02


def test_a_robot_that_never_stood_for_safety_is_said_to_be_so_in_words(dataset):
    page = PageInputs(load_texts(), dataset)
    for halted, said in ((0.0, "and never at speed 0 %."), (0.1, "and at speed 0 % for 10 %.")):
        page.__dict__["seen"] = replace(page.seen, slowed=0.5, halted=halted)
        assert section(page)["sentences"][0].replace("\N{NO-BREAK SPACE}", " ").endswith(said)


def test_a_rule_on_fields_is_a_table_of_field_place_and_speed(dataset):
    left = RectangleCard(along=(None, None), across=(MetresCard(value=0.2), None))
    stop, slow = SignalCard(signal="protective", value="0", robot=left), SignalCard(signal="warning", value="1")
    limits = (
        LimitCard(scaling=0.0, within=RegionCard(signals=(stop,))),
        LimitCard(scaling=0.5, within=RegionCard(signals=(slow,))),
    )
    rule = RuleCard(family="signals", levels=(0.0, 0.5, 1.0), limits=limits, explained=1.0)
    page = PageInputs(load_texts(), dataset)
    page.__dict__["answers"] = page.__dict__["response"] = None
    assert section(page)["tables"] == []
    page.__dict__["answers"] = RuleSafety(rule, TrainingCard())
    (table,) = section(page)["tables"]
    rows = [("protective", "0", "at y above 0.200 m", "0 %"), ("warning", "1", "anywhere", "50 %")]
    assert [tuple(row) for row in table.rows] == rows
    assert table.heads == ["Field (signal)", "Occupied at", "While the tool is", "Speed at most"]


def test_where_speed_does_not_follow_distance_the_page_says_so(dataset, tmp_path):
    rng = np.random.default_rng(0)
    random = pl.Series(rng.choice(LEVELS, dataset.samples().height))
    rows = dataset.samples().with_columns(scaling=random)
    assert findings.safety_function(rows, dataset.levels, None).explained < 0.3


def test_time_lost_on_the_floor_plan_is_the_time_lost_in_the_tasks(dataset):
    plan = floor_plan(dataset, dataset.samples())
    lost_s = plan.lost[:, 2].sum() * dataset.executions.height
    assert lost_s == pytest.approx(dataset.tasks()["safety_loss_s"].sum(), rel=0.1)
    seen = dataset.samples()["human_x_m"].count()
    assert plan.seen[:, 2].sum() * dataset.executions.height == pytest.approx(0.1 * seen)


def test_logged_tasks_keep_their_seconds(dataset):
    rows = findings.task_shares(dataset.tasks())
    tasks = dataset.tasks()
    whole = (tasks["end_s"] - tasks["start_s"]).sum()
    assert sum(row.total_s * row.seen for row in rows) == pytest.approx(whole)
    assert rows[0].safety_s * rows[0].seen == max(row.safety_s * row.seen for row in rows)


@pytest.mark.parametrize("scaling_known", [True, False])
def test_a_wait_short_of_a_place_is_wait_and_not_motion(dataset, monkeypatch, scaling_known):
    tasks = dataset.tasks().with_columns(pl.col("nominal_s") - 0.5, wait_s=pl.lit(0.5))  # arrival only after the wait
    if not scaling_known:
        tasks = tasks.with_columns(nominal_s=None, safety_loss_s=None)
    monkeypatch.setattr(Dataset, "tasks", lambda _: tasks)
    today = logged_cycle(dataset, dataset.executions["execution"].to_list()[:1], "today")
    assert today.wait_s == pytest.approx(0.5 * len(today.tasks))
    assert sum(task.nominal_s + task.safety_loss_s for task in today.tasks) == pytest.approx(
        today.expected_s - today.wait_s - today.dwell_s
    )
    rows = findings.task_shares(tasks)
    assert [row.wait_s for row in rows] == pytest.approx([0.5] * len(rows))
    assert sum(row.total_s * row.seen for row in rows) == pytest.approx((tasks["end_s"] - tasks["start_s"]).sum())


def test_time_lost_is_laid_to_what_the_operator_did(dataset):
    found = findings.losses(dataset.samples(), dataset.executions.height)
    assert sum(loss.seconds for loss in found) * dataset.executions.height == pytest.approx(
        dataset.tasks()["safety_loss_s"].sum(), rel=0.1
    )
    assert all(loss.worst_s <= loss.seconds for loss in found)
    assert [loss.seconds for loss in found] == sorted((loss.seconds for loss in found), reverse=True)


def test_waits_and_pauses_at_a_low_scaling_are_no_slow_down(dataset):
    samples = dataset.samples()
    slow = pl.col("robot_moving") & (pl.col("scaling") < findings.FULL) & pl.col("robot_task").is_not_null()
    number = slow.cum_sum()
    cause = pl.when(number % 3 == 0).then(pl.lit("wait")).when(number % 3 == 1).then(pl.lit("pause")).otherwise(None)
    some = samples.with_columns(lost_to=pl.when(slow).then(cause))
    found = sum(each.seconds for each in findings.losses(some, dataset.executions.height))
    kept = samples.filter(slow & (number % 3 == 2)).select((1 - pl.col("scaling")).sum()).item()
    assert found == pytest.approx(kept * findings.sample_s(samples) / dataset.executions.height)


def test_the_zone_map_is_the_models_mean_over_the_robots_ways(dataset):
    samples = dataset.samples()
    plan = floor_plan(dataset, samples, DistanceModel())
    assert plan.zones_of_model
    near = plan.zones[np.argmin(np.linalg.norm(plan.zones[:, :2] - [0.6, 0.0], axis=1))]
    far = plan.zones[np.argmax(np.linalg.norm(plan.zones[:, :2], axis=1))]
    assert near[2] < far[2]
    assert not floor_plan(dataset, samples).zones_of_model


def test_the_zone_map_draws_the_rule_of_the_model(dataset):
    rule = ruled((0.0, near(0.9), near(1.0)), (0.5, box(0.8, 1.6, -0.5, 0.5), None))
    plan = floor_plan(dataset, dataset.samples(), rule)
    figure = zone_map(6.0, plan, defaultdict(str))
    lines = [one for one in figure.axes[0].patches if isinstance(one, Polygon)]
    assert [to_hex(line.get_edgecolor()) for line in lines] == [scaling_hex(level) for level in (0.5, 0.0, 0.0)]
    np.testing.assert_allclose(lines[0].get_xy()[:4], [(0.8, -0.5), (1.6, -0.5), (1.6, 0.5), (0.8, 0.5)])
    assert {text.get_text() for text in figure.axes[0].texts} >= {"50 %", "0 %"}
    assert floor_plan(dataset, dataset.samples(), DistanceModel()).shapes == ()


def test_a_calibrated_model_lies_on_the_line_and_a_biased_one_does_not(dataset):
    class Biased(DistanceModel):
        def predict(self, x):
            return super().predict(x) * 0.5

    names = dataset.executions["execution"].to_list()
    right = calibration(dataset.samples(), names, DistanceModel())
    assert right.worst < 0.02
    assert calibration(dataset.samples(), names, Biased()).worst > 0.3
    assert calibration(dataset.samples(), [], DistanceModel()) is None


def test_the_answering_rule_is_calibrated_not_the_network_beside_it(dataset):
    limits = tuple(
        LimitCard(scaling=level, within=near(metres)) for level, metres in zip(LEVELS, THRESHOLDS_M, strict=False)
    )
    rule = RuleCard(family=TO_TCP, levels=LEVELS, limits=limits, explained=1.0)
    names = tuple(dataset.executions["execution"].to_list())
    layers = ((np.zeros((6, 5), np.float32), np.eye(5, dtype=np.float32)[0]),)  # it always says level 0
    worst = {}
    for answering in (None, rule):
        network = TrainedModel("now", "classifier", 0.0, LEVELS, Weights(layers, 1), TrainingCard(rule=answering))
        page = PageInputs(load_texts(), dataset, network)
        page.__dict__["judged"] = {"executions": names}
        (chart,) = CALIBRATION.charts(page)
        worst[answering is None] = max(abs(_percent(row[0]) - _percent(row[1])) for row in chart.numbers.rows)
    assert worst[False] < 2
    assert worst[True] > 30


def _percent(cell: str) -> float:
    return float(cell.removesuffix("%").strip("\N{NO-BREAK SPACE} "))


def test_tables_of_the_cell_file_stand_on_both_plans(dataset):
    bench = Furniture(xyz_m=(0.5, 1.0, -0.1), size_m=(0.9, 0.4, 0.6), yaw_deg=90.0)
    settings = Cell(furniture={"bench": bench})
    furnished = Dataset(dataset.path, structs.replace(dataset.card, settings=settings))
    plan = floor_plan(furnished, dataset.samples(), DistanceModel())
    for draw in (lost_map, zone_map):
        figure = draw(6.0, plan, defaultdict(str))
        (box,) = [patch for patch in figure.axes[0].patches if getattr(patch, "get_angle", float)() == 90.0]
        turned = box.get_patch_transform().transform(box.get_path().vertices)
        assert turned[:, 0].min() == pytest.approx(0.3)
        assert turned[:, 1].max() == pytest.approx(1.45)
        assert ("bench", "") in figure.cyclekit_tips
