"""Task lists in which each execution of a recipe has the same name."""

from __future__ import annotations

from pathlib import Path

import pytest

from cyclekit.adapter import ReadOptions, Recording
from cyclekit_adapters.formats.task_list import ADAPTER

T0 = 1_700_000_000.0
PLAN = [
    ("arm", "pick", 0.0, 4.0),
    ("human", "mount", 2.0, 5.0),
    ("arm", "place", 4.0, 3.0),
    ("human", "pack", 8.0, 2.0),
]
SWAPPED = [PLAN[1], PLAN[2], PLAN[3], PLAN[0]]


def _read(path: Path, runs: list[tuple[str, float, list[tuple[str, str, float, float]]]]) -> Recording:
    """Write executions (name, start, plan) and read them; each task begins 0.1 s after its planned start."""
    lines = ["recipe,agent,name,t_start,t_end,t_start_planned"]
    for name, at, plan in runs:
        for number, (agent, task, planned, took) in enumerate(plan):
            start = T0 + at + (planned if plan is PLAN else 5.0 * number) + 0.1
            lines.append(f"{name},{agent},{task},{start},{start + took},{planned}")
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return ADAPTER.read(path, ReadOptions())


@pytest.mark.parametrize("between", [True, False])
def test_executions_of_the_same_name_are_numbered(tmp_path: Path, between: bool) -> None:
    other = [("b", 50.0, PLAN)] if between else []
    log = _read(tmp_path / "a.csv", [("a", 0.0, PLAN), *other, ("a", 100.0, PLAN), ("a", 200.0, PLAN)])
    assert log.task_list["execution"].unique(maintain_order=True).to_list() == [
        "a", *(name for name, *_ in other), "a #2", "a #3"
    ]  # fmt: skip
    late = log.task_list["t_s"] - log.task_list["planned_start_s"]
    assert late.to_list() == pytest.approx([0.0] * log.task_list.height, abs=1e-6)
    assert any("'a' (3 executions)" in text for text in log.warnings)


def test_a_task_done_before_its_turn_makes_no_second_execution(tmp_path: Path) -> None:
    log = _read(tmp_path / "a.csv", [("a", 0.0, SWAPPED), ("b", 100.0, PLAN)])
    assert set(log.task_list["execution"]) == {"a", "b"}
    assert log.warnings == ()


OTHERS = [
    ("human", "pick", 0.0, 4.0),
    ("arm", "mount", 2.0, 5.0),
    ("human", "place", 4.0, 3.0),
    ("arm", "pack", 8.0, 2.0),
]


def test_agents_may_change_their_tasks_from_one_execution_of_a_name_to_the_next(tmp_path: Path) -> None:
    runs = [("a", 0.0, PLAN), ("a", 50.0, OTHERS), ("a", 100.0, PLAN), ("a", 150.0, OTHERS)]
    log = _read(tmp_path / "a.csv", runs)
    assert log.task_list["execution"].unique(maintain_order=True).to_list() == ["a", "a #2", "a #3", "a #4"]
    assert log.task_list.group_by("execution").len()["len"].to_list() == [4, 4, 4, 4]
    assert any("'a' (4 executions)" in text for text in log.warnings)


def test_a_plan_that_begins_again_while_a_task_runs_makes_no_second_execution(tmp_path: Path) -> None:
    log = _read(tmp_path / "a.csv", [("a", 0.0, PLAN), ("a", 7.0, OTHERS)])
    assert set(log.task_list["execution"]) == {"a"}


def test_without_names_the_plan_tells_executions_apart(tmp_path: Path) -> None:
    _read(tmp_path / "a.csv", [("a", 0.0, PLAN), ("a", 50.0, OTHERS), ("a", 100.0, PLAN)])
    lines = [line.split(",", 1)[1] for line in (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()]
    (tmp_path / "b.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    log = ADAPTER.read(tmp_path / "b.csv", ReadOptions())
    assert log.task_list["execution"].n_unique() == 3
    assert not any("no column gives" in text for text in log.warnings)
    (tmp_path / "c.csv").write_text("\n".join([*lines[:5], ""]), encoding="utf-8")
    log = ADAPTER.read(tmp_path / "c.csv", ReadOptions())
    assert log.task_list["execution"].null_count() == 4
    assert any("no column gives" in text for text in log.warnings)


SHORT = PLAN[:2]


def test_executions_of_the_same_name_and_other_tasks_are_numbered_if_others_ran(tmp_path: Path) -> None:
    runs = [("a", 0.0, PLAN), ("b", 50.0, PLAN), ("a", 100.0, SHORT), ("b", 150.0, SHORT), ("c", 200.0, PLAN)]
    log = _read(tmp_path / "a.csv", runs)
    assert log.task_list["execution"].unique(maintain_order=True).to_list() == ["a", "b", "a #2", "b #2", "c"]
    assert any("with other tasks" in text for text in log.warnings)


def test_an_execution_that_goes_on_after_others_ran_stays_one_and_is_told(tmp_path: Path) -> None:
    log = _read(tmp_path / "a.csv", [("a", 0.0, PLAN[:2]), ("b", 50.0, PLAN), ("a", 100.0, PLAN[2:])])
    assert set(log.task_list["execution"]) == {"a", "b"}
    assert any("rest while others run: 1, such as 'a'" in text for text in log.warnings)


def _without_plan(path: Path, runs: list[tuple[str, float, int]]) -> Recording:
    lines = ["recipe,agent,name,t_start,t_end"]
    for name, at, count in runs:
        for agent, task, start, took in PLAN[:count]:
            lines.append(f"{name},{agent},{task},{T0 + at + start},{T0 + at + start + took}")
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return ADAPTER.read(path, ReadOptions())


def test_without_a_plan_others_between_them_tell_executions_apart(tmp_path: Path) -> None:
    runs = [("a", 0.0, 4), ("b", 30.0, 4), ("a", 60.0, 4), ("a", 88.0, 4), ("a", 120.0, 2), ("b", 150.0, 4)]
    log = _without_plan(tmp_path / "a.csv", runs)
    assert log.task_list["execution"].unique(maintain_order=True).to_list() == [
        "a",
        "b",
        "a #2",
        "a #3",
        "a #4",
        "b #2",
    ]
    assert any("'a' (4 executions)" in text for text in log.warnings)


def test_other_tasks_in_a_rest_do_not_part_an_execution(tmp_path: Path) -> None:
    log = _without_plan(tmp_path / "a.csv", [("a", 0.0, 1), ("b", 30.0, 4), ("a", 60.0, 4)])
    assert set(log.task_list["execution"]) == {"a", "b"}
    (warning,) = log.warnings
    assert "rest while others run: 1, such as 'a'" in warning
