"""What to log next: every lacking task is in an order, often enough, and the interval says how many executions."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise, permutations
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import polars as pl
import pytest
from fabricated import fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st

from cyclekit import plan_recordings
from cyclekit.api.init import first_sequence
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.errors import ConfigError, CyclekitError
from cyclekit.estimate.what_to_log import ENOUGH, _half_width, _of_sequences, _one_tour, doubtful_places, what_to_log

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset

PLACES = st.lists(st.sampled_from("abcde"), min_size=2, max_size=6).filter(
    lambda p: all(x != y for x, y in pairwise(p))
)


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return fabricate_dataset(tmp_path_factory.mktemp("logged") / "dataset", executions=4, rounds=1)


def test_missing_and_rare_tasks_of_a_sequence_are_named_with_the_order_that_holds_them(logged: Dataset) -> None:
    plan = plan_recordings(logged, TaskSequence("new", ("conveyor", "left", "right")))
    assert plan.missing == ("left->right",)
    (order,) = plan.orders
    assert (order.name, order.places, order.executions) == ("new", ("conveyor", "left", "right"), ENOUGH)
    assert any("left->right" in line for line in plan.lines)
    assert plan.to_frame().height == 1


def test_a_plan_for_both_agents_asks_for_the_logged_tasks(logged: Dataset) -> None:
    tasks = [PlannedTask("robot", place) for place in ("left", "conveyor")]
    plan = plan_recordings(logged, TaskSequence.of_plan("both", [*tasks, PlannedTask("operator", "desk")]))
    assert plan.lines == plan_recordings(logged).lines
    assert plan.rare


def test_executions_of_different_work_say_nothing_of_the_spread() -> None:
    """Executions of one task of 10 s, or of two: only what each differs from its work by is uncertain."""
    took_s = [[10.1], [9.9], [10.2, 10.1], [9.8, 9.9]] * 4
    rows = [(str(n), f"task {k}", 0.0, s) for n, tasks in enumerate(took_s) for k, s in enumerate(tasks)]
    tasks = pl.DataFrame(rows, schema=["execution", "task", "start_s", "end_s"], orient="row")
    executions = tasks.group_by("execution").agg(duration_s=pl.col("end_s").sum(), complete=pl.lit(True))
    dataset = cast("Dataset", SimpleNamespace(executions=executions, whole_tasks=lambda: tasks))
    count, half = _half_width(dataset)
    assert count == 16
    assert half == pytest.approx(1.96 * 0.235 / 4.0 / 15.0, rel=0.1)  # by durations alone it were 0.17


def test_half_the_interval_takes_four_times_the_executions(logged: Dataset) -> None:
    counts = {}
    for within in (0.02, 0.01, 0.005):
        plan = plan_recordings(logged, within=within)
        counts[within] = plan.executions + plan.more
    assert counts[0.01] == pytest.approx(4 * counts[0.02], abs=4)
    assert counts[0.005] == pytest.approx(4 * counts[0.01], abs=4)
    assert plan_recordings(logged, within=0.9).more < ENOUGH


@given(
    st.lists(PLACES, min_size=1, max_size=4),
    st.dictionaries(st.tuples(*[st.sampled_from("abcde")] * 2), st.integers(0, 9)),
)
def test_the_sequences_bring_every_task_to_enough(orders: list[list[str]], logged: dict[tuple[str, str], int]) -> None:
    asked = [TaskSequence(str(at), tuple(places)) for at, places in enumerate(orders)]
    counts = {task: logged.get(tuple(task.split("->")), 0) for one in asked for task in one.tasks}
    lacking = {task: count for task, count in counts.items() if count < ENOUGH}
    done: Counter[str] = Counter(counts)
    for order in _of_sequences(asked, lacking):
        assert set(order.adds) <= set(lacking)
        for task, times in Counter(f"{a}->{b}" for a, b in pairwise(order.places)).items():
            done[task] += times * order.executions
    assert all(done[task] >= ENOUGH for task in lacking)


@given(st.lists(PLACES, min_size=1, max_size=5))
def test_a_tour_drives_logged_tasks_alone_and_holds_every_rare_one_it_can_reach(orders: list[list[str]]) -> None:
    executions = [SimpleNamespace(complete=True, whole=True, places=tuple(places)) for places in orders]
    counts = Counter(f"{a}->{b}" for places in orders for a, b in pairwise(places))
    lacking = {task: count for task, count in counts.items() if count < ENOUGH}
    for order in _one_tour(SimpleNamespace(card=SimpleNamespace(executions=executions)), counts, lacking):
        driven = {f"{a}->{b}" for a, b in pairwise(order.places)}
        assert driven <= set(counts)
        assert set(order.adds) == driven & set(lacking)
        assert order.executions >= 1


def mixed(*, inferred: bool = True) -> Dataset:
    """Return a stand-in of 60 executions: b has a rare task, the robot only waits at w, and stood at s four times."""
    orders = [("home", "w", "a", *(["s"] if n < 4 else []), *(["b"] if n % 2 else []), "home") for n in range(60)]
    orders[0] = ("home", "w", "a", "b", "a", "home")
    return stand_in(orders, inferred=inferred)


def stand_in(orders: list[tuple[str, ...]], *, inferred: bool = True) -> Dataset:
    """Return a stand-in of executions in these orders; the robot only waits at w."""
    rows = [
        {"task": f"{a}->{b}", "goal_place": b, "nominal_s": 1.0, "dwell_s": 0.0 if b == "w" else 1.0,
         "wait_s": 2.0 if b == "w" else 0.0, "execution": str(number), "start_s": 0.0, "end_s": 2.0}
        for number, places in enumerate(orders) for a, b in pairwise(places)
    ]  # fmt: skip
    places = {name: SimpleNamespace(inferred=inferred) for name in set().union(*orders)}
    executions = [SimpleNamespace(complete=True, whole=True, places=order) for order in orders]
    durations = pl.DataFrame({"execution": ["0", "1"], "complete": [True, True], "duration_s": [10.0, 10.0]})
    tasks = pl.DataFrame(rows)
    found = {"tasks": lambda: tasks, "whole_tasks": lambda: tasks, "require_positions": lambda: None,
             "executions": durations, "positions": ("robot",), "holds_task_lists_alone": False}  # fmt: skip
    return cast("Dataset", SimpleNamespace(**found, card=SimpleNamespace(executions=executions, places=places)))


def test_places_that_may_be_waits_are_not_asked_for_and_named() -> None:
    assert doubtful_places(mixed()) == {"w", "s"}
    plan = what_to_log(mixed())
    assert plan.rare == {"b->a": 1}
    (order,) = plan.orders
    assert order.adds == ("b->a",)
    assert "s" not in order.places
    assert plan.doubtful == ("s",)  # tasks of w were logged often
    assert plan.lines[-1].startswith("not asked for: tasks of s: the robot only waits there, or stood there in few")
    asked = what_to_log(mixed(), [TaskSequence("new", ("home", "s", "home"))])
    assert asked.missing == ("home->s",)  # never logged: without it the sequence has no answer
    named = what_to_log(mixed(inferred=False))
    assert {"a->s", "s->b"} < set(named.rare)
    assert named.doubtful == ()


def test_the_first_order_of_a_project_avoids_places_that_may_be_waits() -> None:
    usual = [("home", *order, "home") for order in permutations("abcd")] * 2
    stopped = [("home", "a", "s", "b", "home")] * 3
    assert first_sequence(stand_in(stopped + usual))[0].places == usual[0]
    assert first_sequence(stand_in(stopped + usual, inferred=False))[0].places == stopped[0]
    assert first_sequence(stand_in(stopped))[0].places == stopped[0]  # all of them stop there: then it is a place


def test_what_cannot_be_planned_is_refused(logged: Dataset, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="within = 2"):
        plan_recordings(logged, within=2.0)
    with pytest.raises(CyclekitError):
        plan_recordings(tmp_path / "none")
