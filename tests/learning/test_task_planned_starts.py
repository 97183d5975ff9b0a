"""Planned starts of a plan: who kept to them in the logs is held by them, the others only by those of single tasks."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards.task_model import TaskModelCard
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run
from cyclekit.report.play.lists import _plan

OWN_S = {"pick": 4.0, "place": 3.0, "mount": 5.0, "pack": 4.0}
AGENTS = {"arm": ("pick", "place"), "worker": ("mount", "pack")}
LATE = 1.25
"""The planner's durations, as a multiple of the true ones."""


def logged(kept: set[str], plan: bool = True) -> TaskModelCard:
    """Return what is learned of agents who run a plan with reserves, of whom some keep to its starts."""
    rng, runs = np.random.default_rng(1), []
    for number in range(12):
        tasks = {}
        for agent, names in AGENTS.items():
            free_s, planned_s, some = 0.0, 0.0, []
            for name in rng.permutation(names * 3):
                begin_s = (max(free_s, planned_s) if agent in kept else free_s) + rng.uniform(0.0, 0.1)
                free_s = begin_s + OWN_S[name] * np.exp(0.05 * rng.standard_normal())
                some.append(DoneTask(str(name), begin_s, free_s, planned_s if plan else np.nan))
                planned_s += LATE * OWN_S[name]
            tasks[agent] = tuple(some)
        runs.append(Run(str(number), tasks, number))
    return learn_runs(runs, {"arm": "robot", "worker": "operator"}, folds=0)


def planner(but: int | None = None) -> list[PlannedTask]:
    """Return a plan in which every task but one has a planned start."""
    found = []
    for agent, names in AGENTS.items():
        planned_s = 0.0
        for name in names * 3:
            found.append(PlannedTask(agent, name, None if len(found) == but else planned_s))
            planned_s += LATE * OWN_S[name]
    return found


ARM_S, WORKER_S = 3 * (4.0 + 3.0), 3 * (5.0 + 4.0)
HELD_S = {"arm": LATE * (ARM_S - 3.0) + 3.0, "worker": LATE * (WORKER_S - 4.0) + 4.0}


@pytest.mark.parametrize("kept", [set(), {"arm"}, {"worker"}, {"arm", "worker"}])
def test_planned_starts_hold_only_who_kept_to_them(kept: set[str]) -> None:
    model = logged(kept)
    assert set(model.before_plan) == set(AGENTS) - kept
    assert all(share > 0.9 for share in model.before_plan.values())
    rolled = roll_plan(model, planner(), cycles=200)
    ends = dict(zip([task.agent for task in rolled.tasks], rolled.end_s.mean(axis=0), strict=True))
    for agent, own_s in (("arm", ARM_S), ("worker", WORKER_S)):
        assert ends[agent] == pytest.approx(HELD_S[agent] if agent in kept else own_s, rel=0.03)


def test_starts_of_single_tasks_hold_everybody() -> None:
    model = logged(set())
    plan = [PlannedTask(agent, name) for agent, names in AGENTS.items() for name in names]
    told = [*plan[:-1], PlannedTask("worker", "pack", 20.0)]
    assert roll_plan(model, told, cycles=50).start_s[:, -1].min() >= 20.0
    assert roll_plan(model, planner(but=4), cycles=50).start_s[:, -1].min() >= planner()[-1].not_before_s


def test_who_was_logged_without_a_plan_is_held_by_that_of_a_plan() -> None:
    model = logged(set(), plan=False)
    assert not model.before_plan
    assert roll_plan(model, planner(), cycles=50).start_s[:, -1].min() >= planner()[-1].not_before_s


def test_the_answer_says_whom_the_plan_does_not_hold_and_the_page_rolls_alike() -> None:
    model = logged({"arm"})
    sequence = TaskSequence.of_plan("plan", planner())
    (answer,) = estimate_plans(model, [sequence], refused=lambda *_: pytest.fail("refused"))
    (said,) = (warning for warning in answer.warnings if "planned starts" in warning)
    assert "do not hold worker" in said
    assert answer.expected_s == pytest.approx(WORKER_S, rel=0.03)
    held = {(task["agent"], task.get("not_before_s", 0.0) > 0.0) for task in _plan(model, answer)["tasks"][1:]}
    assert held == {("arm", True), ("worker", False)}
    few = TaskSequence.of_plan("few", planner(but=4))
    (answer,) = estimate_plans(model, [few], refused=lambda *_: pytest.fail("refused"))
    assert not any("planned starts" in warning for warning in answer.warnings)
