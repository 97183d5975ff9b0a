"""The effect of the tasks before each task, learned from the robot's log alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.estimate.robot.nominal import NominalTask
from cyclekit.estimate.statistics.resample import RESAMPLES
from cyclekit.estimate.validation.order_effect import order_effect_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Vector

SIDES = {"left": (0.0, 0.8, 0.0), "right": (0.0, -0.8, 0.0)}
MIDDLE = (0.7, 0.0, 0.0)
PICKS = 10


def task(name: str, start: tuple[float, ...], goal: tuple[float, ...]) -> NominalTask:
    """Return a straight motion of 2 s with a process of 1 s at its goal."""
    return NominalTask(name, np.linspace(start, goal, 201), 2.0, 1.0, 0.0, np.ones(1))


NOMINAL = {
    name: task(name, start, goal)
    for side, place in SIDES.items()
    for name, start, goal in ((f"middle->{side}", MIDDLE, place), (f"{side}->middle", place, MIDDLE))
}


def order_of(sides: Sequence[str]) -> tuple[str, ...]:
    """Return the tasks of an order that visits these sides from the middle."""
    return tuple(name for side in sides for name in (f"middle->{side}", f"{side}->middle"))


def true_losses(order: tuple[str, ...], after_change_s: float) -> Vector:
    """Return mean safety losses: 1 s on the way to a side, and more if the robot was at the other side before."""
    lost = np.zeros(len(order))
    for number in range(0, len(order), 2):
        changed = number > 0 and order[number] != order[number - 2]
        lost[number] = 1.0 + after_change_s * changed
    return lost


def logs(count: int, after_change_s: float, seed: int) -> tuple[list[tuple[str, ...]], list[Vector]]:
    """Return random orders, and the logged durations of their tasks."""
    rng = np.random.default_rng(seed)
    orders = [order_of(rng.choice(["left", "right"], PICKS).tolist()) for _ in range(count)]
    return orders, [3.0 + true_losses(order, after_change_s) * rng.gamma(2.0, 0.5, len(order)) for order in orders]


def test_orders_that_change_sides_take_longer_if_they_did_in_the_logs() -> None:
    orders, took_s = logs(60, 1.5, seed=1)
    effect = order_effect_of(NOMINAL, orders, took_s)
    assert effect is not None
    asked = [order_of(["left"] * 5 + ["right"] * 5), order_of(["left", "right"] * 5), *logs(20, 1.5, seed=2)[0]]
    true_s = np.array([3.0 * len(order) + true_losses(order, 1.5).sum() for order in asked])
    found_s = np.array([effect.expected_s(order) for order in asked])
    mean_s = np.mean([one.sum() for one in took_s])
    assert np.abs(found_s / true_s - 1.0).mean() < 0.4 * np.abs(mean_s / true_s - 1.0).mean()


def test_the_logged_orders_keep_their_total() -> None:
    orders, took_s = logs(60, 1.5, seed=1)
    effect = order_effect_of(NOMINAL, orders, took_s)
    assert effect is not None
    assert sum(map(effect.expected_s, orders)) == pytest.approx(sum(one.sum() for one in took_s))


def test_an_order_twice_as_long_is_not_covered() -> None:
    orders, took_s = logs(60, 1.5, seed=1)
    effect = order_effect_of(NOMINAL, orders, took_s)
    assert effect is not None
    assert effect.covers(orders[0])
    assert effect.covers(orders[0][:10])
    assert not effect.covers(orders[0] * 2)


@pytest.mark.parametrize("seed", range(5))
def test_without_an_effect_none_is_found(seed: int) -> None:
    assert order_effect_of(NOMINAL, *logs(60, 0.0, seed)) is None


def test_too_few_executions_or_orders_show_none() -> None:
    orders, took_s = logs(9, 1.5, seed=1)
    assert order_effect_of(NOMINAL, orders, took_s) is None
    assert order_effect_of(NOMINAL, orders * 10, took_s * 10) is None


@pytest.mark.parametrize("seed", range(4))
def test_what_single_orders_have_of_their_own_is_no_effect(seed: int) -> None:
    """Repetitions of a few orders explain each of these, but say nothing about others."""
    rng = np.random.default_rng(seed)
    orders = list(dict.fromkeys(logs(15, 0.0, seed)[0]))
    own = {order: rng.uniform(0.0, 2.0, len(order)) for order in orders}
    took_s = [3.0 + own[order] + 0.2 * rng.standard_normal(len(order)) for order in orders * 10]
    assert order_effect_of(NOMINAL, orders * 10, took_s) is None


def test_the_mean_is_the_less_certain_the_fewer_executions_show_the_effect() -> None:
    asked = order_of(["left", "right"] * 5)
    spreads = []
    for count in (40, 160):
        effect = order_effect_of(NOMINAL, *logs(count, 1.5, seed=5))
        assert effect is not None
        factors = effect.uncertain(asked)
        assert factors.shape == (RESAMPLES,)
        assert factors.mean() == pytest.approx(1.0, abs=0.01)
        spreads.append(factors.std())
    assert spreads[1] < 0.8 * spreads[0]
