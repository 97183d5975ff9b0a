"""Logged courses of states continued by others: how long a state lasts is neither shortened nor drawn out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.estimate.continuation import Stretch
from cyclekit.estimate.spells import LONGEST, Spells


def course(*spells: tuple[int, int]) -> Stretch:
    """Return a course of states, each for so many samples."""
    state = np.concatenate([np.full(length, number) for number, length in spells])
    return Stretch(np.column_stack([np.zeros((len(state), 3)), state]), state)


def test_a_state_goes_on_as_long_as_in_logs_in_which_it_lasted_so_long() -> None:
    """Spells of 10 and of 30 samples; one that has lasted 15 is one of the longer: the shorter are no rivals."""
    logs = [course((1, 5), (0, length), (1, 20)) for length in (10, 30) for _ in range(LONGEST)]
    begun = [course((1, 5), (0, 16))] * 50
    _, state = Spells(logs).extend(begun, 60)
    assert ((state[:, 5:] == 1).argmax(axis=1) == 30).all()
    early = [course((1, 5), (0, 4))] * 400
    _, state = Spells(logs).extend(early, 60)
    left = (state[:, 5:] == 1).argmax(axis=1)
    assert set(left.tolist()) == {10, 30}
    assert 0.4 < (left == 10).mean() < 0.6


def test_people_come_as_often_in_continued_courses_as_in_logs_that_end_when_nobody_came() -> None:
    """Spells without memory; a log ends as soon as 40 of its samples were without anybody, as a robot's cycle does."""
    rng = np.random.default_rng(0)
    whole = [np.repeat(np.arange(60) % 2, rng.geometric(0.05, 60)) for _ in range(60)]
    logs = [state[: 1 + np.flatnonzero(np.cumsum(state == 0) == 40)[0]] for state in whole]
    stretches = [course(*((int(number), 1) for number in state)) for state in logs]
    _, state = Spells(stretches).extend(stretches, 200)
    assert (state[:, 120:] == 0).mean() == pytest.approx(0.5, abs=0.06)


@given(
    st.lists(
        st.lists(st.tuples(st.integers(0, 3), st.integers(1, 12)), min_size=1, max_size=6), min_size=1, max_size=6
    ),
    st.integers(1, 80),
)
def test_every_course_begins_as_logged_and_is_as_long_as_asked(logs: list[list[tuple[int, int]]], length: int) -> None:
    stretches = [course(*spells) for spells in logs]
    where, state = Spells(stretches).extend(stretches, length)
    assert state.shape == (len(logs), length) == where.shape[:2]
    np.testing.assert_array_equal(where[..., 3], state)
    for stretch, mine in zip(stretches, state, strict=True):
        kept = min(length, len(stretch.activity))
        np.testing.assert_array_equal(mine[:kept], stretch.activity[:kept])
