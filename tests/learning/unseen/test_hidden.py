"""The hidden chain: what was drawn from a known one is found again, and drawn states give the logged levels."""

from __future__ import annotations

import numpy as np
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.cards.unseen import UnseenOperatorCard
from cyclekit.learning.unseen.hidden import LevelCourses, draw_states, fit, log_likelihoods, of_levels
from cyclekit.learning.unseen.model import Course, UnseenOperator


def drawn(executions: int, steps: int, *, by_place: bool, seed: int) -> LevelCourses:
    """Executions of an operator on one of two sides, who slows the robot on that side (or everywhere)."""
    rng = np.random.default_rng(seed)
    side = np.cumsum(rng.random((executions, steps)) < 0.02, axis=1) % 2
    region = np.cumsum(rng.random((executions, steps)) < 0.2, axis=1) % 2
    slow = side == region if by_place else side == 0
    return LevelCourses(np.where(slow, 0, 1), region, np.full(executions, steps))


def test_states_by_place_explain_held_out_levels_only_where_the_place_counts() -> None:
    for by_place in (True, False):
        learned, judged = (drawn(12, 200, by_place=by_place, seed=seed) for seed in (1, 2))
        plain = log_likelihoods(judged, of_levels(learned, 2)).sum()
        place = log_likelihoods(judged, fit(learned, 2, 2, 2)).sum()
        assert (place > plain + 100.0) == by_place


def test_drawn_states_are_those_that_the_levels_were_drawn_from() -> None:
    seen = drawn(8, 300, by_place=True, seed=3)
    states = draw_states(seen, fit(seen, 2, 2, 2))
    side = np.where(seen.level == 0, seen.region, 1 - seen.region)
    assert max((states == side).mean(), (states != side).mean()) > 0.95


@at_most(25)
@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(2, 5))
def test_the_model_gives_the_logged_levels_at_the_logged_positions(seed: int, states: int, levels: int) -> None:
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.full(levels, 0.3), (states, 3)) * 0.9 + 0.1 / levels
    follows = rng.dirichlet(np.ones(states), states)
    card = UnseenOperatorCard(
        step_s=0.2,
        regions_m=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        start=tuple(np.full(states, 1.0 / states).tolist()),
        follows=tuple(map(tuple, follows.tolist())),
        shares=tuple(tuple(map(tuple, row)) for row in shares.tolist()),
        seen_s=tuple((10.0, 10.0, 0.0) for _ in range(states)),
    )
    speeds = tuple(np.linspace(0.0, 1.0, levels).tolist())
    model = UnseenOperator(speeds, card, TrainingCard())
    level = rng.integers(-1, levels, 60)
    course = Course(np.arange(60) * 0.1, rng.random((60, 3)), level)
    (state,) = model.drawn_states([course], 10.0)
    known = level >= 0
    assert np.array_equal(model.scaling_in(course.robot_m, state)[known], np.array(speeds)[level[known]])
    assert ((state[:, 1] >= 0.0) & (state[:, 1] < 1.0)).all()
