"""Where the operator waits depends on where he comes from: at his bench, or at a spot to which he steps back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.events.givers import with_givers
from cyclekit.learning.coupling.events.trips import trip_places
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent

PRESS, LETS_GO = (Event("signal", "button", state) for state in ("set", "cleared"))
WALK_S, ASIDE_S = 2.0, 1.5
"""Walks between bench and place of inspection, and to the spot beside it, s."""
NAMES, WORK_S = {"B": "bench", "P": "printer"}, {"B": (9.0, 2.0), "P": (4.0, 1.0)}
"""Places of his other work, and mean and standard deviation of its duration, s."""


def _executions(
    seed: int,
    orders: tuple[str, ...] = ("BIIPI", "IPBII", "PIIBI"),
    count: int = 40,
    reacts_s: float = 0.8,
    early: float = 0.0,
) -> list[ExecutionVisits]:
    """Return executions in which the robot shows parts, each until the operator has inspected it and stepped back.

    He comes once it is there. After an inspection he steps back, and stands there if the next one follows; from his
    bench he comes straight. With a probability of `early` he comes from other work at once, and waits for the part.
    """
    rng = np.random.default_rng(seed)
    courses = []
    for number in range(count):
        robot, shown_s, left_s = [PlaceVisit("home", 0.0, 0.0)], rng.normal(10.0, 1.0), []
        operator = list[PlaceVisit]()
        now, here = 0.0, "bench"
        for place in orders[number % len(orders)]:
            if place != "I":
                came = now + (WALK_S if operator else 0.0)
                done = came + float(rng.normal(*WORK_S[place]))
                now, here = done, NAMES[place]
                operator.append(PlaceVisit(here, came, done))
                continue
            goes_s = max(now, shown_s + float(rng.normal(reacts_s, 0.15)))
            if early and operator and here != "aside" and rng.random() < early:
                goes_s = now
            if here == "aside":
                operator.append(PlaceVisit(here, now, goes_s))
            elif not operator:
                operator.append(PlaceVisit("bench", 0.0, goes_s))
            else:
                operator[-1] = operator[-1]._replace(left_s=goes_s)
            came = goes_s + (ASIDE_S if here == "aside" else WALK_S)
            done = max(came, shown_s) + float(rng.normal(5.0, 0.8))
            operator.append(PlaceVisit("inspection", came, done))
            now, here = done + ASIDE_S, "aside"
            robot.append(PlaceVisit("show", shown_s, done + ASIDE_S))
            left_s.append(done + ASIDE_S)
            shown_s = done + ASIDE_S + float(rng.normal(8.0, 0.5))
        robot.append(PlaceVisit("home", robot[-1].left_s + 3.0, np.nan))
        visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
        courses.append(ExecutionVisits(str(number), visits, events_of(visits)))
    return courses


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_spot_to_which_he_steps_back_is_no_place_of_his_order(seed: int) -> None:
    card = learn_courses(_executions(seed))
    (gate,) = (
        gate for gate in card.gates if (gate.agent, gate.at, gate.place) == ("operator", "approach", "inspection")
    )
    assert gate.wait_at == "aside"
    assert gate.wait_from == ("inspection",)
    assert gate.waits_at("inspection") == "aside"
    assert gate.waits_at("bench") is None
    (one,) = gate.conditions
    assert (one.agent, one.place, one.event, one.needed) == ("robot", "show", "arrives", 1.0)
    assert np.median(one.lag_s) == pytest.approx(0.8, abs=0.15)
    assert not any(gate.place == "aside" for gate in card.gates)


def test_who_seems_to_go_just_before_what_he_waits_for_still_waits_there() -> None:
    card = learn_courses(_executions(3, reacts_s=0.05))  # the tracker sees him go a little early
    assert {gate.wait_at for gate in card.gates if gate.agent == "operator" and gate.conditions} == {"aside"}


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_who_comes_early_by_chance_does_not_turn_off_on_the_way_to_a_spot(seed: int) -> None:
    """The part may come while he walks from the printer, but mostly he waits at it, or with the robot."""
    card = learn_courses(_executions(seed, count=60, early=0.4))
    gates = {(gate.at, gate.place): gate for gate in card.gates if gate.agent == "operator"}
    assert gates["approach", "inspection"].wait_from == ("inspection",)
    assert np.median(gates["leave", "printer"].own_s) == pytest.approx(4.0, abs=0.5)
    assert gates["leave", "printer"].conditions == ()


def _pressed(pulse_s: float, seed: int = 0) -> list[ExecutionVisits]:
    """Return executions in which he does one or two tasks in one stay, and presses a button after each."""
    rng, courses = np.random.default_rng(seed), []
    for number in range(30):
        count = (1, 1, 2, 1, 2)[number % 5]
        ends = np.cumsum(rng.uniform(4.0, 8.0, count)) + 5.0
        stays = [PlaceVisit("bench", 0.0, 3.0), PlaceVisit("fixture", 5.0, float(ends[-1]) + 0.1)]
        stays.append(PlaceVisit("bench", float(ends[-1]) + 2.0, float(ends[-1]) + 9.0))
        visits: dict[Agent, list[PlaceVisit]] = {"robot": [PlaceVisit("home", 0.0, 60.0)], "operator": stays}
        pulse = {PRESS: ends, LETS_GO: ends + pulse_s} if pulse_s > 0.0 else {PRESS: ends - pulse_s, LETS_GO: ends}
        courses.append(ExecutionVisits(str(number), visits, events_of(visits) | pulse))
    return courses


@pytest.mark.parametrize("pulse_s", [0.3, -0.3])
def test_a_pulse_of_a_button_ends_one_task(pulse_s: float) -> None:
    courses = _pressed(pulse_s)
    for before, after in zip(courses, with_givers(courses, ()), strict=True):
        mine = [visit for visit in after.visits["operator"] if visit.place == "fixture"]
        first = before.events[PRESS if pulse_s > 0.0 else LETS_GO]
        assert [visit.left_s for visit in mine][:-1] == pytest.approx(first[:-1])
        assert len(mine) == len(first)


def test_a_place_where_he_presses_a_button_is_none_of_trips() -> None:
    courses = _pressed(0.3)
    assert trip_places(with_givers(courses, ())) != ("fixture",)
    assert "fixture" not in trip_places(with_givers(courses, ()))
