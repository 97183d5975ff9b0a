"""The part to play with for task lists with joint tasks: the library's own numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import browser
import numpy as np
import polars as pl
import pytest
from played import plans_are_the_same

from cyclekit import TaskSequence, train_task_times
from cyclekit.config.sequences import PlannedTask
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
    plans_are_the_same(tab, tmp_path, model, sequences)
