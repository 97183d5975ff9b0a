"""What is the same work: any order of the same visits, and a closed cycle wherever it is entered."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import assume, given
from hypothesis import strategies as st
from report_pages import estimate

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.estimate.statistics.same_work import by_work, work_of

PLACES = st.lists(st.sampled_from("abcd"), min_size=2, max_size=8).filter(
    lambda places: all(a != b for a, b in pairwise(places))
)


@given(PLACES, st.data())
def test_any_order_of_the_same_visits_is_the_same_work(places, data):
    other = data.draw(st.permutations(places[1:-1]))
    assert work_of(places) == work_of([places[0], *other, places[-1]])


def test_a_plan_for_both_is_the_same_work_in_any_order_of_the_same_visits():
    mine = [PlannedTask("robot", "home->feeder"), PlannedTask("robot", "feeder->fixture")]
    other = [PlannedTask("robot", "home->fixture"), PlannedTask("robot", "fixture->feeder")]
    his = [PlannedTask("operator", "bench")]
    works = [work_of(TaskSequence.of_plan("a", [*some, *his]).places) for some in (mine, other, mine[:1])]
    assert works[0] == works[1] != works[2]
    assert works[0].start is None


@given(PLACES, st.integers(0, 8))
def test_a_closed_cycle_is_the_same_work_wherever_it_is_entered(places, at):
    assume(places[0] != places[-1])
    at %= len(places)
    turned = [*places[at:], *places[:at]]
    assert work_of([*places, places[0]]) == work_of([*turned, turned[0]])


@given(PLACES, st.sampled_from("abcd"))
def test_one_visit_more_is_other_work(places, more):
    assert work_of(places) != work_of([*places, more])


def test_a_start_elsewhere_and_another_operator_are_other_work():
    assert work_of(["home", "a", "b"]) != work_of(["c", "a", "b"])
    assert work_of(["home", "a"]) != work_of(["home", "a"], ("stack",))
    assert work_of(["home", "a"], ("stack",)) == work_of(["home", "a"], ("stack",))


def test_cycles_are_put_together_by_their_work_in_the_order_given():
    places = {"1": ("h", "a", "b"), "2": ("h", "a"), "3": ("h", "b", "a")}
    some = [estimate(name, places=visits) for name, visits in places.items()]
    assert [[each.name for each in work] for work in by_work(some).values()] == [["1", "3"], ["2"]]


def test_the_work_is_named_by_its_visits():
    assert str(work_of(["home", "conveyor", "left_1", "conveyor"])) == "3 visits (conveyor x2, left_1) from home"
    plan = ("plan", "robot: home->a", "operator: b", "robot: a->home")
    assert str(work_of(plan)) == "2 tasks of robot, 1 task of operator"
    assert str(work_of(["home", "conveyor", "home"])) == "2 visits (conveyor, home)"
    assert str(work_of(["home", "a"], ("stack",))) == "1 visit (a) from home with an operator at stack"
    assert str(work_of(["home", *"abcdefg", "home"])) == "8 visits"
