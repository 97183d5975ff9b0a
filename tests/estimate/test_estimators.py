"""The estimators by name, and the table of arrivals against the walk."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from report_pages import estimate as made

from cyclekit.config.sequences import TaskSequence
from cyclekit.errors import UnknownName
from cyclekit.estimate.cycle.transit import transit_table
from cyclekit.estimate.cycle.walk import Rolled, roll_all, roll_out
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.limits import limits_of_cycles
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.ranked import Unranked, ranked
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.rollout import estimate as estimate_validated
from cyclekit.estimate.soundness import findings_of
from cyclekit.estimate.statistics.distribution import wilson

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset

estimate = partial(estimate_validated, validate=False)
"""The rollout itself, without what the logged executions correct."""


def test_history_is_the_sum_of_the_logged_means_of_the_tasks(logged: Dataset, staircase: Any, routes: Any):
    sequence = TaskSequence("A", routes[0][:7])
    (found,) = estimate(staircase, logged, [sequence], estimator="history")
    means = logged.tasks().group_by("task").agg((pl.col("end_s") - pl.col("start_s")).mean().alias("s"))
    by_task = dict(means.iter_rows())
    assert found.expected_s == pytest.approx(sum(by_task[task] for task in sequence.tasks), rel=0.01)
    assert (found.estimator, found.tracks) == ("history", 0)


def test_nominal_is_motion_and_stands(logged: Dataset, staircase: Any, routes: Any):
    sequence = TaskSequence("A", routes[0][:7])
    (found,) = estimate(staircase, logged, [sequence], estimator="nominal")
    tasks = nominal_tasks(logged)
    whole = sum(tasks[task].nominal_s + tasks[task].dwell_s + tasks[task].wait_s for task in sequence.tasks)
    assert found.expected_s == pytest.approx(whole)
    assert found.safety_loss_s == 0.0


@pytest.mark.parametrize(("scaling", "horizon_s"), [(0.5, 2.0), (0.8, 14.0), (0.25, 0.7)])
def test_average_solves_for_the_time_in_which_the_mean_scaling_makes_the_nominal_time(
    logged: Dataset, constant: Any, routes: Any, scaling: float, horizon_s: float
):
    model = constant(scaling)
    model.problem, model.horizon_s = "average", horizon_s
    (found,) = estimate(model, logged, [TaskSequence("A", routes[0][:6])])
    assert found.estimator == "average"
    assert found.safety_loss_s == pytest.approx(found.nominal_s * (1 / scaling - 1))
    assert "average" in found.why or "mean scalings" in found.why


@pytest.mark.parametrize(("estimator", "validate"), [("rollout", True), ("rollout", False), ("history", False)])
def test_the_share_within_a_printed_quantile_is_its_level(
    logged: Dataset, staircase: Any, routes: Any, estimator: str, validate: bool
):
    asked, levels = [TaskSequence("A", routes[0])], (0.05, 0.5, 0.8, 0.95)
    told = {"estimator": estimator, "validate": validate, "quantiles": levels}
    (first,) = estimate_validated(staircase, logged, asked, **told)
    for level, at_s in first.quantiles_s.items():
        (found,) = estimate_validated(staircase, logged, asked, takt_s=at_s + 1e-6, **told)
        assert found.takt_probability[0] == pytest.approx(level, abs=1.5 / len(first.durations_s))


def test_an_estimator_that_does_not_exist_is_refused_with_the_nearest(logged: Dataset, staircase: Any, routes: Any):
    with pytest.raises(UnknownName) as caught:
        estimate(staircase, logged, [TaskSequence("A", routes[0][:4])], estimator="rolout")
    assert caught.value.nearest == "rollout"


def test_sequences_are_compared_on_the_same_operators(logged: Dataset, staircase: Any, routes: Any):
    asked = [TaskSequence("A", routes[0]), TaskSequence("other order", routes[1]), TaskSequence("twin", routes[0])]
    found = {entry.name: entry for entry in estimate(staircase, logged, asked, takt_s=90.0)}
    assert found["A"].durations_s == found["twin"].durations_s
    assert found["A"].beats["twin"] == 0.5
    assert found["A"].beats["other order"] == pytest.approx(1 - found["other order"].beats["A"])
    share, low, high = found["A"].takt_probability
    assert share == found["A"].distribution.share(90.0)
    assert low <= share <= high


def test_sequences_that_do_different_work_are_not_held_against_each_other(logged: Dataset, staircase: Any, routes: Any):
    asked = [TaskSequence("long", routes[0]), TaskSequence("short", routes[0][:9]), TaskSequence("twin", routes[0])]
    found = estimate(staircase, logged, asked, takt_s=1e4)
    assert [entry.name for entry in found] == ["short", "long", "twin"]
    share, low, high = found[0].takt_probability
    assert (share, high) == (1.0, 1.0)
    assert low == pytest.approx(wilson(1.0, found[0].executions)[0])  # 16 executions within it do not prove all
    assert [set(entry.beats) for entry in found] == [set(), {"twin"}, {"long"}]
    assert found[0].per_visit_s == found[0].expected_s / 8


def test_of_very_many_sequences_each_is_held_against_the_first_of_its_work(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("cyclekit.estimate.ranked.MANY", 2)
    found = ranked([Unranked(made(name), np.full(4, float(n))) for n, name in enumerate("abc")])
    assert [entry.beats for entry in found] == [{}, {"a": 0.0}, {"a": 0.0}]


def test_many_sequences_walked_at_once_are_those_walked_one_by_one(logged: Dataset, staircase: Any, routes: Any):
    nominal = nominal_tasks(logged)
    programs = [lay_out(TaskSequence("A", route), nominal, logged) for route in (routes[0][:5], routes[1][:9])]
    tracks = operator_tracks(logged, horizon_s=120.0)
    for program, rolled in zip(programs, roll_all(staircase, programs, tracks, None), strict=True):
        alone = roll_out(staircase, program, tracks, None)
        np.testing.assert_allclose(rolled.duration_s, alone.duration_s)
        np.testing.assert_allclose(rolled.safety_s, alone.safety_s)


def test_the_table_of_arrivals_says_what_the_walk_says(logged: Dataset, staircase: Any, routes: Any):
    nominal = nominal_tasks(logged)
    sequence = TaskSequence("A", routes[2])
    tracks = operator_tracks(logged, horizon_s=200.0)
    table = transit_table(staircase, {task: nominal[task] for task in sequence.tasks}, tracks)
    (looked_up,) = table.durations([sequence.tasks])
    walked = roll_out(staircase, lay_out(sequence, nominal, logged), tracks, None).duration_s
    assert looked_up.mean() == pytest.approx(walked.mean(), rel=0.004)
    assert np.corrcoef(looked_up, walked)[0, 1] > 0.98


def test_very_many_sequences_are_looked_up_and_the_best_of_them_walked(
    logged: Dataset, staircase: Any, routes: Any, monkeypatch: pytest.MonkeyPatch
):
    asked = [TaskSequence(f"{n} places", routes[0][:n]) for n in (5, 7, 9, 11, 13)]
    walked = estimate(staircase, logged, asked)
    monkeypatch.setattr("cyclekit.estimate.cycles.MANY", 2)
    found = estimate(staircase, logged, asked)
    assert [entry.name for entry in found] == [entry.name for entry in walked]
    for table, walk in zip(found, walked, strict=True):
        assert table.expected_s == pytest.approx(walk.expected_s, rel=0.01)
        assert table.safety_loss_s == pytest.approx(walk.safety_loss_s, abs=0.01 * walk.expected_s)
        assert table.nominal_s == pytest.approx(walk.nominal_s)
    assert found[0].durations_s == walked[0].durations_s
    assert any("table of arrivals" in text for text in found[-1].warnings)
    assert not any("table of arrivals" in text for text in found[0].warnings)
    assert found[-1].beats == {}  # each does other work


def test_a_cycle_that_does_not_end_within_its_track_is_not_made_up(logged: Dataset, staircase: Any, routes: Any):
    nominal = nominal_tasks(logged)
    sequence = TaskSequence("A", routes[2])
    tracks = operator_tracks(logged, horizon_s=40.0)
    table = transit_table(staircase, {task: nominal[task] for task in sequence.tasks}, tracks)
    assert np.isinf(table.durations([sequence.tasks])).all()


def test_an_operator_who_roams_begins_as_logged_and_goes_on_with_what_he_did_next(hand_made: Any):
    t_s = np.arange(0.0, 80.0, 0.5)
    way = {float(t): (2.5 + np.sin(t / 2.3), np.cos(t / 3.1)) for t in t_s}
    found = hand_made({"a": ([0.0] * 13, way)})
    tracks = operator_tracks(found, horizon_s=6.0)
    assert tracks.executions == tuple(found.executions["execution"])
    at_s = found.executions["start_s"][0] + np.arange(60) / 10  # the log runs on, and so does he
    x_m = np.interp(at_s, list(way), [x for x, _ in way.values()])
    np.testing.assert_allclose(tracks.xyz_m[0, :60, 0], x_m, atol=0.02)
    assert (tracks.logged > 60).sum() >= len(tracks.executions) - 2


@pytest.mark.parametrize(("spliced", "said"), [(0.4, 0), (0.6, 1)])
def test_a_cycle_of_more_than_two_logs_is_said_to_go_on_with_others(spliced: float, said: int):
    cycles = Rolled(np.ones(1), np.ones((1, 1)), np.zeros((1, 1)), np.zeros(0), 1.0, spliced)
    found = limits_of_cycles(cycles)
    assert sum("continued with parts of other executions" in text for text in found) == said


def test_what_was_never_logged_is_a_doubt_that_says_what_the_interval_leaves_out(logged: Dataset, staircase: Any):
    def support_of(share: float) -> Finding:
        return findings_of(staircase, None, logged, executions=40, support=share)[-1]

    assert "30 % of the cycle" in support_of(0.7).text
    assert "not in the interval of the mean" in support_of(0.7).text
    assert (support_of(0.7).level, support_of(0.7).blocks) == ("amber", False)
    assert support_of(0.4).text.startswith("EXTRAPOLATED")
    assert [support_of(share).level for share in (0.4, 0.95)] == ["red", "green"]
