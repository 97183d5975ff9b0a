"""Logged cycles at the operator's latest pace: what he learned is no saving."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import OperatorPaceCard
from cyclekit.dataset.cards.coupling import TrendCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.baseline import baseline_of
from cyclekit.estimate.operator.latest_pace import LoggedPace, at_latest_pace, logged_pace, share_of_pace
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.runs import logged_runs
from cyclekit_sim.task_lists import ListOptions, fresh_durations, simulate_task_lists

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from cyclekit.schema import Ints, Vector

COUNT = 60
Order = tuple[str, ...]


def _cells(
    order_of: Callable[[Ints], Ints], *, follows: float, seed: int = 0
) -> tuple[LoggedPace, dict[str, float], dict[str, Order]]:
    """Return cycles of 100 s of which a share follows a pace that falls from 1.4 to 1; odd orders take 20 % more."""
    number = np.arange(COUNT)
    log = np.log(1.4) * (1.0 - number / (COUNT - 1))
    order, chance = order_of(number), 1.0 + 0.04 * np.random.default_rng(seed).standard_normal(COUNT)
    cycles_s = 100.0 * (1.0 + 0.2 * (order % 2)) * (1.0 - follows + follows * np.exp(log)) * chance
    names = [f"{n:03d}" for n in number]
    pace = LoggedPace(dict(zip(names, log.tolist(), strict=True)), 0.0)
    orders = {name: (str(which),) for name, which in zip(names, order.tolist(), strict=True)}
    return pace, dict(zip(names, cycles_s.tolist(), strict=True)), orders


def _one(number: Ints) -> Ints:
    return 0 * number


def _then_another(number: Ints) -> Ints:
    return number // (COUNT // 2)


def _at_latest(pace: LoggedPace, duration_s: dict[str, float], orders: dict[str, Order]) -> tuple[Vector, float]:
    share = share_of_pace(pace, duration_s, orders)
    return at_latest_pace(pace, share, list(duration_s), np.array(list(duration_s.values())))


@pytest.mark.parametrize("follows", [0.0, 0.4, 1.0])
def test_the_mean_at_the_latest_pace_is_that_of_cycles_as_the_last(follows: float) -> None:
    for seed in range(3):
        pace, duration_s, orders = _cells(_one, follows=follows, seed=seed)
        found, error_s = _at_latest(pace, duration_s, orders)
        assert found.mean() == pytest.approx(100.0, abs=1.0 + 2.5 * error_s)
        assert error_s < 3.0
        assert not follows or np.mean(list(duration_s.values())) > 105.0


def test_another_order_from_some_day_on_is_no_other_pace() -> None:
    """The longer order came last, so without its mean the cycles seem to become longer while he becomes quicker."""
    pace, duration_s, orders = _cells(_then_another, follows=0.5)
    assert share_of_pace(pace, duration_s, orders).mean == pytest.approx(0.5, abs=0.2)


def test_of_few_executions_half_of_the_cycle_may_follow_or_none_or_all() -> None:
    pace, duration_s, _ = _cells(_one, follows=0.5)
    few = dict(list(duration_s.items())[:5])
    share = share_of_pace(pace, few, dict.fromkeys(few, ("a",)))
    assert share == pytest.approx((0.5, 12**-0.5), abs=0.01)
    _, error_s = at_latest_pace(pace, share, list(few), np.array(list(few.values())))
    assert error_s > 5.0


def test_executions_that_tell_nothing_of_his_pace_have_that_of_their_neighbours(logged: Dataset) -> None:
    names = [one.execution for one in logged.card.executions]
    trend = TrendCard(change=-0.2, count=len(names[::2]), error=0.02)
    found = logged_pace(logged, [OperatorPaceCard(executions=tuple(names[::2]), work=trend, work_share=0.5)])
    assert found is not None
    paces = [found.log[name] for name in names]
    assert paces[0] == pytest.approx(0.1)
    assert paces[1] == pytest.approx((paces[0] + paces[2]) / 2)
    assert found.error == pytest.approx(0.01)
    assert logged_pace(logged, [OperatorPaceCard(executions=("of", "another", "cell"), work=trend)]) is None
    assert logged_pace(logged, []) is None


def test_todays_cycle_is_at_the_latest_pace_and_as_logged_without_a_change(logged: Dataset) -> None:
    places = next(one.places for one in logged.card.executions if one.places and not one.reference)
    then = baseline_of(logged, work_of(places), None)
    names = tuple(one.execution for one in logged.card.executions)
    trend = TrendCard(change=-0.3, count=len(names))
    now = baseline_of(logged, work_of(places), None, pace=[OperatorPaceCard(executions=names, work=trend, walk=trend)])
    assert then is not None
    assert now is not None
    assert now.as_logged_s == then.mean_s
    assert now.pace_share is not None
    assert now.mean_s < then.mean_s
    assert (then.as_logged_s, then.pace_share) == (None, None)
    assert now.high_s - now.low_s > then.high_s - then.low_s


def test_in_task_lists_what_an_operator_learned_is_no_saving(tmp_path: Path) -> None:
    options = ListOptions(drift=0.35)
    orders = simulate_task_lists(tmp_path / "logs", executions=80, seed=3, options=options)
    ingest([tmp_path / "logs" / "tasks.csv"], tmp_path / "dataset")
    logged = Dataset.open(tmp_path / "dataset")
    model = learn_runs(*logged_runs(logged), folds=0)
    assert model.pace
    agents = list(model.agents)
    kinds = {kind: name for name, kind in model.agents.items()}
    assert len(agents) == 2
    plan = TaskSequence.of_plan(
        "same", [PlannedTask(kinds[kind], task) for kind, some in orders[0].items() for task in some]
    )
    refused: list[object] = []
    (found,) = estimate_plans(model, [plan], refused=lambda *why: refused.append(why))
    assert found.pace == tuple(model.pace.values())
    assert "pace" not in found.to_dict()
    today = baseline_of(logged, work_of(found.places, found.operator), None, pace=found.pace)
    assert today is not None
    true_s = np.mean([fresh_durations(order, cycles=4, seed=n, options=options) for n, order in enumerate(orders)])
    assert today.as_logged_s is not None
    assert today.as_logged_s > 1.04 * true_s
    assert today.mean_s == pytest.approx(true_s, rel=0.03)
    assert today.low_s < true_s < today.high_s
    plain = msgspec.structs.replace(model, pace={})
    (as_before,) = estimate_plans(plain, [plan], refused=lambda *_: None)
    assert as_before.pace == ()
