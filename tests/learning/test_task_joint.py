"""Joint tasks in task lists: both sides of a handover end together, what two carry starts and ends together."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.config.sequences import PlannedTask
from cyclekit.errors import EstimateError
from cyclekit.learning.task_times.joint import joint_tasks
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run

AGENTS = {"arm": "robot", "human": "operator"}
MEAN_S = {"pick": 5.0, "polish": 8.0, "hand over": 4.0, "sort": 6.0, "pack": 4.0, "take": 2.0}
WORK = {"arm": ["pick", "polish", "hand over"], "human": ["sort", "pack", "take"]}
JOINT = {"hand over": "take", "take": "hand over"}

Order = dict[str, list[str]]


def random_order(rng: np.random.Generator) -> Order:
    return {agent: [str(task) for task in rng.permutation(tasks * 2)] for agent, tasks in WORK.items()}


def done(order: Order, rng: np.random.Generator, *, carry: bool = False) -> dict[str, tuple[DoneTask, ...]]:
    """Return one execution; with `carry` joint tasks also start together."""
    free_s, at = dict.fromkeys(order, 0.0), dict.fromkeys(order, 0)
    found: dict[str, list[DoneTask]] = {agent: [] for agent in order}

    def began(agent: str) -> float:
        return free_s[agent] + 0.1

    def end(agent: str, task: str, start_s: float, end_s: float) -> None:
        found[agent].append(DoneTask(task, start_s, end_s))
        free_s[agent], at[agent] = end_s, at[agent] + 1

    def took_s(task: str) -> float:
        return MEAN_S[task] * float(np.exp(0.05 * rng.standard_normal()))

    while any(at[agent] < len(tasks) for agent, tasks in order.items()):
        for agent, tasks in order.items():
            while at[agent] < len(tasks) and tasks[at[agent]] not in JOINT:
                task, start_s = tasks[at[agent]], began(agent)
                end(agent, task, start_s, start_s + took_s(task))
        if all(at[agent] < len(tasks) for agent, tasks in order.items()):
            starts = {agent: began(agent) for agent in order}
            starts = dict.fromkeys(order, max(starts.values())) if carry else starts
            sides = {agent: order[agent][at[agent]] for agent in order}
            ends = [starts[agent] + took_s(sides[agent]) for agent in (["arm"] if carry else order)]
            for agent, task in sides.items():
                end(agent, task, starts[agent], max(ends))
    return {agent: tuple(tasks) for agent, tasks in found.items()}


def logged(seed: int, *, carry: bool = False) -> list[Run]:
    rng = np.random.default_rng(seed)
    return [Run(str(n), done(random_order(rng), rng, carry=carry), n) for n in range(30)]


@pytest.mark.parametrize("carry", [False, True])
def test_new_orders_of_joint_tasks_take_as_long_as_they_do(carry: bool) -> None:
    model = learn_runs(logged(1, carry=carry), AGENTS, folds=0)
    joint = {task.task: (task.joint.task, task.joint.starts) for task in model.tasks if task.joint}
    assert joint == {task: (other, carry) for task, other in JOINT.items()}
    rng = np.random.default_rng(99)
    for _ in range(3):
        order = random_order(rng)
        fresh = [Run("", done(order, rng, carry=carry)) for _ in range(100)]
        plan = [PlannedTask(agent, task) for agent, tasks in order.items() for task in tasks]
        rolled = roll_plan(model, plan, cycles=300)
        assert rolled.duration_s.mean() == pytest.approx(np.mean([run.duration_s for run in fresh]), rel=0.02)
        ends = dict(zip((task.name for task in rolled.tasks), rolled.end_s.T, strict=True))
        assert ends["take"] == pytest.approx(ends["hand over"])


def test_a_side_without_the_other_takes_its_own_time_and_crossed_handovers_never_end() -> None:
    runs = logged(2)
    model = learn_runs(runs, AGENTS, folds=0)
    alone = roll_plan(model, [PlannedTask("arm", "hand over")], cycles=200)
    assert alone.duration_s.mean() == pytest.approx(MEAN_S["hand over"], rel=0.1)
    plan = [
        PlannedTask("arm", "hand over"),
        PlannedTask("human", "sort"),
        PlannedTask("human", "take", after=("polish",)),
    ]
    with pytest.raises(EstimateError, match="it waits for a task that waits for it"):
        roll_plan(model, [*plan, PlannedTask("arm", "polish")], cycles=2)


def test_tasks_that_end_together_now_and_then_are_not_joint() -> None:
    runs = logged(3)
    assert set(joint_tasks(runs)) == {("arm", "hand over"), ("human", "take")}
    rng = np.random.default_rng(4)
    apart = [
        Run(run.name, {**run.tasks, "human": tuple(
            DoneTask(each.task, each.start_s, each.end_s + (0.5 if each.task == "take" and rng.random() < 0.1 else 0.0))
            for each in run.tasks["human"]
        )}, run.number) for run in runs
    ]  # fmt: skip
    assert not joint_tasks(apart)
