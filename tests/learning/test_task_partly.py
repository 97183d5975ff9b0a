"""Task lists whose tasks wait only some times: how often, whether both agents then do, and what plans take."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.config.sequences import PlannedTask
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run
from cyclekit.learning.task_times.starts import learn_starts
from cyclekit_sim.task_lists import AGENTS, ListOptions, fresh_durations, one_cycle, random_order

KINDS = {AGENTS[kind]: kind for kind in AGENTS}
OPTIONS = ListOptions(needed=0.6, parallel_rates=False)


def logged(seed: int, options: ListOptions) -> list[Run]:
    rng, found = np.random.default_rng(seed), []
    for number in range(50):
        tasks: dict[str, tuple[DoneTask, ...]] = {}
        for agent, task, start_s, end_s in sorted(one_cycle(random_order(rng), rng, options), key=lambda each: each[2]):
            tasks[AGENTS[agent]] = (*tasks.get(AGENTS[agent], ()), DoneTask(task, start_s, end_s))
        found.append(Run(str(number), tasks, number))
    return found


def test_who_waits_in_some_turns_is_learned_with_how_often_and_together() -> None:
    model = learn_runs(logged(1, OPTIONS), KINDS, folds=0)
    needs = {(task.task, need.task): need for task in model.tasks for need in task.needs}
    assert needs.keys() == {("mount", "bring"), ("weld", "mount")}
    for need in needs.values():
        assert need.needed == pytest.approx(0.6, abs=0.15)
        assert need.together == 1
    assert any("of the times)" in said for task in model.tasks for said in task.waits_for)
    rng = np.random.default_rng(99)
    for number in range(3):
        order = random_order(rng)
        plan = [PlannedTask(agent, task) for agent, tasks in order.items() for task in tasks]
        true_s = np.mean(fresh_durations(order, cycles=200, seed=number, options=OPTIONS))
        rolled = roll_plan(model, plan, cycles=500)
        assert rolled.duration_s.mean() == pytest.approx(true_s, rel=0.025)
        mount = next(n for n, task in enumerate(plan) if task.name == "mount")
        assert set(np.unique(rolled.decides[:, mount])) <= {-1.0, *map(float, range(len(plan)))}


@pytest.mark.parametrize("seed", [2, 3])
def test_nothing_is_needed_some_times_where_nobody_waits(seed: int) -> None:
    runs = logged(seed, ListOptions(coupled=False))
    assert not any(each.needs for agent in KINDS for each in learn_starts(runs, agent).values())


@pytest.mark.parametrize("seed", [2, 3])
def test_waits_for_something_that_is_not_logged_are_no_condition(seed: int) -> None:
    rng, found = np.random.default_rng(seed), []
    for number in range(50):
        t, tasks = 0.0, []
        for _ in range(6):
            t += 0.2 + (rng.uniform(1.0, 9.0) if rng.random() < 0.4 else 0.0)
            tasks.append(DoneTask("weld", t, t := t + 5.0 * np.exp(0.1 * rng.standard_normal())))
        ends = np.cumsum(rng.uniform(2.0, 6.0, (10, 2)).sum(axis=1))
        others = [DoneTask(str(rng.choice(["pack", "sort"])), end - 2.0, float(end)) for end in ends]
        found.append(Run(str(number), {"arm": tuple(tasks), "worker": tuple(others)}, number))
    assert not learn_starts(found, "arm")["weld"].needs
