"""Waits of task lists for parts that come by themselves: a robot that comes back late waits less."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec import structs

from cyclekit.config import Wait
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import EstimateError, UnknownName
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.estimate.whatif.both import altered_times
from cyclekit.estimate.whatif.change import Change
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run, logged_runs
from cyclekit.learning.task_times.starts import learn_starts
from cyclekit_sim import COUPLED, SimulationOptions, fresh_cycles, random_orders, simulate
from cyclekit_sim.coupled_list import listed_conditions, task_plan

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.dataset.cards.task_model import TaskModelCard

AGENTS = {"arm": "robot"}
OWN_S = {"load": 3.0, "sort": 4.0, "stack": 9.0}
BUFFER = 2
FIRST, WORK = "sort", ["load"] * 4 + ["sort"] * 2 + ["stack"]


Range = tuple[float, float]


def fed(
    rng: np.random.Generator, order: Sequence[str], gap_s: Range = (5.0, 9.0), lag_s: Range = (0.05, 0.15)
) -> list[DoneTask]:
    """Return an execution of a robot whose loads begin with a part; gaps of parts have this minimum and mean."""
    t, came_s, tasks, loads = 0.0, 0.0, list[DoneTask](), list[float]()
    for task in order:
        begin = t + rng.uniform(*lag_s)
        if task == "load":
            came_s += gap_s[0] + rng.exponential(gap_s[1] - gap_s[0])
            came_s = max(came_s, loads[-BUFFER] if len(loads) >= BUFFER else 0.0)
            begin = max(begin, came_s + rng.uniform(0.05, 0.15))
            loads.append(begin)
        t = begin + OWN_S[task] * np.exp(0.02 * rng.standard_normal())
        tasks.append(DoneTask(task, begin, t))
    return tasks


def learned(seed: int, given: Sequence[Wait] = (), gap_s: Range = (5.0, 9.0)) -> TaskModelCard:
    rng = np.random.default_rng(seed)
    orders = ([FIRST, *rng.permutation(WORK).tolist()] for _ in range(40))
    runs = [Run(str(n), {"arm": tuple(fed(rng, order, gap_s))}, n) for n, order in enumerate(orders)]
    return learn_runs(runs, AGENTS, given=given, folds=0)


def parts_of(model: TaskModelCard) -> dict[str, tuple[float, int]]:
    return {task.task: (float(np.mean(task.parts.gap_s)), task.parts.buffer) for task in model.tasks if task.parts}


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_gaps_of_parts_tell_how_long_each_order_waits(seed: int) -> None:
    model = learned(seed)
    ((task, (gap_s, _)),) = parts_of(model).items()
    assert task == "load"
    assert gap_s == pytest.approx(9.0, abs=0.9)
    rng = np.random.default_rng(9)
    for order in ([FIRST, *WORK], [FIRST, *WORK[::-1]]):
        cycles = [fed(rng, order) for _ in range(1000)]
        true_s = np.mean([tasks[-1].end_s - tasks[0].start_s for tasks in cycles])
        plan = [PlannedTask("arm", task) for task in order]
        assert roll_plan(model, plan).duration_s.mean() == pytest.approx(true_s, rel=0.05)


def test_no_parts_are_found_where_they_are_always_there() -> None:
    assert not parts_of(learned(1, gap_s=(0.1, 0.2)))


@pytest.mark.parametrize("step_s", [1.0, 2.0])
def test_lags_in_whole_seconds_are_no_parts(step_s: float) -> None:
    rng = np.random.default_rng(4)
    runs = []
    for number in range(40):
        done = (
            replace(task, start_s=step_s * round(task.start_s / step_s), end_s=step_s * round(task.end_s / step_s))
            for task in fed(rng, [FIRST, *rng.permutation(WORK).tolist()], (0.1, 0.2), (0.2, 1.4))
        )
        runs.append(Run(str(number), {"arm": tuple(done)}, number))
    assert not any(each.parts for each in learn_starts(runs, "arm").values())


def test_the_cell_file_tells_that_a_task_waits_for_nothing() -> None:
    assert not parts_of(learned(1, [Wait("robot", task="load", never=True)]))


def test_a_part_comes_a_gap_after_the_one_before_if_there_is_room() -> None:
    model = learned(1)
    cards = [
        structs.replace(
            card,
            work_s=(OWN_S[card.task],),
            rates={},
            after={},
            turns=(),
            lags_s=(0.0,),
            lag_after_s={},
            parts=card.parts and structs.replace(card.parts, first_s=(7.0,), gap_s=(10.0,), buffer=1),
        )
        for card in model.tasks
    ]
    model = structs.replace(model, tasks=tuple(cards))
    plan = [PlannedTask("arm", task) for task in ("load", "stack", "load", "stack", "stack", "load")]
    rolled = roll_plan(model, plan, cycles=1)
    # parts come at 7, 17, and as soon as there is room, 19; the robot is back at 19 and at 40
    assert rolled.start_s[0] == pytest.approx([7.0, 10.0, 19.0, 22.0, 31.0, 40.0])
    assert rolled.decides[0].tolist() == [-3, -1, -1, -1, -1, -1]
    (entry,) = estimate_plans(model, [TaskSequence.of_plan("one", plan[:1])], refused=refuse)
    assert entry.plan[0].decided == {"a part": 1.0}
    assert model.tasks[0].waits_for[1:] == ["a part (10.0 s after the one before; at most 1 wait)"]
    without = altered_times(model, Change("without", no_wait=(("load", "part"),)))
    assert roll_plan(without, plan, cycles=1).duration_s == pytest.approx([36.0])
    with pytest.raises(UnknownName, match="wait 'sort for part'"):
        altered_times(model, Change("no such wait", no_wait=(("sort", "part"),)))


def test_a_conveyor_that_runs_on_between_executions_has_parts_ready() -> None:
    """Each execution takes one part: the wait depends on how long the last one is ago."""
    rng = np.random.default_rng(3)
    begin_s, came_s, taken_s, runs = 0.0, 0.0, 0.0, list[Run]()
    for number in range(80):
        sorts = [FIRST] * int(rng.choice([0, 0, 3]))
        begin, tasks = begin_s + rng.uniform(0.0, 1.0), list[DoneTask]()
        at = 0.0
        for task in ("stack", *sorts, "load"):
            at += rng.uniform(0.05, 0.15)
            if task == "load":
                came_s = max(came_s + 14.0 + rng.exponential(4.0), taken_s)
                at = max(at, came_s - begin)
                taken_s = begin + at
            tasks.append(DoneTask(task, at, at + OWN_S[task]))
            at += OWN_S[task]
        runs.append(Run(str(number), {"arm": tuple(tasks)}, number, session="shift", begin_s=begin))
        begin_s = begin + at
    parts = learn_starts(runs, "arm")["load"].parts
    assert parts is not None
    assert np.mean(parts.gap_s) == pytest.approx(18.0, abs=1.5)
    assert min(parts.first_s) < 0.0
    elsewhere = [replace(run, session=run.name) for run in runs]
    assert learn_starts(elsewhere, "arm")["load"].parts is None


@pytest.mark.usefixtures("quick_task_times")
def test_parts_of_a_conveyor_are_learned_from_a_task_list(tmp_path: Path) -> None:
    scene = "fed-line"
    simulate(scene, tmp_path / "logs", executions=25, seed=3, options=SimulationOptions(task_list=True))
    ingest([tmp_path / "logs"], tmp_path / "dataset")
    model = learn_runs(*logged_runs(Dataset.open(tmp_path / "dataset")), folds=0)
    found = {(task.task, "part", 0) for task in model.tasks if task.parts}
    assert found == {(each["task"], each["needs"], each["back"]) for each in listed_conditions(COUPLED[scene])}
    assert not any(task.needs for task in model.tasks)
    (order,) = random_orders(scene, 77, 1)
    plan = [PlannedTask(agent, task) for agent, task in task_plan(COUPLED[scene], order)]
    true_s = fresh_cycles(scene, order, cycles=100, seed=1).durations_s.mean()
    assert roll_plan(model, plan, cycles=1000).duration_s.mean() == pytest.approx(true_s, rel=0.04)


def refuse(sequence: TaskSequence, error: EstimateError) -> None:
    raise error
