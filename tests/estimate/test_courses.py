"""Logged courses of states go on with other logged courses: people are there as often as in the logs."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.dataset.cards import DynamicsCard
from cyclekit.estimate.operator import tracks
from cyclekit.estimate.operator.continuation import Stretch
from cyclekit.estimate.operator.courses import continue_courses
from cyclekit.estimate.robot.safety import OnStates

CARD = SimpleNamespace(executions=(), dynamics=DynamicsCard())


def course(*spells: tuple[int, int]) -> Stretch:
    """Return a course of states, each for so many samples."""
    state = np.concatenate([np.full(length, number) for number, length in spells])
    return Stretch(np.column_stack([np.zeros((len(state), 3)), state]), state)


def test_a_course_goes_on_in_the_state_it_ended_in_with_each_log_as_often_as_any_other() -> None:
    logs = [course((0, 10), (number, 5), (0, 1)) for number in range(2, 7)] + [course((1, 16))] * 5
    _, state = continue_courses([course((0, 4))] * 10, logs, 64)
    assert 1 not in state
    for at in (16, 32, 48):
        assert Counter(state[:, at].tolist()) == dict.fromkeys(range(2, 7), 2)
    _, state = continue_courses([course((9, 4))] * 10, logs, 10)  # no log begins so
    assert set(state[:, 5].tolist()) == {0, 1}


def test_people_come_as_often_in_continued_courses_as_in_logs_that_end_when_nobody_came() -> None:
    """Spells without memory; a log ends as soon as 40 of its samples were without anybody, as a robot's cycle does."""
    rng = np.random.default_rng(0)
    whole = [np.repeat((np.arange(60) + rng.integers(0, 2)) % 2, rng.geometric(0.05, 60)) for _ in range(200)]
    logs = [state[: 1 + np.flatnonzero(np.cumsum(state == 0) == 40)[0]] for state in whole]
    stretches = [course(*((int(number), 1) for number in state)) for state in logs]
    _, state = continue_courses(stretches, stretches, 400)
    assert (state == 0).mean() == pytest.approx(0.5, abs=0.03)


@given(
    st.lists(
        st.lists(st.tuples(st.integers(0, 3), st.integers(1, 12)), min_size=1, max_size=6), min_size=1, max_size=6
    ),
    st.integers(1, 80),
)
def test_every_course_begins_as_logged_and_is_as_long_as_asked(logs: list[list[tuple[int, int]]], length: int) -> None:
    stretches = [course(*spells) for spells in logs]
    where, state = continue_courses(stretches, stretches, length)
    assert state.shape == (len(logs), length) == where.shape[:2]
    np.testing.assert_array_equal(where[..., 3], state)
    np.testing.assert_array_equal(continue_courses(stretches, stretches, length + 7)[1][:, :length], state)
    for stretch, mine in zip(stretches, state, strict=True):
        kept = min(length, len(stretch.activity))
        np.testing.assert_array_equal(mine[:kept], stretch.activity[:kept])


def test_courses_of_states_are_entered_at_several_instants(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    names = [f"execution {number}" for number in range(30)]
    logs = {name: course(*((int(number), 1) for number in rng.integers(0, 2, 50))) for name in names}
    ends = {"begin_s": 0.0, "end_s": 4.9, "seen": True, "away": False, "followed": True}
    logged = {name: tracks.LoggedTrack(one.where, one.activity, **ends) for name, one in logs.items()}
    monkeypatch.setattr(tracks, "_in_states", lambda dataset, model: (["nobody", "somebody"], logged))
    starts = [100.0 * number for number in range(len(names))]
    executions = pl.DataFrame({"execution": names, "session": 0, "start_s": starts, "complete": True})
    executions = executions.with_columns(end_s=pl.col("start_s") + 4.9)
    dataset = SimpleNamespace(rate_hz=10.0, executions=executions, card=CARD, path="cell")
    model = Mock(spec=OnStates)
    assert isinstance(model, OnStates)
    found = tracks.operator_tracks(dataset, horizon_s=8.0, model=model, anywhere=1.0)  # type: ignore[arg-type]
    assert found.executions == tuple(names) * tracks.PHASES
    later = len(names) * 2
    np.testing.assert_array_equal(found.activity[0, :44], logs[names[0]].activity[6:])
    np.testing.assert_array_equal(found.activity[later, :19], logs[names[0]].activity[31:])
    as_logged = tracks.operator_tracks(dataset, horizon_s=8.0, model=model)  # type: ignore[arg-type]
    assert as_logged.executions == tuple(names)
    np.testing.assert_array_equal(as_logged.activity[0, :50], logs[names[0]].activity)


def test_in_a_pause_between_executions_people_are_in_the_last_or_the_next_state_and_in_none_between(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    logs = {"first": course((0, 50)), "second": course((5, 50))}
    begins_s = {"first": 0.0, "second": 8.0}
    flags = {"seen": True, "away": False, "followed": True}
    logged = {
        name: tracks.LoggedTrack(one.where, one.activity, begins_s[name], begins_s[name] + 4.9, **flags)
        for name, one in logs.items()
    }
    monkeypatch.setattr(tracks, "_in_states", lambda dataset, model: ([str(number) for number in range(6)], logged))
    executions = pl.DataFrame({"execution": list(logs), "session": 0, "start_s": [0.0, 8.0], "end_s": [4.9, 12.9],
                               "complete": True})  # fmt: skip
    dataset = SimpleNamespace(rate_hz=10.0, executions=executions, card=CARD, path="cell")
    found = tracks.operator_tracks(dataset, horizon_s=12.0, model=Mock(spec=OnStates))  # type: ignore[arg-type]
    assert found.state is not None
    np.testing.assert_array_equal(found.state[0, :65, 0], 0)
    np.testing.assert_array_equal(found.state[0, 66:120, 0], 5)
    np.testing.assert_array_equal(found.activity[0, :120], found.state[0, :120, 0])
