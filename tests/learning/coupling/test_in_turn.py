"""Signals of several places: one operator who gives them in turn is told from machines that each give their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.cli.lists import coupling_table
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent

PLACES = ("fixture_1", "fixture_2", "fixture_3")
WAY_S, BROUGHT_S = 3.0, 2.0


def _course(rng: np.random.Generator, name: str, *, in_turn: bool) -> ExecutionVisits:
    """Return an execution in which the robot brings four parts; each place releases its part before the next one.

    One operator serves them in an order of his own, with 1 to 25 s of other work before each, and then takes 6 s; or
    each place is a machine that takes 5 to 25 s.
    """
    while True:
        brings = rng.choice(PLACES, 4).tolist()
        order = rng.permutation(4).tolist()
        if not in_turn or _goes(brings, order):
            break
    released: dict[int, float] = {}
    robot, now_s, served, free_s = [PlaceVisit("home", 0.0, 0.0)], 0.0, 0, 0.0
    other_s, lag_s = rng.uniform(1.0, 25.0, 4), rng.uniform(5.5, 6.5, 4)
    left: list[float] = []
    for part, place in enumerate(brings):
        at = now_s + WAY_S + rng.uniform(0.0, 8.0)
        before = [other for other in range(part) if brings[other] == place]
        went_on = max(at, released[before[-1]] + 0.15) if before else at
        left.append(went_on + BROUGHT_S)
        robot.append(PlaceVisit(place, went_on + 1.0, left[-1], at, went_on))
        now_s = left[-1]
        if not in_turn:
            released[part] = now_s + rng.uniform(5.0, 25.0)
        while in_turn and served < 4 and order[served] <= part:
            free_s = max(free_s + other_s[served], left[order[served]]) + lag_s[served]
            released[order[served]] = free_s
            served += 1
    end_s = now_s + WAY_S
    robot.append(PlaceVisit("home", end_s, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": []}
    at_s = {place: np.array([s for part, s in sorted(released.items()) if brings[part] == place]) for place in PLACES}
    keys = {place: Event("signal", f"digital-input {place[-1]}", "set") for place in PLACES}
    inside = {keys[place]: at[at <= end_s] for place, at in at_s.items()}
    later = {keys[place]: at[at > end_s] for place, at in at_s.items() if (at > end_s).any()}
    return ExecutionVisits(name, visits, events_of(visits) | inside, later=later)


def _goes(brings: list[str], order: list[int]) -> bool:
    """Return whether nobody waits for ever: a part is served before the next one can come to its place."""
    served: set[int] = set()
    brought = 0
    for part in order:
        while brought <= part:
            before = {other for other in range(brought) if brings[other] == brings[brought]}
            if not before <= served:
                return False
            brought += 1
        served.add(part)
    return True


def test_one_operator_serves_several_places_in_turn() -> None:
    rng = np.random.default_rng(3)
    found = learn_courses([_course(rng, str(n), in_turn=True) for n in range(100)])
    assert found.in_turn is not None
    assert found.in_turn.signals == ("digital-input 1", "digital-input 2", "digital-input 3")
    assert len(set(found.in_turn.orders)) > 10
    assert found.in_turn.gap_s[25] == pytest.approx(19.0, abs=3.0)  # 13 s of other work and 6 s for the part
    assert found.in_turn.gap_s[-1] == pytest.approx(31.0, abs=1.5)
    for source in found.sources:
        assert source.after[0].lag_s[25] == pytest.approx(6.0, abs=0.4)
        assert source.after[0].lag_s[45] < 7.0  # not the time that a part waited for his other work
    assert "one operator gives digital-input 1, digital-input 2, digital-input 3 in turn" in coupling_table(found)


def test_machines_that_work_at_the_same_time_are_no_operator() -> None:
    rng = np.random.default_rng(4)
    found = learn_courses([_course(rng, str(n), in_turn=False) for n in range(100)])
    assert len(found.sources) == 3
    assert found.in_turn is None
