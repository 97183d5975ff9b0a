"""The share of cycles within the takt time, and its interval."""

from __future__ import annotations

import numpy as np

from cyclekit.estimate.statistics.resample import drawn_errors, interval_of_mean, share_within

RNG = np.random.default_rng(4)
CYCLES_S = RNG.normal(60.0, 1.0, 400)
DRAWN = RNG.multinomial(40, np.full(400, 1 / 400), 300) / 40.0


def test_the_interval_of_a_share_has_the_error_of_the_mean_in_each_resample() -> None:
    errors = drawn_errors(0.01, 40, 7, count=300)
    share, low, high = share_within(CYCLES_S, 60.3, DRAWN, bias=0.002, errors=errors)
    assert share == (CYCLES_S <= 60.3).mean()
    by_hand = [
        [DRAWN[row] @ (CYCLES_S * (1 + errors[row]) * (1 + off) <= 60.3) for row in range(300)]
        for off in (0.002, -0.002)
    ]
    assert np.allclose((low, high), (np.quantile(by_hand[0], 0.025), np.quantile(by_hand[1], 0.975)))


def test_without_an_error_only_the_resamples_count() -> None:
    plain = share_within(CYCLES_S, 60.3, DRAWN, bias=0.002)
    assert np.allclose(share_within(CYCLES_S, 60.3, DRAWN, bias=0.002, errors=np.zeros(300)), plain)
    wide = share_within(CYCLES_S, 60.3, DRAWN, bias=0.002, errors=drawn_errors(0.01, 40, 7, count=300))
    assert wide[1] < plain[1] < plain[2] < wide[2]


def test_the_errors_are_those_of_the_interval_of_the_mean() -> None:
    low, high = interval_of_mean(np.full(300, 60.0), model_error=0.01, judged=40, seed=7)
    drawn = 60.0 * (1.0 + drawn_errors(0.01, 40, 7, count=300))
    assert np.allclose((low, high), np.quantile(drawn, (0.025, 0.975)))
