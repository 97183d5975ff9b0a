"""Repetitions and tool changes in the logs that an asked order lacks: said, and covered by the intervals."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from known_cells import TrueStaircase
from report_pages import estimate as made

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards.task_model import InterludeCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.interludes import with_interludes
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.learn import learn_task_times
from cyclekit_sim import simulate

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.estimate.finding import Finding

REPEATS = [InterludeCard("robot", "left", ("left",), visits=100, times=10, took_s=3.0)]
LEFT_S = 3.0 * (10 + 1.96 * 10**0.5) / 100
"""What the repetitions add at most: their number is one of chance."""
CHANGES = [InterludeCard("robot", "tools", ("left", "right"), visits=50, times=10, took_s=6.0)]


def test_the_interval_covers_the_order_with_and_without_repetitions() -> None:
    entry = made()
    found = with_interludes(entry, REPEATS, {"robot": ["left", "conveyor"]})
    assert found.expected_s == entry.expected_s
    assert found.expected_low_s == entry.expected_low_s
    assert found.expected_high_s == pytest.approx(entry.expected_high_s + LEFT_S, rel=1e-4)
    assert found.quantiles_s[0.95] == pytest.approx(entry.quantiles_s[0.95] + LEFT_S, rel=1e-4)
    assert found.findings[0].text == "the logs repeat `left` 10 times in 100 visits; this order has none: +1.0 %"
    assert not found.findings[0].blocks  # the interval covers it


@pytest.mark.parametrize("order", [["left", "left", "conveyor"], ["right", "conveyor"]])
def test_an_order_with_its_own_repetition_or_without_the_place_is_as_it_was(order: list[str]) -> None:
    entry = made()
    assert with_interludes(entry, REPEATS, {"robot": order}) is entry


@pytest.mark.parametrize(
    ("order", "more_s"),
    [(["left", "right", "left"], 3 * 6.0 * (10 + 1.96 * 10**0.5) / 50), (["tools", "left"], 0.0), (["b"], 0.0)],
)
def test_an_order_without_tool_changes_is_covered_with_those_before_its_tasks(order: list[str], more_s: float) -> None:
    entry = made()
    found = with_interludes(entry, CHANGES, {"robot": order})
    assert found.expected_high_s == pytest.approx(entry.expected_high_s + more_s, rel=1e-4)
    said = "the logs have `tools` 10 times before 50 tasks such as `left`; this order has none: +12.0 %"
    assert [one.text for one in found.findings if one.code == "interludes"] == [said] * (more_s > 0.0)


def test_repeated_picks_of_the_logs_are_told_of_an_order_without_them(tmp_path: Path) -> None:
    logs = simulate("repeats", tmp_path / "logs", executions=8, seed=3)
    ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    routes = [one.places for one in dataset.card.executions]
    again = sum(before == after for route in routes for before, after in pairwise(route))
    plain = next(route for route in routes if ("feeder", "feeder") not in pairwise(route))
    (found,) = estimate(TrueStaircase(), dataset, [TaskSequence("plain", plain)], validate=False, extrapolate=True)
    (told,) = (one for one in found.findings if one.code == "interludes")
    assert told.text.startswith(f"the logs repeat `feeder` {again} times in 24 visits; this order has none: +")


def told_of(folder: Path, runs: list[str], asked: str) -> list[Finding]:
    """Return the findings on repetitions of a plan; each task of the logged runs and of the plan is a letter."""
    rows = ["run,agent,task,t_start,t_end"]
    for number, tasks in enumerate(runs):
        for at, name in enumerate(tasks):
            begin_s = 1.7e9 + 100.0 * number + 2.0 * at
            rows.append(f"{number},arm,{name},{begin_s},{begin_s + 1.9}")
    (folder / "tasks.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    ingest([folder / "tasks.csv"], folder / "dataset")
    model = learn_task_times(Dataset.open(folder / "dataset"))
    plan = TaskSequence.of_plan("once", [PlannedTask("arm", name) for name in asked])
    (found,) = estimate_plans(model, [plan], refused=lambda *_: None)
    return [one for one in found.findings if one.code == "interludes"]


@pytest.mark.usefixtures("quick_task_times")
@pytest.mark.parametrize(
    ("runs", "asked"),
    [
        (["apb", "cppd"] * 10, "apb"),  # two products: one needs two of p
        (["apb", "cppd", "apb", "apb"] * 5, "cpd"),
        (["papq", "ppaq"] * 10, "paq"),  # two in a row in one order, not in the other
    ],
)
def test_what_products_or_orders_need_in_a_row_is_no_repetition(tmp_path: Path, runs: list[str], asked: str) -> None:
    assert told_of(tmp_path, runs, asked) == []


@pytest.mark.usefixtures("quick_task_times")
def test_repetitions_of_two_products_are_told(tmp_path: Path) -> None:
    (told,) = told_of(tmp_path, ["apb", "cpd", "appb", "cpd", "cppd"] * 4, "apb")
    assert told.text.startswith("the logs repeat `p` 8 times in 20 visits; this order has none: +")


@pytest.mark.usefixtures("quick_task_times")
def test_repeated_tasks_of_lists_are_told_of_a_plan_without_them(tmp_path: Path) -> None:
    (told,) = told_of(tmp_path, ["ppq" if number % 5 == 0 else "pq" for number in range(20)], "pq")
    assert told.text.startswith("the logs repeat `p` 4 times in 20 visits; this order has none: +")


@pytest.mark.usefixtures("quick_task_times")
def test_tool_changes_of_lists_are_told_of_a_plan_without_them(tmp_path: Path) -> None:
    (told,) = told_of(tmp_path, ["tpq" if number % 5 == 0 else "pq" for number in range(20)], "pq")
    assert told.text.startswith("the logs have `t` 4 times before 20 tasks such as `p`; this order has none: +")


def test_tool_changes_of_the_robot_are_told_and_covered(tmp_path: Path) -> None:
    logs = simulate("mixed-products", tmp_path / "logs", executions=12, seed=3)
    ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    plain = next(one.places for one in dataset.card.executions if one.whole and "tools" not in one.places)
    (found,) = estimate(TrueStaircase(), dataset, [TaskSequence("plain", plain)], validate=False, extrapolate=True)
    (told,) = (one for one in found.findings if "`tools`" in one.text)
    assert told.level == "amber"
    share = float(told.text.rpartition("+")[2].removesuffix(" %")) / 100.0
    assert 0.03 < share < 0.12
    assert found.expected_high_s > (1.0 + share) * found.expected_s
