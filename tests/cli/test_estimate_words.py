"""What `estimate` prints of sequences: no order among different work, and "most" for more than half only."""

from __future__ import annotations

import math

import pytest
from report_pages import estimate

from cyclekit.cli.estimate import basis_and_limits, estimates_table, largest_losses, ranking
from cyclekit.estimate.gantt import blocks_of, legend_of
from cyclekit.estimate.result import TaskShare

TWO = ("home", "conveyor", "left_1")
FOUR = ("home", "conveyor", "left_1", "conveyor", "right_1")
OTHER = ("home", "conveyor", "right_1", "conveyor", "left_1")


def test_different_work_has_no_ranks_and_no_probability_between_it() -> None:
    quick, slow = estimate("two", 18.0, places=TWO), estimate("four", 41.0, places=FOUR)
    shown = estimates_table([quick, slow])
    assert "1. " not in shown
    assert "2 visits (conveyor, left_1) from home" in shown
    told = ranking([quick, slow])
    assert "probability" not in told
    assert "two before" not in told
    assert "The work differs" in told
    assert [line.split() for line in told.splitlines()[2:]] == [
        ["two", "2", "9.00", "s"],
        ["four", "4", "10.25", "s"],
    ]


def test_sequences_of_the_same_work_are_ranked_within_it() -> None:
    first = estimate("four", 41.0, places=FOUR, beats={"turned": 0.9})
    found = [estimate("two", 18.0, places=TWO), first, estimate("turned", 42.0, places=OTHER, beats={"four": 0.1})]
    shown = estimates_table(found)
    assert "1. four" in shown
    assert "2. turned" in shown
    assert "“four” shorter than “turned”" in ranking(found)
    same = found[1:]
    assert "visits" not in estimates_table(same)
    assert "per visit" not in ranking(same)


@pytest.mark.parametrize(
    ("lost", "said"),
    [(3.8, "3.8 of 33.9 s at b->c, the largest share (11 %)"), (20.0, "20.0 of 33.9 s at b->c, most of it (59 %)")],
)
def test_most_is_said_of_more_than_half_only(lost: float, said: str) -> None:
    tasks = (TaskShare("a->b", 5.0, 4.0, 1.0, 0.0, 0.0), TaskShare("b->c", 25.0, 5.0, lost, 0.0, 0.0))
    told = largest_losses([estimate(tasks=tasks, safety_loss_s=33.9, safety_by_activity_s={"shelf": 4.0})])
    told = " ".join(told.split())
    assert said in told
    assert "4.0 s with the operator at or on the way to shelf, the largest share (12 %)" in told


@pytest.mark.parametrize("state", ["signals mat on", "no signal of people"])
def test_a_signal_is_no_place_that_the_operator_walks_to(state: str) -> None:
    tasks = (TaskShare("home->left_1", 9.0, 5.0, 4.0, 0.0, 0.0),)
    one = estimate(tasks=tasks, safety_loss_s=4.0, safety_by_activity_s={state: 4.0}, operator_at={state: (1.0,)})
    assert f"4.0 s with {state}, most of it (100 %)" in " ".join(largest_losses([one]).split())
    assert state in legend_of([one])
    (layer,) = blocks_of([one])[0].layers
    assert layer.tip == f"{state}: 100 % of the time"


def test_support_that_was_not_counted_is_said_to_be_so() -> None:
    told = " ".join(basis_and_limits([estimate(support=math.nan)]).split())
    assert "support not counted" in told
    assert "unknown" not in told
    assert "mean 30.0 s (95 % CI 29.4 to 30.6 s)" in told
