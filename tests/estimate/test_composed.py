"""The operator's orders for work with more coupled visits than any log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
from cyclekit.estimate.joint.composed import composed_orders, continued, pairs_of

if TYPE_CHECKING:
    from collections.abc import Sequence

ONE = (("home", "fixture", "home"), ("rest", "bench", "rest"))
TWO = (("home", "fixture", "bin", "fixture", "home"), ("rest", "bench", "shelf", "bench", "rest"))
PAIRS = {"fixture": "bench"}


def gate(agent: str, place: str, other: str, at: str) -> GateCard:
    back = int(agent == "robot")  # he brings first, and the robot needs his visit before
    needs = ConditionCard(agent=other, place=at, event="leaves", lag_s=(0.5,), back=back)  # type: ignore[arg-type]
    return GateCard(agent=agent, at="approach", place=place, conditions=(needs,))  # type: ignore[arg-type]


def test_more_coupled_visits_than_any_log_repeat_what_the_operator_did_between_two() -> None:
    orders = composed_orders(("home", *["fixture"] * 4, "home"), [ONE, TWO] * 5, PAIRS)
    assert set(orders) == {("rest", *["bench", "shelf"] * 3, "bench", "rest")}
    assert set(composed_orders(("home", "fixture"), [TWO] * 5, PAIRS)) == {("rest", "bench", "rest")}


def test_what_he_did_in_between_is_drawn_from_all_logs() -> None:
    at_once = (TWO[0], ("rest", "bench", "bench", "rest"))
    orders = composed_orders(("home", *["fixture"] * 3), [TWO, at_once] * 5, PAIRS)
    assert {order.count("shelf") for order in orders} == {0, 1, 2}


def test_an_execution_that_ends_before_his_last_visit_counts_for_the_visits_before() -> None:
    ended = (TWO[0], ("rest", "bench", "shelf"))
    orders = composed_orders(("home", *["fixture"] * 3), [TWO, *[ended] * 9], PAIRS)
    assert set(orders) == {("rest", "bench", "shelf", "bench", "shelf", "bench", "rest")}


@pytest.mark.parametrize(
    "logged",
    [
        [ONE] * 10,  # never two visits: what he does in between is unknown
        [TWO] * 4,  # too few executions
        [TWO] * 5 + [(TWO[0], ("rest", "shelf", "bench", "bench", "bench"))] * 5,  # he goes there for other reasons too
    ],
)
def test_where_the_logs_do_not_tell_there_is_no_order(
    logged: Sequence[tuple[tuple[str, ...], tuple[str, ...]]],
) -> None:
    assert composed_orders(("home", *["fixture"] * 3), logged, PAIRS) == []


def test_each_coupled_place_of_the_robot_has_one_place_of_the_operator() -> None:
    both = [gate("robot", "fixture", "operator", "bench"), gate("operator", "bench", "robot", "fixture")]
    assert pairs_of(CouplingCard(gates=tuple(both))) == PAIRS
    assert pairs_of(CouplingCard(gates=(*both, gate("operator", "desk", "robot", "fixture")))) == {}
    assert pairs_of(CouplingCard(gates=(*both, gate("robot", "other", "operator", "bench")))) == {}
    assert pairs_of(None) == {}


COUPLED = CouplingCard(gates=(gate("robot", "fixture", "operator", "bench"),))


def test_an_operator_goes_on_from_the_place_where_the_execution_ended_too_early() -> None:
    """A robot with more work afterwards would else find him there until its end."""
    short = (("home", "fixture", "home"), ("rest", "bench"))
    assert continued([TWO, ONE, short], COUPLED) == [TWO[1], ONE[1], ("rest", "bench", "shelf")]
    elsewhere = (ONE[0], ("rest", "bench", "shelf"))
    assert continued([elsewhere, short], COUPLED)[0] == elsewhere[1]  # he stands where nobody waits for him
    assert continued([short], COUPLED) == [short[1]]  # never seen to leave
    assert continued([short, ONE], None) == [short[1], ONE[1]]


def test_an_operator_comes_to_the_last_coupled_visit_although_the_execution_ended_before() -> None:
    late = (TWO[0], ("rest", "bench", "shelf"))
    assert continued([late, *[TWO] * 9], COUPLED)[0][:4] == ("rest", "bench", "shelf", "bench")
    seldom = [(TWO[0], ("rest", "shelf"))] * 5  # he often stays away: then nobody knows
    assert continued([late, *seldom], COUPLED)[0] == late[1]
