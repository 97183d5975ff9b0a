"""An unseen operator who serves several places in turn: possible orders of service, and the waits for him."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from msgspec import structs

from cyclekit.api.train import train_model
from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.joint.in_turn import possible_orders
from cyclekit.estimate.rollout import estimate
from cyclekit_sim import fresh_cycles, random_orders

if TYPE_CHECKING:
    from simulated_cells import Cells

FRESH = 200


def test_orders_that_end_in_a_deadlock_are_left_out() -> None:
    logged = [(0, 1, 2), (1, 0, 2), (2, 0, 1), (0, 2, 1), (0, 1, 2)]
    assert possible_orders(logged, "abc") == logged  # each place has one part
    assert possible_orders(logged, "aba") == [(0, 1, 2), (1, 0, 2), (0, 2, 1), (0, 1, 2)]
    assert possible_orders(logged, "aab") == [(0, 1, 2), (0, 2, 1), (0, 1, 2)]
    assert possible_orders([(2, 1, 0)], "aab") == [(0, 1, 2)]  # none is possible: as they are brought


def test_logged_orders_fit_more_and_fewer_parts() -> None:
    assert possible_orders([(2, 0, 1)], "ab") == [(0, 1)]
    assert possible_orders([(1, 0)], "abcde") == [(1, 0, 3, 2, 4)]
    assert possible_orders([(1, 0)], "") == [()]


@pytest.mark.slow
def test_a_part_that_was_brought_early_waits_for_the_operators_other_work(cells: Cells) -> None:
    cell = cells("four-fixtures", 60, seed=91, people="none")
    model = train_model(cell.dataset)
    card = model.card.coupling
    assert card is not None
    assert card.in_turn is not None
    assert len(card.in_turn.signals) == 4
    orders = (one for one in random_orders("four-fixtures", 3, 200) if _early_again(one["robot"]))
    order = next(orders)
    sequence = [TaskSequence("early again", order["robot"])]
    operators = [one["operator"] for one in random_orders("four-fixtures", 4, 4000) if _joint(one) == _joint(order)]
    true_s = fresh_cycles("four-fixtures", order, cycles=FRESH, seed=5, operators=operators).robot_waits_s.mean()
    (now,) = estimate(model, cell.dataset, sequence, validate=False)
    apart = structs.replace(model.card, coupling=structs.replace(card, in_turn=None))
    (before,) = estimate(replace(model, card=apart), cell.dataset, sequence, validate=False)
    assert abs(now.wait_s - true_s) < abs(before.wait_s - true_s)


def _early_again(places: tuple[str, ...]) -> bool:
    at = [n for n, place in enumerate(places) if place.startswith("fixture")]
    return places[at[0]] == places[at[1]] and at[1] < 6


def _joint(order: dict[str, tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(place for place in order["operator"] if place.startswith("fixture"))
