"""Logged executions of robot and operator as plans: their cycle, their waits, and what ended these."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import polars as pl
import pytest

from cyclekit import schema
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
from cyclekit.estimate.baseline import baseline_of
from cyclekit.estimate.logged_both import logged_of_both, logged_plan
from cyclekit.estimate.statistics.same_work import work_of

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset

LEAVES = ConditionCard(agent="operator", place="bench", event="leaves", lag_s=(0.2,))
SET = ConditionCard(agent="signal", place="digital-input 3", event="set", lag_s=(0.1,))
CARD = CouplingCard(gates=(
    GateCard(agent="robot", at="approach", place="fixture", conditions=(LEAVES,)),
    GateCard(agent="robot", at="leave", place="conveyor", conditions=(SET,)),
))  # fmt: skip


def task(agent: str, index: int, name: str, times_s: tuple[float | None, ...], **told: Any) -> dict[str, Any]:
    start_s, arrival_s, end_s = times_s
    goal = name.rpartition("->")[2]
    return {"agent": agent, "index": index, "task": name, "goal_place": goal, "start_s": start_s,
            "arrival_s": arrival_s, "end_s": end_s, "dwell_s": 0.0, "wait_s": 0.0, **told}  # fmt: skip


def logged(more_s: tuple[float, ...] = (0.0, 1.0), *, turned: bool = False, begins_at: bool = True) -> Dataset:
    """Return a stand-in: the robot waits short of the fixture for the operator, and at the conveyor for a part."""
    rows, executions = [], []
    for number, more in enumerate(more_s):
        name, at = str(number), 100.0 * number
        executions.append({"execution": name, "start_s": at, "end_s": at + 20.0 + more})
        some = [
            task("robot", 0, "home->conveyor", (0.0, 2.0, 5.0 + more), dwell_s=1.0, wait_s=2.0 + more,
                 waited_for="digital-input 3 set"),
            task("robot", 1, "conveyor->fixture", (5.0 + more, 15.0 + more, 16.0 + more), dwell_s=1.0, wait_s=4.0,
                 reached_s=8.0 + more, went_on_s=12.0 + more, waited_for="operator leaves bench"),
            task("robot", 2, "fixture->home", (16.0 + more, 20.0 + more, 20.0 + more)),
            task("operator", 0, "rest", (0.0, None, 1.0)),
            task("operator", 1, "bench", (1.0, 3.0, 11.8 + more), dwell_s=8.8 + more),
            task("operator", 2, "shelf" if turned and number else "desk", (11.8 + more, 13.0 + more, 16.0 + more),
                 dwell_s=3.0),
            task("operator", 3, "bench", (16.0 + more, 18.0 + more, None)),
        ]  # fmt: skip
        some = some if begins_at else [each for each in some if each["task"] != "rest"]
        rows += [{"execution": name, **each} | {k: each[k] + at for k in each if k in TIMES and each[k] is not None}
                 for each in some]  # fmt: skip
    tasks = schema.conform(pl.DataFrame(rows, infer_schema_length=None), schema.TASKS)
    frame = pl.DataFrame(executions).with_columns(complete=True, duration_s=pl.col("end_s") - pl.col("start_s"))
    entries = [SimpleNamespace(execution=one["execution"], places=("home", "conveyor", "fixture", "home"),
                               reference=False) for one in executions]  # fmt: skip
    card = SimpleNamespace(coupling=CARD, executions=entries)
    return cast(
        "Dataset",
        SimpleNamespace(
            every_task=lambda: tasks,
            tasks=lambda: tasks.filter(pl.col("agent") == "robot"),
            executions=frame,
            card=card,
        ),
    )


TIMES = ("start_s", "arrival_s", "end_s", "reached_s", "went_on_s")


def plan(operator: list[str]) -> TaskSequence:
    robot = [PlannedTask("robot", place) for place in ("conveyor", "fixture", "home")]
    return TaskSequence.of_plan("plan", [*robot, *(PlannedTask("operator", place) for place in operator)])


def test_the_cycle_of_both_ends_when_the_operator_has_done_his_last_work() -> None:
    """He arrives at 18 s and works for 9.3 s (the median there) while the robot is home after 20 s."""
    found = logged_of_both(logged())
    assert [one.duration_s for one in found.values()] == pytest.approx([18.0 + 9.3, 19.0 + 9.3])


@pytest.mark.parametrize("his", [["rest", "bench", "desk", "bench"], ["bench", "bench", "desk"]])
def test_todays_cycle_of_a_plan_is_that_of_the_executions_with_the_same_work_of_both(his: list[str]) -> None:
    today = baseline_of(logged(), work_of(plan(his).places), None)
    assert today is not None
    assert (today.executions, today.mean_s) == (2, pytest.approx(27.8))
    assert baseline_of(logged(), work_of(plan(["bench"]).places), None) is None
    moving = baseline_of(logged(begins_at=False), work_of(plan(["bench", *his[-3:]]).places), None)
    assert moving is not None
    assert moving.executions == 2  # he comes from the bench, where he ends
    robot = baseline_of(logged(), work_of(["home", "conveyor", "fixture", "home"]), None)
    assert robot is not None
    assert robot.mean_s == pytest.approx(20.5)


def test_the_waits_of_logged_tasks_are_before_the_next_task_or_short_of_the_place() -> None:
    found = logged_plan(logged(), ["0", "1"])
    robot = [(one.task, one.start_s, one.end_s, one.wait_s) for one in found if one.agent == "robot"]
    assert robot == [
        ("home->conveyor", 0.0, 3.0, 0.0),
        ("conveyor->fixture", 5.5, 8.5, 2.5),
        ("conveyor->fixture", 12.5, 16.5, 4.0),
        ("fixture->home", 16.5, 20.5, 0.0),
    ]
    ended = [one.ended_by for one in found if one.agent == "robot"]
    assert ended == [None, ("signal: digital-input 3", 1.0), ("operator: bench", 1.0), None]
    assert logged_plan(logged(turned=True), ["0", "1"]) == ()
