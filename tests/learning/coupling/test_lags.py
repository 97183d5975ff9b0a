"""max(own work, event + lag) is taken apart into what it was made of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from cyclekit.learning.coupling.conditions import lags
from cyclekit.learning.coupling.conditions.lags import FEW, deciding_causes, quantiles, reverse_kaplan_meier


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.floats(3.0, 4.5), st.floats(0.3, 1.5))
def test_own_work_and_lag_are_found_where_either_decides_some(seed: int, event_s: float, lag_s: float) -> None:
    """A later event than these decides most starts: the logs then hardly show the own work below it."""
    rng = np.random.default_rng(seed)
    own, lag = rng.lognormal(np.log(5.0 + lag_s), 0.15, 200), rng.gamma(9.0, lag_s / 9.0, 200)
    event = rng.normal(event_s, 2.0, 200)
    left = np.maximum(own, event + lag)
    causes = deciding_causes(np.array([left, left - event]))
    by_event = event + lag > own
    assert np.mean((causes.share[1] > 0.5) == by_event) > 0.7  # the two overlap
    assert causes.share.sum(axis=0) == pytest.approx(np.ones(200))
    for c, true in enumerate((own, lag)):
        since, decided = (left, left - event)[c], (causes.share.argmax(axis=0) == c) * 1.0
        found = quantiles(since, reverse_kaplan_meier(since, decided, np.ones(200, np.bool_)))
        assert np.median(found) == pytest.approx(np.median(true), abs=0.1 * np.median(own))


@given(st.lists(st.floats(0.1, 9.0), min_size=1, max_size=40))
def test_what_always_decided_has_the_distribution_that_was_logged(times: list[float]) -> None:
    at = np.array(times)
    mass = reverse_kaplan_meier(at, np.ones(len(at)), np.ones(len(at), np.bool_))
    assert mass == pytest.approx(np.full(len(at), 1.0 / len(at)))


def test_what_was_hidden_below_longer_times_counts_among_the_shorter_ones() -> None:
    """One of two below 3 s is seen at 1 s; the one that is hidden at 2 s counts there too."""
    at, decided = np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 1.0])
    assert reverse_kaplan_meier(at, decided, np.ones(3, np.bool_)) == pytest.approx([2 / 3, 0.0, 1 / 3])


@given(st.lists(st.floats(-5.0, 50.0), min_size=1, max_size=40))
def test_quantiles_ascend_within_what_was_seen(times: list[float]) -> None:
    at = np.array(times)
    found = quantiles(at, np.full(len(at), 1.0 / len(at)))
    assert list(found) == sorted(found)
    assert at.min() - 1e-3 <= found[0] <= found[-1] <= at.max() + 1e-3


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_unusual_time_of_many_is_drawn_as_seldom_as_it_was_seen(sign: float) -> None:
    """Drawn between the last two quantiles as they are, one of 600 would lengthen one in fifty."""
    at = sign * np.append(np.random.default_rng(0).uniform(5.0, 7.0, 599), 18.0)
    found = np.array(quantiles(at, np.full(600, 1.0 / 600)))
    drawn = np.interp(np.linspace(0.0, 1.0, 10_001), np.linspace(0.0, 1.0, len(found)), found)
    assert drawn.mean() == pytest.approx(at.mean(), abs=0.01)
    assert np.abs(drawn).max() < 9.0


def test_kernels_of_many_departures_are_not_kept() -> None:
    since_s = np.random.default_rng(0).uniform(0.1, 5.0, (2, FEW + 1))
    before = lags._remembered.cache_info()
    deciding_causes(since_s)
    assert lags._remembered.cache_info() == before
    deciding_causes(since_s[:, :FEW])
    assert lags._remembered.cache_info().misses > before.misses


def test_few_departures_that_were_answered_before_are_not_answered_again() -> None:
    since_s = np.random.default_rng(1).uniform(0.1, 5.0, (2, 6))
    first = deciding_causes(since_s)
    assert deciding_causes(since_s.copy()) is first
    assert deciding_causes(since_s.reshape(3, 4)).share.shape == (3, 4)
    assert not first.share.flags.writeable
    since_s[1, 0] = np.nan
    assert deciding_causes(since_s).share[1, 0] == 0.0


def test_a_time_counts_the_same_from_either_of_two_departures() -> None:
    """Kernels are computed for one of each pair."""
    times = np.array([1.0, 1.1, 3.0])
    found = lags._kernels(times.tobytes(), 0.2, 0.0)
    z = (times[:, None] - times[None, :]) / 0.2
    density = np.exp(-0.5 * z * z) / (0.2 * np.sqrt(2.0 * np.pi))
    assert found.density == pytest.approx(density - np.diag(np.diag(density)))
    assert found.below == pytest.approx(ndtr(z))
