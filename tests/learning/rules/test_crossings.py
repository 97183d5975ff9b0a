"""Thresholds and edges from where the level changed, with noise, a reaction time that is off, and one hysteresis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, NearerCard, RegionCard
from cyclekit.learning.rules.edges.crossing_fit import by_crossings, located, with_one_margin
from cyclekit.learning.rules.edges.crossings import LevelChanges, crossings_of
from cyclekit.learning.rules.families import FAMILIES
from cyclekit.learning.rules.intervals import with_intervals
from cyclekit.learning.rules.samples.distances import TO_TCP
from cyclekit.learning.rules.samples.quantities import RulePlace, quantities
from cyclekit.learning.rules.samples.rows import RuleRows

INNER, OUTER = (RulePlace(0.3, until, "nearer", 0) for until in (False, True))
FARTHER, FARTHEST = (RulePlace(0.7, until, "nearer", 0) for until in (False, True))


def crossed(
    at_m: float, way: int, rng: np.random.Generator, *, late: float = 0.0, count: int = 300, off_m: float = 0.01
) -> LevelChanges:
    """Changes of the level at a threshold, seen `late` samples too late, of people who come (-1) or go (1)."""
    pace = way * rng.uniform(0.02, 0.14, count)
    spread = np.sqrt(off_m**2 + pace**2 / 12)
    value = at_m + late * pace + rng.normal(0.0, off_m, count) + pace * rng.uniform(-0.5, 0.5, count)
    return LevelChanges(value, pace, spread, np.sort(rng.integers(0, 30, count)))


def test_a_reaction_time_that_is_off_moves_no_threshold() -> None:
    rng = np.random.default_rng(5)
    told = {INNER: crossed(1.2, -1, rng, late=0.3), OUTER: crossed(1.35, 1, rng, late=0.3)}
    assert abs(told[INNER].value_m.mean() - 1.2) > 0.015
    inner, outer = located(told).cards().values()
    assert inner.value == pytest.approx(1.2, abs=0.008)
    assert outer.value == pytest.approx(1.35, abs=0.008)
    assert outer.low is not None
    assert outer.high is not None
    assert outer.low < 1.35 < outer.high < outer.low + 0.04


def test_intervals_hold_as_often_as_they_say() -> None:
    rng, held, width = np.random.default_rng(6), 0, []
    for _ in range(200):
        told = {INNER: crossed(1.2, -1, rng, late=0.1), OUTER: crossed(1.35, 1, rng, late=0.1, count=12)}
        for at, card in zip((1.2, 1.35), located(told).cards().values(), strict=True):
            assert card.low is not None
            assert card.high is not None
            held += card.low <= at <= card.high
            width.append(card.high - card.low)
    assert 0.92 <= held / 400 <= 0.995
    assert np.median(width) < 0.05


def test_executions_are_what_is_counted() -> None:
    rng = np.random.default_rng(7)
    one = crossed(1.2, -1, rng, count=200)
    shared = one._replace(value_m=one.value_m + rng.normal(0.0, 0.03, 30)[one.execution])
    alone, together = (located({INNER: each}).cards()[INNER] for each in (one, shared))
    widths = [each.high - each.low for each in (alone, together) if each.high is not None and each.low is not None]
    assert widths[1] > 1.5 * widths[0]


def test_what_is_far_off_is_of_another_edge() -> None:
    rng = np.random.default_rng(8)
    one = crossed(1.2, -1, rng)
    strays = one._replace(value_m=np.where(np.arange(300) < 20, one.value_m + 0.3, one.value_m))
    assert located({INNER: strays}).cards()[INNER].value == pytest.approx(1.2, abs=0.008)


def test_few_changes_at_one_threshold_borrow_the_margin_of_the_others() -> None:
    rng = np.random.default_rng(9)
    told = {
        INNER: crossed(1.2, -1, rng),
        OUTER: crossed(1.35, 1, rng),
        FARTHER: crossed(1.7, -1, rng),
        FARTHEST: crossed(1.85, 1, rng, count=6),
    }
    own, shared = located(told), with_one_margin(located(told))
    margins = np.diff(shared.at_m)[::2]
    assert margins[0] == pytest.approx(margins[1], abs=1e-9)
    before, after = (each.error_m(np.eye(4))[3] for each in (own, shared))
    assert after < 0.6 * before
    apart = with_one_margin(own._replace(at_m=own.at_m + np.array([0.0, 0.0, 0.0, 0.2])))
    assert apart.at_m[3] == pytest.approx(own.at_m[3] + 0.2)


def passes(noise_m: float) -> tuple[RuleRows, tuple[LimitCard, ...]]:
    """People who pass a robot at rest in straight lines: the distance falls and rises again, threshold 1 m."""
    rng = np.random.default_rng(10)
    t_s = np.arange(0.0, 4.0, 0.1)
    humans, execution = [], []
    for number in range(120):
        x = (t_s - 2.0 + rng.uniform(-0.05, 0.05)) * rng.uniform(0.9, 1.6)
        humans.append(np.column_stack([x, np.full_like(x, rng.uniform(0.5, 0.95)), np.zeros_like(x)]))
        execution.append(np.full(len(x), number // 3))
    human = np.concatenate(humans)
    level = (np.hypot(human[:, 0], human[:, 1]) >= 1.0).astype(np.int64)
    run = np.repeat(np.arange(120), len(t_s))
    seen = human + rng.normal(0.0, noise_m, human.shape) * [1, 1, 0]
    rows = RuleRows.made(np.zeros_like(human), seen, level, np.concatenate(execution), stretch=run)
    near = NearerCard(distance=TO_TCP, metres=MetresCard(value=1.02))
    return rows, (LimitCard(scaling=0.5, within=RegionCard(nearer=(near,))),)


def test_who_passes_at_an_angle_moves_no_threshold() -> None:
    rows, limits = passes(0.004)
    found, known = by_crossings(limits, rows, {0.5: 0, 1.0: 1})
    ((place, metres),) = quantities(found).items()
    assert place in known
    assert metres.value == pytest.approx(1.0, abs=0.0035)
    (both,) = crossings_of(limits, rows, {0.5: 0, 1.0: 1}).values()
    mean_of_two = np.concatenate([(rows.apart_m[TO_TCP][1:] + rows.apart_m[TO_TCP][:-1]) / 2])
    changed = (np.diff(rows.level) != 0) & (rows.before[1:] >= 0)
    assert mean_of_two[changed].mean() - 1.0 > abs(np.concatenate([each.value_m for each in both]).mean() - 1.0)


def test_a_change_is_measured_at_its_time_if_the_log_shows_that() -> None:
    rows, limits = passes(0.0)
    dated = np.full_like(rows.dated, np.nan)
    changes = np.flatnonzero((rows.before >= 0) & (rows.level != rows.level[rows.before]))
    for row in changes:
        one, other = rows.floor_m[row - 1], rows.floor_m[row]
        away = np.hypot(*(one + np.arange(0.0, 1.001, 0.08)[:, None] * (other - one)).T) >= 1.0
        part = 0.08 * int(np.flatnonzero(np.diff(away.astype(int)))[0]) if np.diff(away.astype(int)).any() else 0.92
        dated[row] = part, part + 0.08
    steps = {0.5: 0, 1.0: 1}
    plain, told = (crossings_of(limits, each, steps).popitem()[1] for each in (rows, replace(rows, dated=dated)))
    for before, after in zip(plain, told, strict=True):
        assert np.abs(after.value_m - 1.0).max() < 0.006
        assert np.abs(after.value_m - 1.0).mean() < 0.2 * np.abs(before.value_m - 1.0).mean()
        assert np.median(after.spread_m) < 0.4 * np.median(before.spread_m)


def test_where_nobody_crossed_noise_widens_the_interval_of_the_fit() -> None:
    rows, limits = passes(0.0)
    plain, wide = (
        next(
            iter(quantities(with_intervals(limits, rows, (0.5, 1.0), FAMILIES[TO_TCP], noise_m=each, seed=0)).values())
        )
        for each in (0.0, 0.02)
    )
    assert plain.low is not None
    assert wide.low is not None
    assert plain.low - wide.low == pytest.approx(1.96 * 0.02)
    known = frozenset(quantities(limits))
    assert with_intervals(limits, rows, (0.5, 1.0), FAMILIES[TO_TCP], known=known, seed=0) == limits


def test_a_change_within_a_long_time_of_unknown_level_tells_no_threshold() -> None:
    rows, limits = passes(0.0)
    held = replace(rows, sample=rows.sample + 8 * np.cumsum(np.diff(rows.level, prepend=rows.level[0]) > 0))
    every, dated = (crossings_of(limits, held, {0.5: 0, 1.0: 1}, dated=each).popitem()[1] for each in (False, True))
    assert len(every[1].value_m) > 100
    assert len(dated[1].value_m) == 0
    assert len(dated[0].value_m) == len(every[0].value_m)
