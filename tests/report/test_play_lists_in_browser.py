"""The part to play with for task lists whose tasks depend on more, or wait for parts: the library's own numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import browser
import numpy as np
import polars as pl
import pytest
from played import ask, plans_are_the_same, same

from cyclekit import TaskSequence, train_task_times, what_if
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.whatif.change import Change
from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.learning.task_times.saved import TaskTimesModel

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]
OPERATOR = ["mount", "pack", "mount"]
Row = tuple[int, str, str, float, float]


def model_of(rows: list[Row], folder: Path) -> TaskTimesModel:
    """Return the model of a task list with these rows, ingested in a folder."""
    pl.DataFrame(rows, schema=["run", "agent", "task", "start_s", "end_s"], orient="row").write_csv(
        folder / "tasks.csv"
    )
    ingest([folder / "tasks.csv"], folder / "dataset")
    return train_task_times(folder / "dataset")


def slowed_rows() -> list[Row]:
    """Return 50 executions: a weld is slow during the second mount; glue that begins in a pack takes twice as long."""
    rng = np.random.default_rng(1)
    rows: list[Row] = []
    for run in range(50):
        rows += [(run, "human", task, at, at + 6.0) for task, at in zip(OPERATOR, (0.0, 6.0, 12.0), strict=True)]
        glue, weld = rng.uniform(0.0, 10.0), 12.0 + rng.uniform(0.0, 3.0) if run % 2 else None
        glued = glue + rng.uniform(1.9, 2.1) * (2.0 if 6.0 <= glue < 12.0 else 1.0)
        weld = glued if weld is None else max(weld, glued)
        fast_s, work = max(12.0 - weld, 0.0), rng.uniform(2.9, 3.1)
        slow = min(max(work - fast_s, 0.0) / 0.4, 18.0 - max(weld, 12.0))
        welded = weld + work - 0.4 * slow + slow
        rows += [(run, "arm", "glue", glue, glued), (run, "arm", "weld", weld, welded)]
    return rows


def test_plans_have_the_numbers_of_the_library(tab, tmp_path):
    model = model_of(slowed_rows(), tmp_path)
    assert any(task.nth for task in model.card.tasks)
    assert any(task.at_start for task in model.card.tasks)
    orders = {"as logged": ["glue", "weld"], "twice": ["weld", "glue", "weld", "glue"]}
    sequences = [
        TaskSequence.of_plan(
            name, [*(PlannedTask("arm", t) for t in arm), *(PlannedTask("human", t) for t in OPERATOR)]
        )
        for name, arm in orders.items()
    ]
    plans_are_the_same(tab, tmp_path, model, sequences)


def placed_rows() -> list[Row]:
    """Return 60 executions: a mount at the first position, and the wait after it, slow the arm; places have slots."""
    rng = np.random.default_rng(4)
    rows: list[Row] = []
    for run in range(60):
        human = rng.permutation(OPERATOR).tolist()
        rows += [(run, "human", task, 7.0 * at, 7.0 * at + rng.uniform(4.5, 5.5)) for at, task in enumerate(human)]
        t = rng.uniform(0.0, 6.0)
        for position, task in enumerate(rng.permutation(["place", "move", "move"]).tolist()):
            work, begins = ((3.0, 5.0, 4.0)[position] if task == "place" else 4.0) * rng.uniform(0.97, 1.03), t
            slow_s = min(max(7.0 - t, 0.0), work / 0.2) if human[0] == "mount" else 0.0
            t = begins + slow_s + work - 0.2 * slow_s
            rows.append((run, "arm", task, begins, t))
    return rows


def test_plans_whose_positions_matter_have_the_numbers_of_the_library(tab, tmp_path):
    model = model_of(placed_rows(), tmp_path)
    assert any(task.position and task.position_waiting for task in model.card.tasks)
    assert any(task.own_position for task in model.card.tasks)
    sequences = [
        TaskSequence.of_plan(
            f"{arm[0]} {human[0]}",
            [*(PlannedTask("arm", t) for t in arm), *(PlannedTask("human", t, 7.0 * n) for n, t in enumerate(human))],
        )
        for arm in (["place", "move", "move"], ["move", "place", "move", "place"])
        for human in (OPERATOR, ["pack", "mount", "mount"])
    ]
    plans_are_the_same(tab, tmp_path, model, sequences)


def reacting_rows() -> list[Row]:
    """Return 40 executions: who waits for a part mounts 1 s after it has come, who comes later mounts at once."""
    rng = np.random.default_rng(5)
    rows: list[Row] = []
    for run in range(40):
        brought = np.cumsum(rng.uniform(5.0, 7.0, 3)).tolist()
        rows += [(run, "arm", "bring", end - 5.0, end) for end in brought]
        t, parts = 0.0, iter(brought)
        for task in rng.permutation(["mount"] * 3 + ["pack"] * 3).tolist():
            begins = max(t, next(parts) + rng.uniform(0.8, 1.2)) if task == "mount" else t
            t = begins + rng.uniform(2.5, 3.5)
            rows.append((run, "human", task, begins, t))
    return rows


def test_plans_in_which_he_waits_for_parts_have_the_numbers_of_the_library(tab, tmp_path):
    model = model_of(reacting_rows(), tmp_path)
    assert any(task.need_lags_s for task in model.card.tasks)
    sequences = [
        TaskSequence.of_plan(
            human[0], [*(PlannedTask("arm", "bring") for _ in range(3)), *(PlannedTask("human", t) for t in human)]
        )
        for human in (["mount"] * 3 + ["pack"] * 3, ["pack"] * 3 + ["mount"] * 3)
    ]
    plans_are_the_same(tab, tmp_path, model, sequences)


def fed_rows() -> list[Row]:
    """Return 40 executions of a robot whose loads begin with a part of a conveyor."""
    rng = np.random.default_rng(2)
    rows: list[Row] = []
    for run in range(40):
        t, came_s = 0.0, 0.0
        for task in ["weld", *rng.permutation(["load"] * 3 + ["weld"] * 2).tolist()]:
            if task == "load":
                came_s += 5.0 + rng.exponential(4.0)
                t = max(t, came_s)
            rows.append((run, "arm", task, t, t + rng.uniform(3.9, 4.1)))
            t = rows[-1][-1]
    return rows


def test_plans_that_wait_for_parts_have_the_numbers_of_the_library(tab, tmp_path):
    model = model_of(fed_rows(), tmp_path)
    assert any(task.parts for task in model.card.tasks)
    orders = {"early": ["weld", *["load"] * 7], "late": ["weld"] * 6 + ["load"] * 3}
    sequences = [TaskSequence.of_plan(name, [PlannedTask("arm", t) for t in arm]) for name, arm in orders.items()]
    plans_are_the_same(tab, tmp_path, model, sequences)
    change = Change("no wait", no_wait=(("load", "part"),))
    played = [{"agent": "arm", "asked": "arm", "name": name, "after": []} for name in orders["early"]]
    (wanted,) = what_if(model, Dataset.open(tmp_path / "dataset"), sequences[:1], [change])
    same(ask(tab, played, {"without": ["load for part"]}), wanted.after, within=1e-5)


def some_times_rows() -> list[Row]:
    """Return 60 executions in which mount and weld wait for each other in half of the turns."""
    rng = np.random.default_rng(3)
    rows: list[Row] = []
    for run in range(60):
        both = rng.random() < 0.5
        bring = rng.uniform(3.0, 9.0)
        mount = (bring + 0.2 if both else 2.5) + rng.uniform(0.0, 0.1)
        mounted = mount + rng.uniform(3.9, 4.1)
        weld = (max(mounted, bring) if both else bring) + rng.uniform(0.1, 0.2)
        rows += [(run, "arm", "bring", 0.0, bring), (run, "arm", "weld", weld, weld + rng.uniform(2.9, 3.1))]
        rows += [(run, "human", "pack", 0.0, 2.4), (run, "human", "mount", mount, mounted)]
    return rows


def test_plans_that_wait_some_times_have_the_numbers_of_the_library(tab, tmp_path):
    model = model_of(some_times_rows(), tmp_path)
    needs = [need for task in model.card.tasks for need in task.needs]
    assert len(needs) == 2
    assert all(0.3 < need.needed < 0.7 and need.together == 1 for need in needs)
    orders = {"once": ["bring", "weld"], "twice": ["bring", "bring", "weld", "weld"]}
    sequences = [
        TaskSequence.of_plan(
            name,
            [
                *(PlannedTask("arm", t) for t in arm),
                *(PlannedTask("human", t) for t in ["pack", *["mount"] * (len(arm) // 2)]),
            ],
        )
        for name, arm in orders.items()
    ]
    plans_are_the_same(tab, tmp_path, model, sequences)


def test_plans_of_an_operator_who_becomes_quicker_have_the_numbers_of_the_library(tab, tmp_path):
    rng = np.random.default_rng(4)
    rows: list[Row] = []
    for run in range(60):
        pack = rng.uniform(9.5, 10.5) * (1.0 - 0.3 * run / 59)
        rows += [(run, "human", "pack", 0.0, pack), (run, "arm", "weld", 0.0, rng.uniform(3.9, 4.1))]
    model = model_of(rows, tmp_path)
    assert model.card.pace["human"].error > 0.003
    tasks = [PlannedTask("arm", "weld"), PlannedTask("human", "pack")]
    plans_are_the_same(tab, tmp_path, model, [TaskSequence.of_plan("both", tasks)], within=2e-4)


def test_plans_that_lack_repeated_tasks_have_the_numbers_of_the_library(tab, tmp_path):
    rows = [
        (run, "arm", name, 100.0 * run + 2.0 * at, 100.0 * run + 2.0 * at + 1.5 + 0.02 * (run % 7))
        for run in range(20)
        for at, name in enumerate("ppq" if run % 5 == 0 else "pq")
    ]
    model = model_of(rows, tmp_path)
    assert model.card.interludes
    orders = [TaskSequence.of_plan(order, [PlannedTask("arm", name) for name in order]) for order in ("pq", "ppq")]
    plans_are_the_same(tab, tmp_path, model, orders)
