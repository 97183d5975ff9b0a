"""Operators continued beyond their logs: the same habits, for as long as asked."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from cyclekit.estimate.operator.continuation import Continuation, Stretch

STEP_S = 0.1
HERE, THERE = (2.0, 0.0, 0.2), (4.0, 1.0, 0.2)


def operator(rng: np.random.Generator, length_s: float, *, away: bool = False) -> Stretch:
    """Stays 2 to 4 s at one place, then 5 to 9 s at the other (or away), for ever; begun at any time."""
    parts: list[tuple[tuple[float, ...], int, float]] = []
    while sum(part[2] for part in parts) < length_s + 20.0:
        parts.append((HERE, 0, rng.uniform(2.0, 4.0)))
        parts.append(((np.nan,) * 3 if away else THERE, 1, rng.uniform(5.0, 9.0)))
    where = np.concatenate([np.tile(xyz, (round(s / STEP_S), 1)) for xyz, _, s in parts])
    doing = np.concatenate([np.full(round(s / STEP_S), what) for _, what, s in parts])
    first = rng.integers(0, round(20.0 / STEP_S))
    rows = slice(first, first + round(length_s / STEP_S))
    return Stretch(where[rows], doing[rows])


def stays_s(activity: np.ndarray) -> tuple[list[float], list[float]]:
    """Return how long each whole stay at the two places lasted."""
    found: tuple[list[float], list[float]] = ([], [])
    edges = np.flatnonzero(np.diff(activity)) + 1
    for first, last in pairwise(edges.tolist()):
        found[activity[first]].append((last - first) * STEP_S)
    return found


@pytest.mark.parametrize("away", [False, True])
@pytest.mark.parametrize("length_s", [15.0, 40.0])
def test_habits_stay_what_they_were_in_a_cycle_of_any_length(away: bool, length_s: float):
    rng = np.random.default_rng(3)
    logged = [operator(rng, length_s, away=away) for _ in range(30)]
    where, activity = Continuation(logged, STEP_S).extend(logged, list(range(30)), 3000)
    assert where.shape == (30, 3000, 3)
    stays = [stays_s(doing) for doing in activity]
    short, long = (np.concatenate([one[kind] for one in stays]) for kind in (0, 1))
    assert np.mean(short) == pytest.approx(3.0, rel=0.12)
    assert np.mean(long) == pytest.approx(7.0, rel=0.12)
    assert (activity == 0).mean() == pytest.approx(0.3, abs=0.04)
    assert np.isnan(where[activity == 1]).any() == away


def test_what_was_logged_stays_and_nobody_jumps():
    rng = np.random.default_rng(4)
    walks = [0.5 * np.cumsum(rng.normal(0.0, 0.05, (200, 3)), axis=0) for _ in range(12)]
    logged = [Stretch(walk, np.zeros(200, dtype=np.int64)) for walk in walks]
    where, _ = Continuation(logged, STEP_S).extend(logged, list(range(12)), 700)
    for track, walk in zip(where, walks, strict=True):
        np.testing.assert_array_equal(track[:200], walk)
    usual = max(np.abs(np.diff(walk, axis=0)).max() for walk in walks)
    assert np.abs(np.diff(where, axis=1)).max() < 3.0 * usual


def test_who_rests_when_his_work_is_done_goes_on_resting():
    work = np.tile(HERE, (100, 1))
    rest = np.tile(THERE, (60, 1))
    logged = [Stretch(np.concatenate([work, rest[: 30 + k]]), np.repeat([0, 1], [100, 30 + k])) for k in range(12)]
    where, activity = Continuation(logged, STEP_S).extend(logged, list(range(12)), 1000)
    assert (activity[:, 100:] == 1).all()
    np.testing.assert_allclose(where[:, 200:], np.broadcast_to(THERE, (12, 800, 3)))


def test_one_track_alone_goes_on_and_a_very_short_one_stands_still():
    walk = Stretch(np.linspace((1.0, 0.0, 0.2), (3.0, 0.0, 0.2), 50), np.zeros(50, dtype=np.int64))
    where, _ = Continuation([walk], STEP_S).extend([walk], [0], 120)
    assert np.isfinite(where).all()
    moment = Stretch(walk.where[:2], walk.activity[:2])
    where, _ = Continuation([moment], STEP_S).extend([moment], [0], 10)
    np.testing.assert_array_equal(where[0, 2:], np.tile(moment.where[-1], (8, 1)))


def test_same_seed_same_operator():
    rng = np.random.default_rng(5)
    logged = [operator(rng, 20.0) for _ in range(10)]
    one, two, other = (
        Continuation(logged, STEP_S).extend(logged, list(range(10)), 800, seed=seed)[0] for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)


def test_what_an_operator_does_next_does_not_depend_on_how_far_he_is_continued():
    rng = np.random.default_rng(6)
    logged = [operator(rng, length_s) for length_s in (15.0, 20.0, 25.0, 30.0)]
    continuation = Continuation(logged, STEP_S)
    (far, far_doing), (near, near_doing) = (continuation.extend(logged, range(4), length) for length in (900, 500))
    np.testing.assert_array_equal(far[:, :500], near)
    np.testing.assert_array_equal(far_doing[:, :500], near_doing)


def test_who_is_not_among_the_remembered_goes_on_as_well():
    rng = np.random.default_rng(7)
    logged = [operator(rng, 20.0) for _ in range(10)]
    strange = operator(rng, 3.0)
    where, activity = Continuation(logged, STEP_S).extend([strange], [-1], 600)
    assert np.isfinite(where).all()
    assert set(activity[0].tolist()) == {0, 1}


def with_known_tasks(track: Stretch) -> Stretch:
    """As derived from stays: a walk or an absence has the place where it ends, which the end of the log may cut."""
    standing = np.flatnonzero(track.activity >= 0)
    follows = np.searchsorted(standing, np.arange(len(track.activity)))
    known = follows < len(standing)
    doing = np.where(known, track.activity[standing[np.minimum(follows, len(standing) - 1)]], -1)
    return Stretch(track.where, doing)


def who_walks(rng: np.random.Generator, length_s: float, *, away: bool) -> Stretch:
    """Stays 3 to 5 s at one place, walks 4 s (or is away) to the other, and so on; a log begins at any time."""
    parts = []
    while sum(map(len, parts)) < (length_s + 40.0) / STEP_S:
        for here, there in ((HERE, THERE), (THERE, HERE)):
            parts.append(np.tile(here, (round(rng.uniform(3.0, 5.0) / STEP_S), 1)))
            way = np.linspace(here, there, round(4.0 / STEP_S))
            parts.append(np.full_like(way, np.nan) if away else way)
    where = np.concatenate(parts)[rng.integers(0, 300) :][: round(length_s / STEP_S)]
    places = [(where == place).all(axis=1) for place in (HERE, THERE)]
    return with_known_tasks(Stretch(where, np.select(places, (0, 1), -1)))


@pytest.mark.parametrize("away", [False, True])
def test_a_walk_or_absence_that_the_end_of_the_log_cuts_goes_on_and_does_not_lead_to_other_ends(away: bool):
    rng = np.random.default_rng(2)
    logged = [who_walks(rng, 12.0, away=away) for _ in range(40)]
    assert 10 < sum(track.activity[-1] < 0 for track in logged) < 30
    where, activity = Continuation(logged, STEP_S).extend(logged, list(range(40)), 1000)
    later = slice(200, None)  # beyond the logs
    assert (activity[:, later] < 0).mean() < 0.2
    stands = sum((where[:, later] == place).all(axis=2).mean() for place in (HERE, THERE))
    assert stands == pytest.approx(0.5, abs=0.05)


def beside_a_robot(rng: np.random.Generator, work_s: float) -> Stretch:
    """An operator in whose presence the robot halts: his log ends when it has worked so long, so never while he is."""
    track = operator(rng, 8 * work_s, away=True)
    done = np.flatnonzero(np.cumsum(track.activity == 1) * STEP_S >= work_s)[0] + 1
    return Stretch(track.where[:done], track.activity[:done])


def test_he_is_there_for_as_long_as_in_the_logs_although_these_end_when_he_goes():
    """No few logs follow each other again and again: one set of logs is continued as well as the other."""
    off = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        logged = [beside_a_robot(rng, 20.0) for _ in range(30)]
        usual = np.mean(np.concatenate([track.activity for track in logged]) == 0)
        _, activity = Continuation(logged, STEP_S).extend(logged, list(range(30)), 1500)
        off.append(np.mean(activity[:, 500:] == 0) / usual - 1)
    assert np.mean(off) == pytest.approx(0.0, abs=0.05)
    assert np.std(off) < 0.035
