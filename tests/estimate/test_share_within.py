"""The share of cycles within the takt time, and its interval."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.estimate.statistics.distribution import CycleDistribution, wilson
from cyclekit.estimate.statistics.resample import drawn_errors, interval_of_mean

RNG = np.random.default_rng(4)
CYCLES_S = RNG.normal(60.0, 1.0, 400)
DRAWN = RNG.multinomial(40, np.full(400, 1 / 400), 300) / 40.0


@pytest.mark.parametrize("count", [3, 10, 40, 60, 97])
def test_the_interval_of_none_begins_at_none_and_that_of_all_ends_at_all(count: int) -> None:
    assert wilson(0.0, count)[0] == 0.0
    assert wilson(1.0, count)[1] == 1.0  # rounded, it was written "94 to over 99 %"
    assert 0.0 < wilson(0.5, count)[0] < 0.5 < wilson(0.5, count)[1] < 1.0


def test_the_interval_of_a_share_has_the_error_of_the_mean_in_each_resample() -> None:
    errors = drawn_errors(0.01, 40, 7, count=300)
    share, low, high = CycleDistribution(CYCLES_S, DRAWN, errors, 0.002).within(60.3)
    assert share == pytest.approx((CYCLES_S <= 60.3).mean(), abs=1 / 400)
    by_hand = [
        [DRAWN[row] @ (CYCLES_S * (1 + errors[row]) * (1 + off) <= 60.3) for row in range(300)]
        for off in (0.002, -0.002)
    ]
    assert np.allclose((low, high), (np.quantile(by_hand[0], 0.025), np.quantile(by_hand[1], 0.975)))


def test_without_an_error_only_the_resamples_count() -> None:
    plain = CycleDistribution(CYCLES_S, DRAWN, bias=0.002).within(60.3)
    assert np.allclose(CycleDistribution(CYCLES_S, DRAWN, np.zeros(300), 0.002).within(60.3), plain)
    wide = CycleDistribution(CYCLES_S, DRAWN, drawn_errors(0.01, 40, 7, count=300), 0.002).within(60.3)
    assert wide[1] < plain[1] < plain[2] < wide[2]


def test_the_errors_are_those_of_the_interval_of_the_mean() -> None:
    low, high = interval_of_mean(np.full(300, 60.0), model_error=0.01, judged=40, seed=7)
    drawn = 60.0 * (1.0 + drawn_errors(0.01, 40, 7, count=300))
    assert np.allclose((low, high), np.quantile(drawn, (0.025, 0.975)))


TIMES = st.lists(st.floats(1.0, 1e3), min_size=1, max_size=60)


@given(TIMES, st.floats(0.01, 0.99), st.floats(-5.0, 0.0), st.floats(0.0, 5.0))
def test_the_share_below_each_quantile_is_its_level(times: list[float], level: float, less: float, more: float) -> None:
    for cycles in (CycleDistribution(np.array(times)), CycleDistribution(np.array(times)).shifted(less, more)):
        at_s = cycles.quantile(level)
        assert cycles.share(np.nextafter(at_s, 0.0) - 1e-9) - 1e-9 <= level <= cycles.share(at_s + 1e-9) + 1e-9


@given(TIMES, st.floats(0.0, 1e3), st.floats(0.0, 0.99))
def test_an_interval_holds_its_share_and_what_is_possible_too(times: list[float], takt_s: float, sure: float) -> None:
    one = CycleDistribution(np.array(times), executions=len(times))
    other = CycleDistribution(np.array(times) * 1.2, executions=len(times))
    both = CycleDistribution(np.array(times), executions=len(times), also=(other,))
    share, low, high = one.within(takt_s, sure)
    assert 0.0 <= low <= share <= high <= 1.0
    least, most = both.within(takt_s, sure)[1:]
    assert least <= min(low, other.within(takt_s, sure)[1])
    assert most >= max(high, other.within(takt_s, sure)[2])


def test_a_shift_that_is_possible_widens_the_share_to_that_side() -> None:
    plain = CycleDistribution(CYCLES_S, executions=400)
    _, low, high = plain.within(60.5)
    _, least, most = plain.shifted(0.0, 1.0).within(60.5)
    assert least < low - 0.2
    assert most == pytest.approx(high, abs=0.05)
    assert plain.shifted(0.0, 1.0).quantile(0.95) == pytest.approx(plain.quantile(0.95) + 1.0)
