"""Visits of people that follow a task of the robot, known by signals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import TrainingCard
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.statistics.resample import RESAMPLES
from cyclekit.estimate.validation.visit_effect import (
    LAST,
    PeopleInExecution,
    VisitEffect,
    _logged,
    departures,
    visit_effect,
    visit_effect_of,
)
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.safety import RuleSafety

if TYPE_CHECKING:
    from simulated_cells import Cells, SimulatedCell

STEP_S = 0.1
TASK_S = 10.0
VISIT_S = 4.0
ORDERS = (("feed", "box", "feed", "home"), ("box", "feed", "feed", "home"), ("feed", "feed", "feed", "home"))


def executions(count: int, after_box: float, seed: int, usual_gap_s: float = 60.0) -> list[PeopleInExecution]:
    """Return executions whose visits last VISIT_S each; a share `after_box` of the departures from box has one more."""
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        places = ORDERS[number % len(ORDERS)]
        left_s = TASK_S * (1.0 + np.arange(len(places)))
        t_s = np.arange(0.0, left_s[-1], STEP_S)
        begins = rng.uniform(0.0, left_s[-1], rng.poisson(left_s[-1] / usual_gap_s)).tolist()
        for place, when_s in zip(places, left_s.tolist(), strict=True):
            if place == "box" and rng.random() < after_box:
                begins.append(when_s + rng.uniform(1.0, 6.0))
        people = np.zeros(len(t_s), dtype=np.bool_)
        for begin_s in begins:
            people |= (t_s >= begin_s) & (t_s < begin_s + VISIT_S)
        found.append(PeopleInExecution(places, left_s, float(left_s[-1]), t_s, people, 0.5 * STEP_S * people))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_orders_with_more_of_the_place_lose_more(seed: int) -> None:
    effect = visit_effect_of(executions(90, 0.6, seed))
    assert effect is not None
    assert effect.place == "box"
    assert effect.each_s == pytest.approx(0.6 * 0.5 * VISIT_S, rel=0.5)
    many, none = ("box", "box", "box", "feed", "home"), ("feed", "feed", "feed", "feed", "home")
    usual = VISIT_S * 0.5 / 60.0
    logged = usual + 0.6 * 0.5 * VISIT_S * (2 / 3) / 40.0
    true = [(usual + 0.6 * 0.5 * VISIT_S * times / 50.0) / logged for times in (3, 0)]
    assert [effect.factor(order, 50.0) for order in (many, none)] == pytest.approx(true, abs=0.4)


def test_the_logged_orders_keep_their_losses_in_total() -> None:
    logged = executions(90, 0.6, seed=1)
    effect = visit_effect_of(logged)
    assert effect is not None
    factors = [effect.factor(one.places, one.free_s) for one in logged]
    assert np.average(factors, weights=[one.free_s for one in logged]) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(8))
def test_visits_at_any_time_show_none(seed: int) -> None:
    assert visit_effect_of(executions(90, 0.0, seed, usual_gap_s=30.0)) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_that_people_hold_up_at_a_place_does_not_call_them(seed: int) -> None:
    """Visits last longest after the box, so most of the time with people lies there; few begin there."""
    logged = executions(90, 0.0, seed, usual_gap_s=30.0)
    for one in logged:
        after, starts = one.after("box"), one.starts()[0]
        for begin in np.flatnonzero(starts & after):
            one.people[begin : begin + 150] = True
    assert visit_effect_of(logged) is None


@pytest.mark.parametrize("seed", range(4))
def test_who_comes_at_a_time_of_the_cycle_does_not_follow_the_place_where_the_robot_often_is_then(seed: int) -> None:
    """Two of three orders leave the box before the third task ends, when somebody comes in most executions."""
    logged, rng = executions(90, 0.0, seed), np.random.default_rng(seed)
    for one in logged:
        if rng.random() < 0.6:
            one.people[round((2.0 * TASK_S + rng.uniform(1.0, 6.0)) / STEP_S) :][: round(VISIT_S / STEP_S)] = True
    assert visit_effect_of(logged) is None


def test_few_visits_show_none() -> None:
    assert visit_effect_of(executions(9, 0.6, seed=1)) is None
    assert visit_effect_of([]) is None


def test_the_last_place_counts_in_part_and_the_end_not_at_all() -> None:
    assert departures(("box", "feed", "box", "home"), "box") == 1.0 + LAST
    assert departures(("feed", "box"), "box") == 0.0
    assert departures(("box",), "box") == 0.0


def test_the_factor_is_the_less_certain_the_fewer_visits_were_logged() -> None:
    spreads = []
    for count in (60, 480):
        effect = visit_effect_of(executions(count, 0.6, seed=5))
        assert effect is not None
        factors = effect.uncertain(("box", "box", "box", "home"), 40.0, RESAMPLES)
        assert factors.shape == (RESAMPLES,)
        spreads.append(factors.std())
    assert spreads[1] < 0.7 * spreads[0]


@pytest.fixture(scope="module")
def fields(cells: Cells) -> SimulatedCell:
    return cells("scanner-fields", 8)


def test_visits_of_a_dataset_begin_where_signals_slow_the_robot(fields: SimulatedCell) -> None:
    dataset = fields.dataset
    logged = _logged(dataset)
    assert len(logged) == sum(one.whole for one in dataset.card.executions)
    lost = dataset.tasks().filter(
        pl.col("execution").is_in([one.execution for one in dataset.card.executions if one.whole])
    )
    assert sum(one.lost_s.sum() for one in logged) == pytest.approx(lost["safety_loss_s"].sum(), rel=0.2)
    assert sum(one.lost_s[one.people].sum() for one in logged) > 0.8 * sum(one.lost_s.sum() for one in logged)
    assert sum(one.starts()[0].sum() for one in logged) > 0
    assert visit_effect(dataset) is None


def test_visits_that_follow_a_place_have_half_of_the_weight(
    fields: SimulatedCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = fields.dataset
    rule = rule_of(dataset, dataset.levels).rule
    assert rule is not None
    model = RuleSafety(rule, TrainingCard(operator_signals=dataset.card.operator_signals))
    order = TaskSequence("a", next(one.places for one in dataset.card.executions if one.whole))
    (before,) = estimate(model, dataset, [order], other_cell=True)
    effect = VisitEffect(order.places[1], base=0.05, each_s=2.0, logged=0.001, error=0.5)
    monkeypatch.setattr("cyclekit.estimate.validation.means.visit_effect", lambda _: effect)
    (found,) = estimate(model, dataset, [order], other_cell=True)
    assert found.combined is not None
    assert found.combined.visits_after == order.places[1]
    assert found.combined.history_s > found.combined.rollout_s
    assert found.expected_s == pytest.approx((found.combined.history_s + found.combined.rollout_s) / 2)
    assert "weighted 50 % with the visits of people that follow" in found.why
    assert found.expected_high_s - found.expected_low_s > before.expected_high_s - before.expected_low_s
    (alone,) = estimate(model, dataset, [order], other_cell=True, validate=False)
    assert alone.combined is None
