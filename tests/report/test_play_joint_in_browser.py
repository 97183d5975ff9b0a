"""The part to play with for task lists with joint tasks: the library's own numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import browser
import numpy as np
import polars as pl
import pytest
from played import ask, same

from cyclekit import TaskSequence, estimate_cycles, train_task_times, write_report
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]
ROBOT, OPERATOR = ["pick", "offer", "carry"], ["sort", "take", "carry"]


def write_list(path: Path) -> None:
    """Write 20 executions: the robot offers what the operator takes, and both carry something together."""
    rng = np.random.default_rng(1)
    rows = []
    for run in range(20):
        picked, sorted_ = rng.uniform(4.0, 7.0), rng.uniform(3.0, 8.0)
        taken = max(picked + rng.uniform(3.8, 4.2), sorted_ + rng.uniform(1.8, 2.2))
        carried = taken + 0.1 + rng.uniform(5.0, 6.0)
        rows += [(run, "arm", "pick", 0.0, picked), (run, "human", "sort", 0.0, sorted_)]
        rows += [(run, "arm", "offer", picked, taken), (run, "human", "take", sorted_, taken)]
        rows += [(run, agent, "carry", taken + 0.1, carried) for agent in ("arm", "human")]
    pl.DataFrame(rows, schema=["run", "agent", "task", "start_s", "end_s"], orient="row").write_csv(path)


def test_plans_with_joint_tasks_have_the_numbers_of_the_library(tab, tmp_path):
    write_list(tmp_path / "tasks.csv")
    ingest([tmp_path / "tasks.csv"], tmp_path / "dataset")
    model = train_task_times(tmp_path / "dataset")
    assert {task.task: task.joint.starts for task in model.card.tasks if task.joint} == {
        "offer": False, "take": False, "carry": True
    }  # fmt: skip
    orders = {
        "as logged": (ROBOT, OPERATOR),
        "twice": (ROBOT * 2, ["take", "sort", "carry", *OPERATOR]),
        "one side": (ROBOT, ["sort"]),
    }
    sequences = [
        TaskSequence.of_plan(
            name, [PlannedTask(a, t) for a, some in zip(("arm", "human"), both, strict=True) for t in some]
        )
        for name, both in orders.items()
    ]
    page = tmp_path / "page.html"
    write_report(tmp_path / "dataset", page, model=model, sequences=sequences[:1], takt_s=20.0)
    tab.events.clear()
    tab.show(page)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    plans = {each.name: each.plan for each in sequences}
    for wanted in estimate_cycles(model, Dataset.open(tmp_path / "dataset"), sequences, takt_s=20.0):
        played = [
            {"agent": task.agent, "asked": task.agent, "name": task.name, "after": task.after}
            for task in plans[wanted.name]
        ]
        same(ask(tab, played, {}, 20.0), wanted, within=1e-5)
    assert tab.said() == []
