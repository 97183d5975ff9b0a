"""Conditions in task lists that no task shows alone: of tasks of one kind, and of processes of the agent itself."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from cyclekit.config import Cell, Wait
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards.task_model import NeedCard, TaskModelCard, TaskTimesCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.learn import learn_runs, learn_task_times
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run, logged_runs
from cyclekit.learning.task_times.starts import learn_starts
from cyclekit_sim import COUPLED, SimulationOptions, fresh_cycles, random_orders, simulate
from cyclekit_sim.coupled_list import listed_conditions, task_plan

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells

    from cyclekit.learning.task_times.starts import Starts

OWN_S = {"tend": 3.0, "sort": 4.0, "stack": 6.0}
PROCESS_S = 12.0


def listed(folder: Path, scene: str, coupling: float = 1.0) -> Dataset:
    options = SimulationOptions(task_list=True, coupling=coupling)
    simulate(scene, folder / "logs", executions=20, seed=3, options=options)
    ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset")


def needs_of(dataset: Dataset) -> set[tuple[str, str, int]]:
    runs, agents = logged_runs(dataset)
    found = [(task, each) for agent in agents for task, each in learn_starts(runs, agent).items()]
    return {(task, need.task, need.back) for task, each in found for need in each.needs}


def true_needs(scene: str) -> set[tuple[str, str, int]]:
    return {(str(each["task"]), str(each["needs"]), each["back"]) for each in listed_conditions(COUPLED[scene])}  # type: ignore[misc]


def of_machine(rng: np.random.Generator, process_s: float, lag_s: float = 0.2) -> dict[str, Starts]:
    """Return what is learned of a robot that tends a machine and does other tasks while it processes."""
    runs = []
    for number in range(25):
        t, done_s, tasks = 0.0, 0.0, []
        for task in rng.permutation(["tend"] * 4 + ["sort"] * 4 + ["stack"] * 2):
            begin = max(t + lag_s * rng.uniform(0.5, 1.5), done_s if task == "tend" else 0.0)
            t = begin + OWN_S[task] * np.exp(0.1 * rng.standard_normal())
            done_s = t + process_s * rng.uniform(0.97, 1.03) if task == "tend" else done_s
            tasks.append(DoneTask(str(task), begin, t))
        runs.append(Run(str(number), {"arm": tuple(tasks)}, number))
    return learn_starts(runs, "arm")


@pytest.mark.parametrize("seed", [1, 2])
def test_a_robot_that_waits_for_the_machine_it_loaded_is_learned_with_the_process_time(seed: int) -> None:
    found = of_machine(np.random.default_rng(seed), PROCESS_S)
    (need,) = found["tend"].needs
    assert (need.agent, need.task, need.back) == ("arm", "tend", 1)
    assert need.after_s == pytest.approx(PROCESS_S, abs=0.4)
    assert not found["sort"].needs
    assert not found["stack"].needs


@pytest.mark.parametrize("lag_s", [0.2, 2.0])
def test_nothing_is_found_where_the_robot_waits_for_no_process(lag_s: float) -> None:
    assert not any(each.needs for each in of_machine(np.random.default_rng(3), 0.0, lag_s).values())


@pytest.mark.usefixtures("quick_task_times")
@pytest.mark.parametrize("orders", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_the_wait_for_a_machine_is_the_shorter_the_more_is_done_in_between(orders: int, tmp_path: Path) -> None:
    dataset, scene = listed(tmp_path, "machine-tending"), "machine-tending"
    assert needs_of(dataset) == true_needs(scene)
    model = learn_runs(*logged_runs(dataset), folds=0)
    (need,) = (need for task in model.tasks for need in task.needs)
    assert 12.6 < need.after_s < 13.4
    for number, order in enumerate(random_orders(scene, 77, orders)):
        plan = [PlannedTask(agent, task) for agent, task in task_plan(COUPLED[scene], order)]
        true_s = fresh_cycles(scene, order, cycles=60, seed=number).durations_s.mean()
        assert roll_plan(model, plan, cycles=300).duration_s.mean() == pytest.approx(true_s, rel=0.02)


def test_fixtures_of_one_kind_show_together_what_the_robot_waits_for(tmp_path: Path) -> None:
    assert needs_of(listed(tmp_path, "four-fixtures")) == true_needs("four-fixtures")


@pytest.mark.parametrize("scene", ["machine-tending", pytest.param("four-fixtures", marks=pytest.mark.slow)])
def test_nothing_is_found_where_nobody_waits_for_anybody(tmp_path: Path, scene: str) -> None:
    assert not needs_of(listed(tmp_path, scene, coupling=0.0))


def test_an_agent_does_not_wait_for_its_own_later_task() -> None:
    need = NeedCard(agent="arm", task="load", after_s=5.0)
    usual: dict[str, Any] = {"agent": "arm", "usual_s": 1.0, "work_s": (1.0,), "rates": {}, "after": {}, "lags_s": (0,)}
    cards = TaskTimesCard(task="load", **usual), TaskTimesCard(task="unload", needs=(need,), **usual)
    assert cards[1].waits_for[1:] == ["5.0 s after arm: load"]
    model = TaskModelCard(agents={"arm": "robot"}, tasks=cards, executions=5)
    load, unload = (PlannedTask("arm", card.task) for card in cards)
    assert roll_plan(model, [load, unload], cycles=1).duration_s == pytest.approx([7.0])
    assert roll_plan(model, [unload, load], cycles=1).duration_s == pytest.approx([2.0])


def test_the_time_from_task_to_task_is_a_wait_only_where_something_else_decides() -> None:
    usual: dict[str, Any] = {"usual_s": 1.0, "rates": {}, "after": {}, "lags_s": (0.2,)}
    need = NeedCard(agent="arm", task="bring")
    cards = (
        TaskTimesCard(agent="arm", task="bring", work_s=(3.0,), **usual),
        TaskTimesCard(agent="worker", task="pack", work_s=(1.0,), **usual),
        TaskTimesCard(agent="worker", task="mount", work_s=(1.0,), needs=(need,), **usual),
    )
    model = TaskModelCard(agents={"arm": "robot", "worker": "operator"}, tasks=cards, executions=5)
    plan = [PlannedTask("arm", "bring"), *(PlannedTask("worker", name) for name in ("pack", "mount", "pack"))]
    rolled = roll_plan(model, plan, cycles=1)
    assert rolled.start_s[0] == pytest.approx([0.2, 0.2, 3.4, 4.6])
    assert rolled.wait_s[0] == pytest.approx([0.0, 0.0, 2.2, 0.0])
    told = [*plan[:-1], PlannedTask("worker", "pack", not_before_s=6.0)]
    assert roll_plan(model, told, cycles=1).wait_s[0] == pytest.approx([0.0, 0.0, 2.2, 1.8])


def test_a_plan_that_seldom_decides_is_no_lag() -> None:
    runs = []
    for number in range(4):
        late_s = 9.0 if number % 2 else 5.0
        tasks = DoneTask("load", 0.0, 5.1, 0.0), DoneTask("weld", late_s + 0.1, late_s + 6.0, late_s)
        runs.append(Run(str(number), {"arm": tasks}, number))
    assert learn_starts(runs, "arm")["weld"].lags_s.max() < 0.2


@pytest.mark.parametrize("missing", [False, True])
def test_a_plan_that_is_always_alike_or_is_missing_in_part_is_no_lag(missing: bool) -> None:
    rng, runs = np.random.default_rng(3), []
    for number in range(12):
        late_s = 5.0 + 0.05 * (number % 3) + rng.uniform(0.0, 0.8)
        planned_s = np.nan if missing and number % 3 == 0 else 5.0 + 0.05 * (number % 3)
        runs.append(Run(str(number), {"arm": (DoneTask("weld", late_s, late_s + 6.0, planned_s),)}, number))
    found = learn_starts(runs, "arm")["weld"]
    assert found.planned
    assert found.lags_s.max() < 0.9


@pytest.mark.usefixtures("quick_task_times")
def test_the_cell_file_tells_what_a_task_does_not_wait_for(tmp_path: Path) -> None:
    dataset, there = listed(tmp_path, "shared-fixture"), true_needs("shared-fixture")
    runs, agents = logged_runs(dataset)
    assert needs_of(dataset) == there
    until, never = Wait("robot", task="bring", until="mount", never=True), Wait("operator", task="mount", never=True)
    for agent, wait, free in (("robot", until, "bring"), ("operator", never, "mount")):
        (name,) = (name for name, kind in agents.items() if kind == agent)
        starts = learn_starts(runs, name, [wait])
        found = {(task, need.task, need.back) for task, each in starts.items() for need in each.needs}
        assert found == {each for each in there if each[0] in starts and each[0] != free}
    model = learn_runs(runs, agents, given=[until, never], folds=0)
    found = {(task.task, need.task, need.back) for task in model.tasks for need in task.needs}
    assert found == {each for each in there if each[0] not in {"bring", "mount"}}


@pytest.mark.parametrize(
    ("wait", "seen"),
    [
        (Wait("robot", task="mount", never=True), "task 'mount'"),
        (Wait("operator", task="mount", until="weld", never=True), "task 'weld'"),
        (Wait("robot", before="fixture", never=True), "tells of places"),
    ],
)
def test_waits_of_unknown_tasks_are_refused(cells: Cells, tmp_path: Path, wait: Wait, seen: str) -> None:
    cell = replace(Cell(), waits=(wait,))
    ingest([cells.logs("shared-fixture", 6, task_list=True)], tmp_path / "dataset", cell=cell)
    with pytest.raises(ConfigError, match=seen):
        learn_task_times(Dataset.open(tmp_path / "dataset"))
