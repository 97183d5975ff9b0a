"""What an operator does who goes for a tool in the middle of his work, and who stands aside only if he has to wait."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.config import Wait
from cyclekit.errors import UnknownName
from cyclekit.learning.coupling import learn
from cyclekit.learning.coupling.events.errands import errand_places, joined
from cyclekit.learning.coupling.events.givers import with_givers
from cyclekit.learning.coupling.events.trips import trip_places
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses, learn_executions
from cyclekit.learning.coupling.waits import with_waits_named
from cyclekit.learning.coupling.words import habit_lines, wait_rows

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard, GateCard
    from cyclekit.dataset.cards.coupling import Agent

BUTTON = Event("signal", "button", "set")
RESET = Event("signal", "button", "cleared")


def _execution(
    rng: np.random.Generator,
    name: str,
    *,
    errands: float = 0.0,
    short: float = 0.0,
    always_aside: bool = False,
    robot_s: float = 3.0,
) -> ExecutionVisits:
    """Return one in which the robot brings three parts to a fixture, and the operator, who works there, releases each.

    Between the parts he is at one of two benches, or nowhere. If the part is not there yet, or the robot has not gone,
    he stands aside. The robot waits short of the fixture until he has pressed the button.

    Args:
        rng: Random numbers.
        name: Its name.
        errands: Share of his tasks at the fixture in which he goes to the shelf in the middle.
        short: Share of these errands on which he does not stay long enough at the shelf to be seen there.
        always_aside: Whether he also stands aside where he need not wait.
        robot_s: How long the robot takes to the fixture, s.
    """
    robot = [PlaceVisit("rack", 0.0, rng.uniform(0.5, 6.0))]
    operator = [PlaceVisit("bench", 0.0, rng.uniform(2.0, 9.0))]
    presses: list[float] = []
    for between in rng.permutation(["bench", "desk", ""]).tolist():
        reached = robot[-1].left_s + robot_s
        on = max([reached, *presses[-1:]])
        robot.append(PlaceVisit("fixture", on + 1.0, on + 2.0, reached, on))
        ready, gone = operator[-1].left_s, robot[-1].left_s + rng.uniform(0.4, 0.7)
        if gone > ready or always_aside:
            aside = ready + 1.2
            went = max(aside + rng.uniform(0.0, 0.3), gone)
            if went > aside + 0.5 or always_aside:
                operator.append(PlaceVisit("aside", aside, went))
            came = went + 1.0
        else:
            came = ready + 1.5
        half, rest = rng.uniform(2.0, 3.0), rng.uniform(2.0, 4.0)
        if rng.random() < errands:
            operator.append(PlaceVisit("fixture", came, came + half))
            if rng.random() >= short:
                operator.append(PlaceVisit("shelf", came + half + 1.5, came + half + 3.0))
            came += half + 4.5
            operator.append(PlaceVisit("fixture", came, came + rest))
        else:
            operator.append(PlaceVisit("fixture", came, came + half + rest))
        presses.append(operator[-1].left_s - 0.05)
        robot.append(PlaceVisit("rack", robot[-1].left_s + 2.0, robot[-1].left_s + 2.5))
        if between:
            begin = operator[-1].left_s + 2.0
            operator.append(PlaceVisit(between, begin, begin + rng.uniform(2.0, 9.0)))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    at = np.array(presses)
    return ExecutionVisits(name, visits, events_of(visits) | {BUTTON: at, RESET: at + 0.3})


def _executions(seed: int, count: int = 40, **habits: float | bool) -> list[ExecutionVisits]:
    rng = np.random.default_rng(seed)
    courses = [_execution(rng, str(number), **habits) for number in range(count)]  # type: ignore[arg-type]
    return with_givers(courses, ())


def _gate(card: CouplingCard, agent: Agent, at: str, place: str) -> GateCard:
    return next(gate for gate in card.gates if (gate.agent, gate.at, gate.place) == (agent, at, place))


def _condition(gate: GateCard) -> tuple[str, str, str, str | None]:
    (one,) = gate.conditions
    return one.agent, one.place, one.event, one.signal


@pytest.mark.parametrize(("errands", "short"), [(0.5, 0.3), pytest.param(0.3, 0.0, marks=pytest.mark.slow)])
def test_an_errand_is_part_of_the_work_that_it_interrupts(errands: float, short: float) -> None:
    courses = _executions(1, errands=errands, short=short)
    assert errand_places(courses) == ("shelf",)
    card = learn_courses(courses)
    assert card.errands == ("shelf",)
    assert any("shelf in the middle of his work" in line for line in habit_lines(card))
    assert _condition(_gate(card, "robot", "approach", "fixture")) == ("operator", "fixture", "leaves", "button set")
    own_s = np.array(_gate(card, "operator", "leave", "fixture").own_s)
    longer = float(np.mean(own_s > 8.0))  # without an errand his work takes 4 to 7 s, with one 8.5 to 11.5 s
    assert longer == pytest.approx(errands, abs=0.15)


def test_parts_without_a_signal_are_looked_for_once_at_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """That takes long, and the courses with errands, or without waits aside, have the same visits of the robot."""
    places: list[str] = []
    monkeypatch.setattr(learn, "find_unseen_parts", lambda _, place: places.append(place))
    learn_courses(_executions(1, errands=0.5, short=0.3))
    assert places
    assert sorted(places) == sorted(set(places))


def test_without_errands_there_are_none() -> None:
    courses = _executions(2, 60)
    assert errand_places(courses) == ()
    assert learn_courses(courses).errands == ()


def test_visits_between_which_he_has_done_a_task_are_not_joined() -> None:
    visits = [PlaceVisit("fixture", 0.0, 5.0), PlaceVisit("shelf", 7.0, 8.0), PlaceVisit("fixture", 10.0, 15.0)]
    assert joined(visits, ["shelf"]) == [PlaceVisit("fixture", 0.0, 15.0)]
    assert joined(visits, ["shelf"], {"fixture": [np.array([4.9, 14.9])]}) == visits
    assert joined(visits, []) == visits


def test_the_cell_file_tells_that_he_works_at_a_place_where_he_seemed_to_wait() -> None:
    courses = _executions(4)
    assert any(gate.wait_at == "aside" for gate in learn_courses(courses).gates)
    card = learn_courses(courses, [Wait("operator", spot="aside", never=True)])
    assert not any(gate.wait_at for gate in card.gates)
    assert _gate(card, "operator", "leave", "aside").passages  # a place of his order, where his work takes some time
    with pytest.raises(UnknownName, match="spot 'beside'"):
        learn_courses(courses, [Wait("operator", spot="beside", never=True)])


def test_several_signals_in_one_stay_are_so_many_tasks() -> None:
    """He may begin with the next part at once, without a step aside."""
    rng = np.random.default_rng(3)
    courses = []
    for number in range(20):
        at = np.cumsum(rng.uniform(4.0, 6.0, 4)) + 2.0
        stays = [PlaceVisit("fixture", 2.0, at[1] + 0.1), PlaceVisit("bench", at[1] + 1.0, at[1] + 1.5)]
        stays += [PlaceVisit("fixture", at[1] + 2.0, at[2] + 0.1), PlaceVisit("bench", at[2] + 1.0, at[2] + 1.5)]
        stays += [PlaceVisit("fixture", at[2] + 2.0, at[3] + 0.1)]
        visits: dict[Agent, list[PlaceVisit]] = {"robot": [PlaceVisit("home", 0.0, 30.0)], "operator": stays}
        courses.append(ExecutionVisits(str(number), visits, events_of(visits) | {BUTTON: at}))
    found = with_givers(courses, ())
    given = Event("operator", "fixture", "leaves", "button set")
    for before, after in zip(courses, found, strict=True):
        press = before.events[BUTTON]
        mine = [visit for visit in after.visits["operator"] if visit.place == "fixture"]
        assert [visit.left_s for visit in mine] == pytest.approx([press[0], *(press[1:] + 0.1)])
        assert after.events[given] == pytest.approx(press)
        assert after.events[Event("operator", "fixture", "leaves")] == pytest.approx([press[0], *(press[1:] + 0.1)])


def test_a_signal_that_changes_all_the_time_is_not_his() -> None:
    courses = []
    for number in range(20):
        stays = [PlaceVisit("fixture", 0.0, 60.0)]
        visits: dict[Agent, list[PlaceVisit]] = {"robot": [PlaceVisit("home", 0.0, 60.0)], "operator": stays}
        courses.append(ExecutionVisits(str(number), visits, events_of(visits) | {BUTTON: np.arange(1.0, 59.0, 6.0)}))
    assert all(BUTTON in course.events for course in with_givers(courses, ()))


@pytest.mark.parametrize("errands", [0.3, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_place_where_he_only_waits_is_a_wait_before_the_next_place(errands: float) -> None:
    card = learn_courses(_executions(4, errands=errands))
    gate = _gate(card, "operator", "approach", "fixture")
    assert gate.wait_at == "aside"
    assert _condition(gate) == ("robot", "fixture", "leaves", None)
    (one,) = gate.conditions
    assert one.needed == 1.0
    assert np.quantile(one.lag_s, (0.1, 0.9)) == pytest.approx([0.43, 0.67], abs=0.1)
    assert not any(gate.place == "aside" for gate in card.gates)
    assert "operator before fixture, at aside" in {row.who for row in wait_rows(card)}


def _handed_over(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which the robot shows four parts and the operator takes each, as soon as it is there.

    After each part he steps aside. Next comes another part, for which he may have to wait there, or his work at two
    benches. He ends the execution aside.
    """
    robot, operator = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("rest", 0.0, 0.5)]
    for task in ["part", "part", *rng.permutation(["bench", "desk"]).tolist(), "part", "part"]:
        last = operator[-1]
        if task != "part":
            operator.append(PlaceVisit(task, last.left_s + 2.5, last.left_s + 2.5 + rng.uniform(3.0, 9.0)))
            continue
        shown = robot[-1].left_s + rng.choice([rng.uniform(0.1, 0.5), rng.uniform(3.0, 9.0)])
        came = last.left_s + 2.5
        if last.place == "take":
            went = max(last.left_s + 1.5, shown + rng.uniform(0.3, 0.7))
            if went > last.left_s + 2.0:
                operator.append(PlaceVisit("aside", last.left_s + 1.5, went))
            came = went + 1.5
        taken = max(came, shown) + rng.uniform(0.8, 1.3)
        operator.append(PlaceVisit("take", came, taken))
        robot.append(PlaceVisit("show", shown, taken + rng.uniform(0.4, 0.7)))
    operator.append(PlaceVisit("aside", operator[-1].left_s + 1.5, np.nan))
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def test_who_waits_aside_between_two_parts_is_on_no_trip() -> None:
    rng = np.random.default_rng(8)
    courses = [_handed_over(rng, str(number)) for number in range(40)]
    assert trip_places(courses) == ("aside",), "by its counts alone it could be one"
    card = learn_courses(courses)
    gate = _gate(card, "operator", "approach", "take")
    assert (gate.wait_at, gate.wait_from) == ("aside", ("take",))
    assert not any(gate.trip for gate in card.gates)
    assert _condition(gate) == ("robot", "show", "arrives", None)


