"""Logged operators joined to circles: each second of the logs meets each part of a program alike, and nobody jumps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from cyclekit.estimate.operator import circles
from cyclekit.estimate.operator.circles import start_tracks
from cyclekit.estimate.operator.continuation import Stretch

STEP_S = 0.1
NOWHERE = (np.nan,) * 3


def walk(*way: tuple[float, float], samples: int, first: int = 0) -> Stretch:
    """Goes straight from one position to the next; its activity numbers its samples."""
    at, marks = np.linspace(0.0, len(way) - 1.0, samples), np.arange(len(way))
    x, y = (np.interp(at, marks, axis) for axis in np.array(way).T)
    return Stretch(np.column_stack([x, y, np.full(samples, 0.2)]), first + np.arange(samples))


def some_logs(rng: np.random.Generator, count: int) -> list[Stretch]:
    logs, first = [], 0
    for _ in range(count):
        samples = int(rng.integers(1, 90))
        logs.append(walk(*rng.uniform(-3.0, 3.0, (4, 2)), samples=samples, first=first))
        first += samples
    return logs


@pytest.mark.parametrize("at_once", [1000, 7])
def test_at_each_time_of_a_cycle_every_second_of_the_logs_is_met_alike(monkeypatch, at_once: int):
    monkeypatch.setattr(circles, "AT_ONCE", at_once)
    logs = some_logs(np.random.default_rng(1), 25)
    total = sum(len(log.where) for log in logs)
    found = start_tracks(logs, STEP_S, entries=total, length=300, after={3: 4, 4: 5})
    for samples in found.activity.T:
        np.testing.assert_array_equal(np.sort(samples), np.arange(total))
    some = start_tracks(logs, STEP_S, entries=40, length=20, after={3: 4})
    lengths = np.array([len(log.where) for log in logs])
    assert np.abs(np.bincount(some.owner, minlength=25) - 40 * lengths / total).max() <= 1.0


def test_a_track_says_whose_it_is_and_for_how_long():
    logs = some_logs(np.random.default_rng(2), 12)
    first = np.append(0, np.cumsum([len(log.where) for log in logs]))
    found = start_tracks(logs, STEP_S, entries=50, length=120, after={6: 7, 7: 8})
    for doing, owner, logged in zip(found.activity, found.owner, found.logged, strict=True):
        assert first[owner] <= doing[0] < first[owner + 1]
        last = {6: 9, 7: 9}.get(int(owner), int(owner) + 1)  # who really went on is his own operator still
        assert logged == first[last] - doing[0]
        own = min(logged, 120)
        np.testing.assert_array_equal(doing[:own], doing[0] + np.arange(own))


def test_a_log_goes_on_with_the_one_that_begins_where_it_ends_and_nobody_jumps():
    ways = [((1, 0), (2, 0)), ((2, 0.1), (3, 1)), ((3, 1.1), (1, 0.1)), ((9, 9), (5, 5)), ((5, 5.1), (9, 9.1))]
    logs = [walk(*way, samples=60, first=60 * k) for k, way in enumerate(ways)]
    found = start_tracks(logs, STEP_S, entries=5, length=200)
    follows = {a // 60: b // 60 for row in found.activity for a, b in pairwise(row.tolist()) if b // 60 != a // 60}
    assert follows == {0: 1, 1: 2, 2: 0, 3: 4, 4: 3}
    assert np.linalg.norm(np.diff(found.where, axis=1), axis=2).max() < 0.2


def test_who_is_away_at_the_end_goes_on_with_one_who_is_away_at_the_beginning():
    def then(*parts: tuple[float, ...]) -> Stretch:
        return Stretch(np.repeat(np.array(parts), 30, axis=0), np.full(30 * len(parts), -1))

    here, there = (1.0, 0.0, 0.2), (4.0, 0.0, 0.2)
    logs = [then(here, NOWHERE), then(NOWHERE, here), then(there, NOWHERE), then(NOWHERE, there)]
    found = start_tracks(logs, STEP_S, entries=8, length=240)
    away = np.isnan(found.where[..., 0])
    assert (away.mean(axis=0) == 0.5).all()
    ends = [len(run) for row in away for run in np.split(row, np.flatnonzero(np.diff(row)) + 1)[1:-1]]
    assert set(ends) == {60}  # never half of it, and never twice
    values = found.where[~away]
    assert {tuple(row) for row in values.tolist()} == {here, there}


def test_one_log_alone_is_a_circle_of_its_own_and_a_moment_lasts():
    walked = walk((1, 0), (2, 0), (1, 0), samples=50)
    found = start_tracks([walked], STEP_S, entries=4, length=120)
    np.testing.assert_array_equal(found.activity[0], np.arange(120) % 50)
    assert found.logged.tolist() == [50, 38, 25, 13]
    moment = Stretch(walked.where[:1], walked.activity[:1])
    found = start_tracks([moment], STEP_S, entries=2, length=10)
    np.testing.assert_array_equal(found.where, np.broadcast_to(moment.where[0], (2, 10, 3)))


def test_goals_go_along_and_what_was_given_stays_as_it_was():
    rng = np.random.default_rng(3)
    logs = [Stretch(rng.normal(size=(40, 6)), np.zeros(40, dtype=np.int64)) for _ in range(5)]
    given = [log.where.copy() for log in logs]
    found = start_tracks(logs, STEP_S, entries=10, length=90)
    assert found.where.shape == (10, 90, 6)
    assert {tuple(row) for row in found.where[..., 3:].reshape(-1, 3).tolist()} <= {
        tuple(row) for log in logs for row in log.where[:, 3:].tolist()
    }
    for log, was in zip(logs, given, strict=True):
        np.testing.assert_array_equal(log.where, was)
