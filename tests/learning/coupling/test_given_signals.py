"""A signal that the operator gives belongs to the visit in which he gave it, whatever other visits there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cyclekit.learning.coupling.conditions.departures import Condition, Departures, Gate
from cyclekit.learning.coupling.conditions.given_signals import since_given
from cyclekit.learning.coupling.events.givers import with_givers
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of

BUTTON = Event("operator", "fixture", "leaves", "button set")


def _course(visits: list[PlaceVisit], at: list[float], robot: list[PlaceVisit]) -> ExecutionVisits:
    both = {"robot": robot, "operator": visits}
    return ExecutionVisits("a", both, events_of(both) | {BUTTON: np.array(at)})  # type: ignore[arg-type]


def _since(
    visits: list[PlaceVisit], at: list[float], left_s: list[float], waited: dict[tuple[int, float], float] | None = None
) -> list[float]:
    """Return the times since the departures of the visits with presses of a robot that left at these times."""
    gate, condition, rows = Gate("robot", "leave", "fixture"), Condition(BUTTON, 0), np.arange(len(left_s))
    left = np.array(left_s)
    found = Departures(gate, rows, 0 * rows, rows, left, left, left, {(gate, condition): left - np.array(at)})
    return [float(since) for since in since_given([_course(visits, at, [])], found, condition, waited or {})]


def test_a_visit_without_a_press_does_not_shift_the_ones_after_it() -> None:
    visits = [PlaceVisit("fixture", 0.0, 4.0), PlaceVisit("fixture", 6.0, 8.0), PlaceVisit("fixture", 10.0, 15.0)]
    assert _since(visits, [3.9, 14.8], [4.3, 15.2]) == pytest.approx([0.3, 0.2])
    assert _since(visits, [3.9, 15.3], [4.3, 15.5]) == pytest.approx([0.3, 0.5])  # pressed as he went
    parted = [PlaceVisit("fixture", 0.0, 4.0), PlaceVisit("fixture", 4.0, 9.0)]
    assert _since(parted, [4.0, 8.8], [4.3, 9.2]) == pytest.approx([0.3, 0.2])


def test_who_waits_at_the_button_after_his_press_had_done_his_work_before() -> None:
    visits = [PlaceVisit("fixture", 10.0 * n, 10.0 * n + 4.0) for n in range(6)] + [PlaceVisit("fixture", 60.0, 72.0)]
    at = [10.0 * n + 3.5 for n in range(6)] + [63.5]
    left_s = [press + 0.7 for press in at]
    assert _since(visits, at, left_s)[-1] == pytest.approx(-7.8)
    assert _since(visits, at, left_s, {(0, 72.0): 71.5}) == pytest.approx([0.2] * 7)
    assert _since(visits, at, left_s, {(0, 72.0): 61.0})[-1] == pytest.approx(-7.8)  # waited before he worked


@pytest.mark.parametrize(("leaves_after_s", "his"), [(0.6, True), (6.0, False)])
def test_three_presses_in_most_stays_are_his_if_he_leaves_soon_after_the_last(leaves_after_s: float, his: bool) -> None:
    rng, courses = np.random.default_rng(3), []
    for _ in range(12):
        at = 20.0 + np.cumsum(rng.uniform(8.0, 11.0, 3))
        visits = [PlaceVisit("bench", 0.0, 12.0), PlaceVisit("fixture", 20.0, float(at[-1]) + leaves_after_s)]
        courses.append(_course([*visits, PlaceVisit("bench", 70.0, np.nan)], at.tolist(), []))
    signal = Event("signal", "button", "set")
    courses = [replace(one, events={signal: one.events[BUTTON]}) for one in courses]
    found = with_givers(courses, ())[0]
    assert any(event.agent == "operator" for event in found.events) is his
    assert [visit.place for visit in found.visits["operator"]].count("fixture") == (3 if his else 1)


def test_a_press_in_no_visit_or_in_one_that_the_log_cuts_off_tells_nothing() -> None:
    visits = [PlaceVisit("fixture", 0.0, 4.0), PlaceVisit("bench", 5.0, 9.0), PlaceVisit("fixture", 10.0, np.nan)]
    assert _since(visits, [3.9, 7.0, 14.8], [4.3, 7.4, 15.2]) == pytest.approx([0.3, np.nan, np.nan], nan_ok=True)


@pytest.mark.parametrize(("late_s", "his"), [(0.0, True), (0.7, True), (1.5, False)])
def test_a_press_that_a_plc_logs_late_is_still_his(late_s: float, his: bool) -> None:
    rng, courses = np.random.default_rng(2), []
    for _ in range(20):
        begins_s = np.cumsum(rng.uniform(8.0, 15.0, 4))
        visits = [PlaceVisit("fixture", float(at), float(at) + 4.0) for at in begins_s]
        courses.append(_course(visits, (begins_s + 3.9 + late_s).tolist(), []))
    signal = Event("signal", "button", "set")
    courses = [replace(one, events={signal: one.events[BUTTON]}) for one in courses]
    assert any(event.agent == "operator" for event in with_givers(courses, ())[0].events) is his
