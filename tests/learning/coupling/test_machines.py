"""A machine that the robot has loaded is found by the time since it left; other standstills are none."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.config import Wait
from cyclekit.dataset.cards.coupling import Agent, ConditionCard, GateCard, SourceCard
from cyclekit.learning.coupling import learn
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

PROCESS_S, LOADS_S = (12.6, 13.4), 2.0


def _tended(rng: np.random.Generator, name: str, waits: str = "machine") -> ExecutionVisits:
    """Return an execution whose robot loads a machine four times, with up to three other tasks in between.

    `waits`: for the `machine`; as long as `others` do, whatever the time away; or at every second visit (`unloads`).
    """
    at, robot, done_s = 0.0, [PlaceVisit("home", 0.0, 0.0)], -np.inf
    for visit in range(4):
        for _ in range(rng.integers(4)):
            robot.append(PlaceVisit(f"rack {rng.integers(3)}", at + 2.0, at + 2.6))
            at = robot[-1].left_s + rng.uniform(1.5, 2.5)
        at += 4.0
        ready = {"machine": max(done_s, at), "others": at + max(rng.normal(0.0, 4.0), 0.0)}
        ready["unloads"] = ready["machine"] if visit % 2 else at
        robot.append(PlaceVisit("machine", at, ready[waits] + LOADS_S))
        at = robot[-1].left_s
        done_s = at + rng.uniform(*PROCESS_S)
    robot.append(PlaceVisit("home", at + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": []}
    return ExecutionVisits(name, visits, events_of(visits))


def _learned(seed: int, waits: str, executions: int, *given: Wait) -> list[tuple[GateCard, ConditionCard]]:
    rng = np.random.default_rng(seed)
    card = learn_courses([_tended(rng, str(number), waits) for number in range(executions)], given)
    return [(gate, one) for gate in card.gates for one in gate.conditions]


@pytest.mark.parametrize("executions", [15, 60])
def test_the_robot_waits_for_the_machine_that_it_has_loaded(executions: int) -> None:
    ((gate, one),) = _learned(1, "machine", executions)
    assert (gate.agent, gate.at, gate.place) == ("robot", "leave", "machine")
    assert (one.agent, one.place, one.event, one.back) == ("robot", "machine", "leaves", 1)
    assert np.median(one.lag_s) == pytest.approx(np.mean(PROCESS_S) + LOADS_S, abs=0.1)
    assert PROCESS_S[0] + LOADS_S - 0.05 < one.lag_s[0] < one.lag_s[-1] < PROCESS_S[1] + LOADS_S + 0.05
    assert np.mean(gate.own_s) == pytest.approx(LOADS_S, abs=0.01)
    assert one.decided >= 5


def test_waits_that_a_machine_explains_are_not_for_parts_that_would_explain_them_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parts = SourceCard(signal="part at machine", gap_s=(15.0,), first_s=(0.0,), taken_by="machine", inferred=True)
    monkeypatch.setattr(learn, "find_unseen_parts", lambda _, place: parts if place == "machine" else None)
    ((_, one),) = _learned(1, "machine", 15)
    assert (one.agent, one.place, one.event, one.back) == ("robot", "machine", "leaves", 1)


def test_a_machine_that_is_loaded_and_unloaded_in_turn_is_waited_for_at_every_second_visit() -> None:
    ((gate, one),) = _learned(2, "unloads", 60)
    assert (gate.place, one.place, one.event) == ("machine", "machine", "leaves")
    assert [one.turns.event(passage, one.back) for passage in range(4)] == [None, 0, None, 2]


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4))])
def test_standstills_that_do_not_depend_on_the_time_away_are_no_machine(seed: int) -> None:
    assert _learned(seed, "others", 60) == []


def test_the_cell_file_names_a_machine_by_the_departure_from_it() -> None:
    told = Wait("robot", leaving="machine", until="robot leaves machine")
    ((gate, one),) = _learned(3, "machine", 6, told)
    assert (gate.told, one.back) == (True, 1)
