"""Edges that few operators crossed lie between the samples on both sides, and intervals are as wide as these leave."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, RectangleCard, RegionCard
from cyclekit.learning.rules.edges.brackets import bracketed
from cyclekit.learning.rules.samples.quantities import RulePlace, quantities
from cyclekit.learning.rules.samples.rows import RuleRows

STEPS = {0.3: 0, 1.0: 1}
LEFT_M, RIGHT_M = 1.15, 2.0
LEFT = RulePlace(0.3, False, "rectangle", 0, 0)


def edge(at_m: float) -> MetresCard:
    return MetresCard(value=at_m)


def limits(left_m: float, *, leave_m: float | None = None) -> tuple[LimitCard, ...]:
    """A rectangle from `left_m` to RIGHT_M; with hysteresis, to be left at `leave_m`."""
    regions = [
        None
        if at is None
        else RegionCard(
            rectangles=(RectangleCard(along=(edge(at), edge(RIGHT_M)), across=(edge(-1.0), edge(1.0))),),
        )
        for at in (left_m, leave_m)
    ]
    assert regions[0] is not None
    return (LimitCard(scaling=0.3, within=regions[0], until=regions[1]),)


def rows_of(
    x_m: list[np.ndarray], *, noise_m: float = 0.0, wrong: int | None = None, hold_m: float = 0.0, seed: int = 0
) -> RuleRows:
    """Passes along x at y = 0, slow within LEFT_M and RIGHT_M; `wrong`: a pass whose levels are the opposite."""
    rng = np.random.default_rng(seed)
    x, number = np.concatenate(x_m), np.repeat(np.arange(len(x_m)), [len(one) for one in x_m])
    slow, stays = (x > LEFT_M) & (x < RIGHT_M), (x > LEFT_M - hold_m) & (x < RIGHT_M + hold_m)
    for row in range(1, len(x)):
        if number[row] == number[row - 1] and slow[row - 1] and stays[row]:
            slow[row] = True
    level = np.where(slow != (number == wrong), 0, 1)
    human = np.column_stack([x, rng.uniform(-0.3, 0.3, len(x)), np.zeros(len(x))])
    seen = human + rng.normal(0.0, noise_m, human.shape)
    return RuleRows.made(np.zeros_like(human), seen, level, number, stretch=number)


def walk(first_m: float, last_m: float, step_m: float = 0.06) -> np.ndarray:
    """Positions ten times a second from `first_m` to `last_m`."""
    return np.linspace(first_m, last_m, max(6, round(abs(last_m - first_m) / step_m)))


def test_one_crossing_and_those_who_turned_back_place_an_edge_between_their_samples() -> None:
    inside, outside = walk(1.9, 1.19), walk(0.6, 1.12)
    rows = rows_of([walk(0.75, 1.75, 0.1), inside, outside])
    found, known = bracketed(limits(1.32), rows, STEPS, [LEFT])
    card = quantities(found)[LEFT]
    assert known == {LEFT}
    assert card.value == pytest.approx((1.12 + 1.19) / 2, abs=0.01)
    assert (card.low, card.high) == pytest.approx((1.12, 1.19), abs=0.015)
    assert quantities(found)[RulePlace(0.3, False, "rectangle", 0, 1)] == edge(RIGHT_M)


def test_a_region_is_left_where_the_level_stayed_and_not_where_it_fell() -> None:
    rows = rows_of([walk(1.7, 0.5), walk(0.5, 1.6), walk(1.7, 1.08), walk(1.6, 0.4)], hold_m=0.1)
    leave = LEFT._replace(until=True)
    found, _ = bracketed(limits(1.3, leave_m=1.3), rows, STEPS, [LEFT, leave])
    for place, at_m in ((LEFT, LEFT_M), (leave, LEFT_M - 0.1)):
        card = quantities(found)[place]
        assert card.low is not None
        assert card.high is not None
        assert card.low < at_m < card.high < card.low + 0.1


def test_an_edge_that_nobody_saw_from_outside_stays() -> None:
    rows = rows_of([walk(1.9, 1.3), walk(1.8, 1.4)])
    assert bracketed(limits(1.25), rows, STEPS, [LEFT]) == (limits(1.25), frozenset())


def test_the_levels_of_one_pass_may_be_wrong() -> None:
    passes = [walk(0.7, 1.13), walk(0.6, 1.7), walk(1.8, 1.18), walk(1.7, 0.8), walk(0.7, 1.0)]
    found, _ = bracketed(limits(1.2), rows_of(passes, wrong=4), STEPS, [LEFT])
    assert quantities(found)[LEFT].value == pytest.approx(LEFT_M, abs=0.03)


@pytest.mark.parametrize("noise_m", [0.01, 0.03, 0.05])
def test_intervals_of_few_noisy_passes_hold_as_often_as_they_say(noise_m: float) -> None:
    held, widths = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        ends = [(rng.uniform(0.7, 1.1), rng.uniform(1.2, 1.7)) for _ in range(3)]
        rows = rows_of([walk(a, b, rng.uniform(0.03, 0.12)) for a, b in ends], noise_m=noise_m, seed=seed)
        card = quantities(bracketed(limits(1.2), rows, STEPS, [LEFT])[0])[LEFT]
        assert card.low is not None
        assert card.high is not None
        held.append(card.low <= LEFT_M <= card.high)
        widths.append(card.high - card.low)
    assert np.mean(held) >= 0.9
    assert np.median(widths) < 0.16
