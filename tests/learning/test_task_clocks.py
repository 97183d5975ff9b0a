"""Task lists whose agents were logged by clocks that differ: conditions are found all the same, and it is said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards.task_model import ClockErrorCard, TaskModelCard
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.learning.task_times.clocks import in_one_clock
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.runs import DoneTask, Run
from cyclekit_sim.task_lists import AGENTS, ListOptions, one_cycle, random_order

pytestmark = [pytest.mark.usefixtures("quick_task_times"), pytest.mark.tests_clocks]

KINDS = {AGENTS[kind]: kind for kind in AGENTS}
TRUE = {("mount", "bring"), ("weld", "mount")}


def logged(ahead_s: np.ndarray, options: ListOptions | None = None, *, step_s: float = 0.001) -> list[Run]:
    """Return executions with the worker's clock ahead by these amounts, s, with times rounded to a step."""
    rng, found = np.random.default_rng(8), []
    for number, ahead in enumerate(ahead_s.tolist()):
        cycle = one_cycle(random_order(rng), rng, options or ListOptions())
        tasks: dict[str, tuple[DoneTask, ...]] = {}
        begin_s = min(start + (agent == "operator") * ahead for agent, _, start, _ in cycle)
        for agent, task, *times in sorted(cycle, key=lambda each: each[2]):
            at = [round((t + (agent == "operator") * ahead - begin_s) / step_s) * step_s for t in times]
            tasks[AGENTS[agent]] = (*tasks.get(AGENTS[agent], ()), DoneTask(task, *at))
        found.append(Run(str(number), tasks, number))
    return found


@cache
def learned_in_one_clock() -> TaskModelCard:
    return learn_runs(logged(np.zeros(30)), KINDS, folds=0)


@pytest.mark.parametrize("ahead_s", [-4.0, 0.5, *(pytest.param(s, marks=pytest.mark.slow) for s in (-0.5, 2.0))])
def test_conditions_are_found_though_one_clock_is_off(ahead_s: float) -> None:
    runs = logged(np.full(30, ahead_s))
    model = learn_runs(runs, KINDS, folds=0)
    assert {(task.task, need.task) for task in model.tasks for need in task.needs} == TRUE
    clock = model.clocks["worker"]
    assert clock.of == "arm"
    assert clock.least_s == clock.most_s == pytest.approx(-ahead_s, abs=0.21)  # each lag is 0.2 s
    plan = [PlannedTask("arm", "bring"), PlannedTask("worker", "mount"), PlannedTask("arm", "weld")]
    (answer,) = estimate_plans(model, [TaskSequence.of_plan("plan", plan)], refused=lambda *_: None)
    (true,) = estimate_plans(learned_in_one_clock(), [TaskSequence.of_plan("plan", plan)], refused=lambda *_: None)
    assert answer.expected_s == pytest.approx(true.expected_s, rel=0.01)
    side = "ahead" if ahead_s > 0 else "behind"
    (said,) = (each for each in answer.warnings if "clock" in each)
    assert said.startswith("clock of worker: ")
    assert f" s {side} of the clock of arm; times are put right" in said


def test_the_robots_times_stay_where_an_execution_then_begins_later_or_earlier() -> None:
    runs = [replace(run, begin_s=100.0 * run.number) for run in logged(np.full(30, -4.0))]
    right, _ = in_one_clock(runs, KINDS)
    for before, now in zip(runs, right, strict=True):
        starts_s = [run.begin_s + run.tasks["arm"][0].start_s for run in (before, now)]
        assert starts_s[0] == pytest.approx(starts_s[1])
    assert any(now.begin_s > before.begin_s for before, now in zip(runs, right, strict=True))


@pytest.mark.parametrize("drift_s", [1.5, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_a_clock_that_drifts_is_followed(drift_s: float) -> None:
    model = learn_runs(logged(np.linspace(0.0, drift_s, 60)), KINDS, folds=0)
    assert {(task.task, need.task) for task in model.tasks for need in task.needs} == TRUE
    clock = model.clocks["worker"]
    assert clock.most_s - clock.least_s == pytest.approx(abs(drift_s), abs=0.3)


@pytest.mark.parametrize("step_s", [0.001, 0.1, 1.0])
def test_no_clock_is_off_that_is_right(step_s: float) -> None:
    assert in_one_clock(logged(np.zeros(30), step_s=step_s), KINDS)[1] == {}


def test_no_clock_is_off_where_agents_wait_in_some_turns() -> None:
    runs = logged(np.zeros(40), ListOptions(needed=0.5))
    assert in_one_clock(runs, KINDS)[1] == {}
    model = learn_runs(logged(np.full(40, 2.0), ListOptions(needed=0.5)), KINDS, folds=0)
    assert model.clocks["worker"].most_s == pytest.approx(-1.9, abs=0.15)
    assert {(task.task, need.task) for task in model.tasks for need in task.needs} == TRUE


@pytest.mark.parametrize("ahead_s", [0.0, 0.5])
def test_no_clock_is_told_by_agents_who_do_not_wait(ahead_s: float) -> None:
    assert in_one_clock(logged(np.full(30, ahead_s), ListOptions(coupled=False)), KINDS)[1] == {}


def test_a_clock_that_changes_is_said_with_both_amounts() -> None:
    said = ClockErrorCard(of="arm", least_s=-0.3, most_s=1.0).said("worker")
    assert said.startswith("clock of worker: 1.00 s behind to 0.30 s ahead, as it changes, of the clock of arm;")
