"""Lags of task starts: who waits for another takes a moment to react, who comes late goes on at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards.task_model import NeedCard, TaskModelCard, TaskTimesCard
from cyclekit.learning.task_times.learn import learn_runs, plan_of
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run
from cyclekit.learning.task_times.starts import learn_starts

if TYPE_CHECKING:
    from collections.abc import Sequence

REACTION_S, ON_S = 1.0, 0.1


def side_by_side(
    rng: np.random.Generator, executions: int, reaction_s: float = REACTION_S, order: Sequence[str] = ()
) -> list[Run]:
    """Return executions of a robot that brings three parts and a worker who mounts each and packs in between.

    He mounts `reaction_s` after the part is there, or `ON_S` after his own last task.
    """
    runs = []
    for number in range(executions):
        robot, brought = [], []
        t = 0.0
        for _ in range(3):
            end = t + 6.0 + rng.uniform(-1.0, 1.0)
            robot.append(DoneTask("bring", t, end))
            brought.append(end)
            t = end
        worker, t, parts = [], 0.0, iter(brought)
        for task in order or rng.permutation(["mount"] * 3 + ["pack"] * 3):
            begin = t + ON_S if task == "pack" else max(t + ON_S, next(parts) + reaction_s * rng.uniform(0.8, 1.2))
            t = begin + 3.0 + rng.uniform(-0.5, 0.5)
            worker.append(DoneTask(str(task), begin, t))
        runs.append(Run(str(number), {"arm": tuple(robot), "worker": tuple(worker)}, number))
    return runs


def test_a_reaction_is_told_from_going_on() -> None:
    starts = learn_starts(side_by_side(np.random.default_rng(1), 40), "worker")["mount"]
    assert [need.task for need in starts.needs] == ["bring"]
    assert starts.lags_s == pytest.approx(ON_S)
    assert starts.need_lags_s.min() >= 0.8 * REACTION_S - 1e-9
    assert starts.need_lags_s.max() <= 1.2 * REACTION_S + 1e-9
    assert len(learn_starts(side_by_side(np.random.default_rng(1), 40), "worker")["pack"].need_lags_s) == 0


def visits(rng: np.random.Generator, way_s: dict[str, float], executions: int = 30) -> list[Run]:
    """Return executions of a robot that visits three places for 2 s each, in any order; a way takes `way_s` of both."""
    runs = []
    for number in range(executions):
        done, t, last = list[DoneTask](), 0.0, ""
        for place in rng.permutation(["a", "b", "c"]).tolist():
            t += way_s["".join(sorted(last + place))] * rng.uniform(0.9, 1.1) if last else 0.0
            done.append(DoneTask(place, t, t + 2.0))
            t, last = t + 2.0, place
        runs.append(Run(str(number), {"arm": tuple(done)}, number))
    return runs


def test_the_time_between_two_tasks_belongs_to_the_pair() -> None:
    far = {"ab": 1.0, "bc": 2.0, "ac": 4.0}
    model = learn_runs(visits(np.random.default_rng(2), far), {"arm": "robot"}, folds=0)
    for order, true_s in (("abc", 9.0), ("bac", 11.0), ("acb", 12.0)):
        rolled = roll_plan(model, [PlannedTask("arm", place) for place in order])
        assert rolled.duration_s.mean() == pytest.approx(true_s, rel=0.02)
    alike = learn_starts(visits(np.random.default_rng(2), dict.fromkeys(far, 2.0)), "arm")
    assert alike["a"].lag_after_s["b"] == pytest.approx(alike["a"].lag_after_s["c"], abs=0.15)


def test_lags_that_are_alike_stay_together() -> None:
    runs = side_by_side(np.random.default_rng(1), 40, reaction_s=ON_S)
    starts = learn_starts(runs, "worker")["mount"]
    assert [need.task for need in starts.needs] == ["bring"]
    assert len(starts.need_lags_s) == 0
    assert len(starts.lags_s) == 3 * len(runs)


@pytest.mark.parametrize("order", [["mount"] * 3 + ["pack"] * 3, ["pack"] * 3 + ["mount"] * 3])
def test_orders_in_which_he_waits_and_in_which_he_does_not_are_as_long_as_they_are(order: list[str]) -> None:
    rng = np.random.default_rng(2)
    model = learn_runs(side_by_side(rng, 60), {"arm": "robot", "worker": "operator"}, folds=0)
    fresh = side_by_side(rng, 400, order=order)
    true_s = np.mean([run.duration_s for run in fresh])
    assert roll_plan(model, plan_of(fresh[0]), cycles=1000).duration_s.mean() == pytest.approx(true_s, rel=0.01)


def test_the_later_of_both_causes_counts_with_its_own_lag() -> None:
    usual: dict[str, Any] = {"usual_s": 1.0, "rates": {}, "after": {}, "lags_s": (0.0,)}
    needs = (NeedCard(agent="arm", task="bring"),)
    cards = (
        TaskTimesCard(agent="arm", task="bring", work_s=(3.0,), **usual),
        TaskTimesCard(agent="worker", task="pack", work_s=(2.5,), **usual),
        TaskTimesCard(agent="worker", task="mount", work_s=(1.0,), needs=needs, need_lags_s=(0.5,), **usual),
    )
    model = TaskModelCard(agents={"arm": "robot", "worker": "operator"}, tasks=cards, executions=5)
    plan = [PlannedTask("arm", "bring"), PlannedTask("worker", "pack"), PlannedTask("worker", "mount")]
    assert roll_plan(model, plan, cycles=1).start_s[0] == pytest.approx([0.0, 0.0, 3.5])
    late = [*plan[:2], PlannedTask("worker", "pack"), plan[2]]  # 2.0 s after the part came
    rolled = roll_plan(model, late, cycles=1)
    assert rolled.start_s[0] == pytest.approx([0.0, 0.0, 2.5, 5.0])
    assert rolled.wait_s[0] == pytest.approx([0.0, 0.0, 0.0, 0.0])
