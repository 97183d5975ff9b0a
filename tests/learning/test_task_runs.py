"""Executions of task lists as they are learned from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.runs import logged_runs

if TYPE_CHECKING:
    from pathlib import Path

TASKS = (("arm", "to fixture"), ("arm", "weld"), ("worker", "weld"))


def test_names_that_differ_only_in_case_and_spaces_are_of_one_task(tmp_path: Path) -> None:
    rows = []
    for run in range(10):
        for at, (agent, task) in enumerate(TASKS):
            spelt = {0: task.upper(), 1: task.replace(" ", "_"), 2: f"  {task}"}.get((run + at) % 5, task)
            rows.append((run, agent, spelt, 3.0 * at, 3.0 * at + 2.0))
    columns = ["run", "agent", "task", "start_s", "end_s"]
    pl.DataFrame(rows, schema=columns, orient="row").write_csv(tmp_path / "tasks.csv")
    ingest([tmp_path / "tasks.csv"], tmp_path / "dataset")
    runs, _ = logged_runs(Dataset.open(tmp_path / "dataset"))
    assert len(runs) == 10
    assert {run.order for run in runs} == {(("arm", "to fixture", "weld"), ("worker", "weld"))}
