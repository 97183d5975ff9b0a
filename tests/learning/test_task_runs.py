"""Executions of a task list: which names mean one task, failed attempts, and tasks done at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import DatasetError
from cyclekit.estimate.result import CycleEstimate
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.learn import learn_task_times
from cyclekit.learning.task_times.runs import logged_runs

TASKS = (("arm", "to fixture"), ("arm", "weld"), ("worker", "weld"))
Row = tuple[int, str, str, float, float, int]


def test_names_that_differ_in_every_execution_are_refused(tmp_path: Path) -> None:
    lines = ["run,agent,task,start_s,end_s"]
    for n in range(6):
        for agent, took in (("arm", 4), ("human", 5)):
            lines.append(f"r{n},{agent},pick_{n},{20 * n},{20 * n + took}")
    (tmp_path / "tasks.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    ingest([tmp_path / "tasks.csv"], tmp_path / "dataset")
    with pytest.raises(DatasetError, match="each has names of its own, such as 'pick_0'"):
        learn_task_times(Dataset.open(tmp_path / "dataset"))


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


def listed(folder: Path, *, fails: float, doubled: int = 0) -> Dataset:
    """Write and ingest twelve executions of three tasks of an arm and two of a person.

    An attempt fails after a second with probability `fails`. `doubled` executions are written twice, 3 s apart.
    """
    rng = np.random.default_rng(4)
    found: list[Row] = []
    for run in range(12):
        mine: list[Row] = []
        for agent, tasks in (("arm", ("pick", "place", "weld")), ("human", ("mount", "pack"))):
            t = 100.0 * run
            for task in tasks:
                if rng.random() < fails:
                    mine.append((run, agent, task, t, t + 1.0, 0))
                    t += 1.1
                took = rng.uniform(4.9, 5.1)
                mine.append((run, agent, task, t, t + took, 1))
                t += took + 0.1
        found += mine
        found += [(*each[:3], each[3] + 3.0, each[4] + 3.0, 1) for each in mine] if run < doubled else []
    names = ["run", "agent", "task", "start_s", "end_s", "outcome"]
    pl.DataFrame(found, schema=names, orient="row").write_csv(folder / "t.csv")
    ingest([folder / "t.csv"], folder / "data")
    return Dataset.open(folder / "data")


def answer(dataset: Dataset) -> CycleEstimate:
    tasks = [PlannedTask("arm", name) for name in ("pick", "place", "weld")]
    tasks += [PlannedTask("human", name) for name in ("mount", "pack")]
    (found,) = estimate_plans(learn_task_times(dataset), [TaskSequence.of_plan("p", tasks)], refused=_refuse)
    return found


def _refuse(_sequence: TaskSequence, error: Exception) -> None:
    raise error


@pytest.mark.usefixtures("quick_task_times")
def test_failed_attempts_are_tasks_of_their_own_where_most_executions_have_one(tmp_path: Path) -> None:
    found = answer(listed(tmp_path, fails=0.2))
    assert found.expected_s == pytest.approx(15.2, abs=0.2)
    assert any("failed attempts are tasks of their own" in text for text in found.warnings)


@pytest.mark.usefixtures("quick_task_times")
def test_executions_in_which_an_agent_does_two_tasks_at_once_are_left_out(tmp_path: Path) -> None:
    found = answer(listed(tmp_path, fails=0.0, doubled=3))
    assert (found.executions, found.expected_s) == (9, pytest.approx(15.2, abs=0.2))
    assert any("3 logged executions in which an agent does two tasks at once" in text for text in found.warnings)


@pytest.mark.usefixtures("quick_task_times")
def test_an_outcome_of_which_most_tasks_would_have_failed_is_not_used(tmp_path: Path) -> None:
    dataset = listed(tmp_path, fails=0.0)
    table = pl.read_csv(tmp_path / "t.csv").with_columns(outcome=1 - pl.col("outcome"))
    table.write_csv(tmp_path / "u.csv")
    report = ingest([tmp_path / "u.csv"], tmp_path / "other")
    assert any("60 of 60 tasks failed: too many for failures" in text for _, text in report.said)
    found = answer(Dataset.open(tmp_path / "other"))
    assert found.expected_s == pytest.approx(answer(dataset).expected_s)