def test_one_visit_that_was_not_seen_tells_nothing_of_the_robots_own_work() -> None:
    """The robot always waits to be freed; its own work is shorter than any of its standstills."""
    rng = np.random.default_rng(9)
    courses = [_handed_over(rng, str(number)) for number in range(40)]
    whole = _gate(learn_courses(courses), "robot", "leave", "show")
    visits = list(courses[0].visits["operator"])
    unseen = max((visit for visit in visits if visit.place == "take"), key=lambda visit: visit.left_s - visit.arrived_s)
    courses[0] = courses[0].with_operator([visit for visit in visits if visit is not unseen])
    gate = _gate(learn_courses(courses), "robot", "leave", "show")
    assert _condition(gate) == _condition(whole) == ("operator", "take", "leaves", None)
    assert gate.own_s == whole.own_s
    assert max(gate.own_s) <= min(one.left_s - one.arrived_s for c in courses for one in c.visits["robot"][1:-1])


def test_a_place_to_which_he_always_goes_stays_one_of_his_order() -> None:
    card = learn_courses(_executions(5, always_aside=True))
    assert all(gate.wait_at is None for gate in card.gates)
    assert any((gate.agent, gate.place) == ("operator", "aside") for gate in card.gates)


@pytest.mark.parametrize("errands", [0.4, pytest.param(0.0, marks=pytest.mark.slow)])
def test_logged_waits_are_named_also_with_errands_and_spots(errands: float) -> None:
    courses = _executions(6, errands=errands)
    rows: list[dict[str, object]] = []
    numbered = []
    for course in courses:
        mine = [visit._replace(task=index) for index, visit in enumerate(course.visits["operator"])]
        numbered.append(replace(course, visits={**course.visits, "operator": mine}))
        for agent, some in (("robot", course.visits["robot"][1:]), ("operator", mine)):
            for index, visit in enumerate(some):
                times = {"arrival_s": visit.arrived_s, "end_s": visit.left_s}
                times["wait_s"] = float(np.nan_to_num(visit.went_on_s - visit.reached_s)) if agent == "robot" else 0.0
                known = {"execution": course.name, "index": index, "agent": agent, "goal_place": visit.place}
                rows.append(known | times)
    tasks = schema.conform(pl.DataFrame(rows, infer_schema_length=None), schema.TASKS)
    named = with_waits_named(tasks, numbered, learn_courses(courses)).filter(pl.col("waited_for").is_not_null())
    robot, operator = (named.filter(pl.col("agent") == agent) for agent in ("robot", "operator"))
    waits_s = [visit.went_on_s - visit.reached_s for course in courses for visit in course.visits["robot"]]
    assert robot["waited_for"].unique().to_list() == ["operator leaves fixture (button set)"]
    assert robot.height == pytest.approx(sum(wait_s > 0.1 for wait_s in waits_s), abs=3)
    assert operator["waited_for"].unique().to_list() == ["robot leaves fixture"]
    aside = sum(visit.place == "aside" for course in courses for visit in course.visits["operator"])
    assert operator.filter(pl.col("goal_place") == "aside").height >= 0.8 * aside


def test_longer_waits_at_a_spot_are_no_other_pace_of_the_operator() -> None:
    """The robot becomes slower, so he waits longer; he works as before."""
    rng = np.random.default_rng(7)
    slower = np.linspace(2.0, 9.0, 120).tolist()
    courses = with_givers([_execution(rng, f"{n:03d}", robot_s=robot_s) for n, robot_s in enumerate(slower)], ())
    tasks = schema.conform(pl.DataFrame({"reached_s": [None], "nominal_s": [1.0]}), schema.TASKS)
    card = learn_executions(courses, tasks)
    assert card is not None
    assert _gate(card, "operator", "approach", "fixture").wait_at == "aside"
    assert card.pace is None
