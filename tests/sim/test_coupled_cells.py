"""Cells where robot and operator wait: the conditions hold, the waits add up, nobody waits where nothing is coupled."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit_sim import (
    COUPLED,
    SimulationError,
    SimulationOptions,
    fresh_cycles,
    orders_beside,
    random_orders,
    simulate,
)
from cyclekit_sim.coupled import coupled_work
from cyclekit_sim.coupled_list import listed_conditions, task_plan
from cyclekit_sim.coupled_run import make_cell
from cyclekit_sim.program import DWELL
from cyclekit_sim.task_lists import AGENTS, EPOCH_S, MEAN_S, ListOptions, simulate_task_lists

if TYPE_CHECKING:
    from pathlib import Path

EXECUTIONS = 2


@pytest.fixture(scope="module", params=COUPLED)
def logs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(request.param, tmp_path_factory.mktemp("logs") / "logs", executions=EXECUTIONS, seed=4)


def tasks(folder: Path) -> pl.DataFrame:
    return pl.read_parquet(folder / "truth" / "tasks.parquet")


def test_duration_is_motion_and_loss_and_work_and_wait_of_each_task(logs: Path) -> None:
    table = tasks(logs)
    parts = pl.sum_horizontal("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
    assert (table["end_s"] - table["start_s"] - table.select(parts).to_series()).abs().max() < 1e-3
    waits = table["wait_s"] > 1e-5
    assert waits.any()
    assert (waits == table["wait_ended_by"].is_not_null()).all()


def test_an_execution_ends_when_both_are_back(logs: Path) -> None:
    ends = tasks(logs).group_by("execution", maintain_order=True).agg(pl.col("end_s").max())
    executions = pl.read_parquet(logs / "truth" / "executions.parquet")
    assert (ends["end_s"] - executions["end_s"]).abs().max() < 1e-6
    assert executions["operator_sequence"].str.starts_with("rest,").all()


def test_nobody_waits_where_nothing_is_coupled() -> None:
    for scene in COUPLED:
        (order,) = random_orders(scene, 1, 1)
        free = fresh_cycles(scene, order, cycles=4, seed=1, options=SimulationOptions(coupling=0.0))
        assert max(free.robot_waits_s.max(), free.operator_waits_s.max()) < 1e-9


@pytest.mark.slow
def test_same_seed_same_bytes_and_an_execution_is_the_same_however_many(logs: Path, tmp_path: Path) -> None:
    scene = json.loads((logs / "truth" / "truth.json").read_text())["scene"]
    again = simulate(scene, tmp_path / "again", executions=EXECUTIONS, seed=4)
    for file in sorted(file for file in logs.rglob("*") if file.is_file()):
        there = again / file.relative_to(logs)
        assert hashlib.sha256(there.read_bytes()).digest() == hashlib.sha256(file.read_bytes()).digest(), file.name
    fewer = simulate(scene, tmp_path / "fewer", executions=1, seed=4, options=SimulationOptions(signals=False))
    assert tasks(fewer).equals(tasks(logs).filter(pl.col("execution") == 0))
    assert not (fewer / "session_000" / "events.csv").exists()
    assert "digital_input" not in (fewer / "session_000" / "robot.csv").read_text()[:2000]
    assert "events" not in (fewer / "cell.toml").read_text()


def test_each_signal_is_logged_when_it_comes(logs: Path) -> None:
    truth = json.loads((logs / "truth" / "truth.json").read_text())
    signals = {each["signal"] for each in truth["conditions"] if each["signal"]}
    assert signals == set(COUPLED[truth["scene"]].signals.values())
    folder = logs / "session_000"
    if not signals:  # a machine without any
        assert not (folder / "events.csv").exists()
        return
    rises = 0
    visits = 3 * (2 if truth["scene"] == "shared-zone" else 1)
    for signal in signals:
        if "digital-input" in signal:
            robot = pl.read_csv(folder / "robot.csv", separator=" ")
            bit = robot["actual_digital_input_bits"] // 2 ** int(signal[-1]) % 2
            rises += int((bit.diff() == 1).sum())
        else:
            events = pl.read_csv(folder / "events.csv")
            rises += events.filter(pl.col("signal") == signal, pl.col("value") == 1).height
    assert rises == visits * EXECUTIONS


@pytest.mark.parametrize(("drawn", "run"), [(20, 5), pytest.param(60, 20, marks=pytest.mark.slow)])
def test_of_four_fixtures_any_are_used_in_an_order_without_deadlock(drawn: int, run: int) -> None:
    orders = random_orders("four-fixtures", 5, drawn)
    used = [[place for place in order["robot"] if place.startswith("fixture")] for order in orders]
    mounted = [[place for place in order["operator"] if place.startswith("fixture")] for order in orders]
    assert {len(some) for some in used} == {3}
    assert {place for some in used for place in some} == {f"fixture_{number}" for number in (1, 2, 3, 4)}
    assert [sorted(some) for some in used] == [sorted(some) for some in mounted]
    assert used != mounted
    for order in orders[:run]:
        assert fresh_cycles("four-fixtures", order, cycles=1, seed=1).durations_s.max() < 200.0


def test_orders_of_an_operator_beside_one_of_the_robot_do_its_joint_tasks_and_end() -> None:
    for scene in COUPLED:
        (order,) = random_orders(scene, 8, 1)
        beside = orders_beside(scene, order["robot"], 2, 12)
        assert len(set(beside)) > 6
        assert {tuple(sorted(each)) for each in beside} == {tuple(sorted(order["operator"]))}
        assert fresh_cycles(scene, order, cycles=12, seed=1, operators=beside).durations_s.max() < 200.0


@pytest.mark.slow
def test_a_gate_opens_a_lag_after_what_it_needs_and_not_before() -> None:
    for scene in COUPLED:
        work = coupled_work(scene, 6, SimulationOptions(), 4)
        waited = 0
        for trace in work.run(range(4)):
            done = trace.done
            for wait in (*done.waits("robot"), *done.waits("operator")):
                opening = wait.opening
                assert opening.gate is not None
                if opening.until >= 0:  # a zone
                    continue
                event_s = -np.inf if opening.agent is None else done.ends_s[opening.agent][opening.needed]
                shortest_s, longest_s = opening.gate.need.lag_s
                assert shortest_s <= opening.lag_s <= longest_s
                assert wait.end_s == pytest.approx(max(wait.begin_s, event_s + opening.lag_s))
                waited += wait.end_s > wait.begin_s
        assert waited >= 3 or scene == "shared-zone"


def test_in_a_shared_zone_is_one_at_a_time_and_who_asks_first_goes_first() -> None:
    """Both wait; nobody enters before the other has left, nor waits for longer than that and the lag."""
    waited = {"robot": 0, "operator": 0}
    for trace in coupled_work("shared-zone", 6, SimulationOptions(), 8).run(range(8)):
        done = trace.done
        taken = {agent: spans for agent, _, spans in done.zones()}
        every = sorted(span for spans in taken.values() for span in spans)
        assert len(every) == 6
        assert all(left_s < next_s for (_, left_s), (next_s, _) in pairwise(every))
        for agent, other in (("robot", "operator"), ("operator", "robot")):
            for wait, (enters_s, _) in zip(done.waits(agent), taken[agent], strict=True):
                before = [(on_s, off_s) for on_s, off_s in taken[other] if on_s < enters_s]
                last_s = before[-1][1] if before else -np.inf
                assert enters_s == pytest.approx(max(wait.begin_s, last_s + wait.opening.lag_s))
                for other_wait in done.waits(other):  # whoever went before had asked before
                    if wait.begin_s < other_wait.end_s < wait.end_s:
                        assert other_wait.begin_s <= wait.begin_s
                waited[agent] += wait.end_s > wait.begin_s
    assert min(waited.values()) >= 3


@pytest.mark.parametrize("signals", [True, False])
def test_the_bit_of_a_zone_is_on_while_somebody_has_taken_it_or_is_not_logged(signals: bool, tmp_path: Path) -> None:
    options = SimulationOptions(signals=signals)
    logs = simulate("shared-zone", tmp_path / "logs", executions=1, seed=4, options=options)
    robot = pl.read_csv(logs / "session_000" / "robot.csv", separator=" ")
    assert ("actual_digital_input_bits" in robot.columns) is signals
    if signals:
        (trace,) = coupled_work("shared-zone", 4, options, 1).run([0])
        taken_s = sum(off_s - on_s for _, _, spans in trace.done.zones() for on_s, off_s in spans)
        bit = robot["actual_digital_input_bits"] // 2**4 % 2
        assert bit.sum() * options.cycle_s == pytest.approx(taken_s, abs=0.1)


def test_a_robot_of_three_products_picks_again_looks_for_the_part_changes_tools_and_jams() -> None:
    cell, runs = COUPLED["mixed-products"], 90
    work = coupled_work("mixed-products", 6, SimulationOptions(), runs)
    scripts = [make_cell(cell, order, work.table, 6, n, 1.0, 0, 1.0).scripts["robot"]
               for n, order in enumerate(work.executions)]  # fmt: skip
    visits = [pair for script in scripts for pair in pairwise(script.execution.places)]
    picks = [pair for pair in visits if pair[1] in cell.repeats]
    assert {goal for _, goal in picks} == {"feeder_a", "feeder_b", "feeder_c"}
    again = sum(start == goal for start, goal in picks)
    assert again == pytest.approx(0.12 * len(picks), abs=20)
    assert sum(goal == "tools" for _, goal in visits) == 3 * runs / 5
    stands = [column[1] for script in scripts for column in script.columns if column[0] == DWELL]
    late = [length_s for length_s in stands if length_s not in cell.robot_s.values()]
    assert len(late) >= len(picks)
    jams = [length_s for length_s in late if length_s > 2.0]
    assert 1 <= len(jams) < 16
    assert 0.3 < min(late) < max(late) < 62.0
    assert {script.execution.places.count("fixture") for script in scripts} == {3}


def test_a_planner_lets_no_task_start_before_its_time(tmp_path: Path) -> None:
    planned = ListOptions(coupled=False, spread=0.25, planned=0.9)
    (order,) = simulate_task_lists(tmp_path, executions=1, options=planned)
    rows = pl.read_csv(tmp_path / "tasks.csv")
    for kind, agent in AGENTS.items():
        starts = rows.filter(pl.col("agent") == agent)["t_start"].to_numpy() - EPOCH_S
        due = 0.9 * np.cumsum([0.0, *(MEAN_S[task] for task in order[kind][:-1])])
        assert (starts >= due).all()
        assert (starts < due + 0.5).any()


@pytest.mark.slow
def test_fresh_executions_take_as_long_as_logged_ones() -> None:
    work = coupled_work("shared-fixture", 6, SimulationOptions(), 25)
    order = work.executions[0]
    logged = [trace.done for trace in replace(work, executions=(order,) * 25).run(range(25))]
    fresh = fresh_cycles("shared-fixture", order, cycles=50, seed=2)
    took_s = np.array([done.duration_s for done in logged])
    assert abs(took_s.mean() - fresh.durations_s.mean()) < 4 * took_s.std() / 5
    waits_s = np.array([done.waited_s("operator") for done in logged])
    assert abs(waits_s.mean() - fresh.operator_waits_s.mean()) < 4 * waits_s.std() / 5


def test_the_operators_pace_changes_his_walks_and_work_and_is_that_after_the_logged_executions() -> None:
    (order,) = random_orders("handover", 1, 1)
    quick = SimulationOptions(pace_drift=0.5, pace_executions=2.0)
    begins, ends, half, usual = (
        fresh_cycles("handover", order, cycles=2, seed=3, options=options, after=after).durations_s
        for options, after in (
            (quick, 0),
            (quick, 100),
            (SimulationOptions(paces=(0.5,)), 0),
            (SimulationOptions(), 0),
        )
    )
    assert begins == pytest.approx(usual)
    assert ends == pytest.approx(half)
    assert (ends < usual).all()
    in_turn = SimulationOptions(pace_drift=0.5, pace_executions=2.0, paces=(1.0, 2.0))
    assert [in_turn.pace(0, session) for session in (0, 1, 2)] == [1.0, 2.0, 1.0]
    assert in_turn.pace(2, 1) == pytest.approx(2.0 * (1.0 - 0.5 * (1.0 - np.exp(-1.0))))
    with pytest.raises(SimulationError, match="pace_drift"):
        SimulationOptions(pace_drift=1.0)


def test_the_order_of_both_must_be_one_of_the_scene() -> None:
    with pytest.raises(SimulationError, match="no place oven"):
        fresh_cycles("shared-fixture", {"robot": ("home", "oven", "home"), "operator": ()}, cycles=1, seed=0)
    order = {"robot": ("home", "tray", "home"), "operator": ("bench", "fixture", "rest")}
    with pytest.raises(SimulationError, match="from rest to rest"):
        fresh_cycles("shared-fixture", order, cycles=1, seed=0)


@pytest.mark.slow
def test_the_order_is_worth_more_than_chance() -> None:
    joint, alone = ("feeder", "fixture"), ("tray", "rack_1")
    operator = ("rest", *("bench", "fixture") * 3, *("shelf", "scan") * 2, "rest")
    means = [
        fresh_cycles("shared-fixture", order, cycles=20, seed=3).durations_s.mean()
        for order in (
            {"robot": ("home", *joint * 3, *alone * 3, "home"), "operator": operator},
            {"robot": ("home", *alone * 3, *joint * 3, "home"), "operator": operator},
        )
    ]
    assert means[1] - means[0] > 5


@pytest.mark.parametrize("scene", ["shared-fixture", "handover"])
def test_in_a_task_list_no_task_starts_before_what_it_waits_for(scene: str, tmp_path: Path) -> None:
    logs = simulate(scene, tmp_path / "logs", executions=2, seed=4, options=SimulationOptions(task_list=True))
    assert not list(logs.rglob("robot.csv"))
    rows = pl.read_csv(logs / "tasks.csv")
    order = coupled_work(scene, 4, SimulationOptions(), 1).executions[0]
    first = rows.filter(pl.col("run") == 0)
    for agent in ("arm", "worker"):
        planned = [task for who, task in task_plan(COUPLED[scene], order) if who == agent]
        assert first.filter(pl.col("agent") == agent)["task"].to_list() == planned
    for condition in json.loads((logs / "truth" / "truth.json").read_text())["conditions"]:
        starts = first.filter(pl.col("task") == condition["task"])["t_start"].to_list()
        ends = first.filter(pl.col("task") == condition["needs"])["t_end"].to_list()
        for start, end in zip(starts[condition["back"] :], ends, strict=False):
            assert start > end + condition["lag_s"][0] - 2e-3


def test_the_conditions_of_a_task_list_are_those_of_all_its_places() -> None:
    """In an order of four-fixtures three of the four fixtures are used at most."""
    found = [(each["task"], each["needs"], each["back"]) for each in listed_conditions(COUPLED["four-fixtures"])]
    fixtures = [f"fixture_{number}" for number in (1, 2, 3, 4)]
    expected = {(f"mount {name}", f"bring {name}", 0) for name in fixtures}
    assert set(found) == expected | {(f"bring {name}", f"mount {name}", 1) for name in fixtures}
    assert len(found) == 8
