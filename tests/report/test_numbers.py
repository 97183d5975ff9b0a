from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.report import numbers


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e4))
def test_a_rounded_mean_stays_well_inside_its_interval(mean, half):
    text, interval = numbers.with_uncertainty(mean, mean - half, mean + half)
    shown = float(text.replace("−", "-"))
    assert abs(shown - mean) <= max(0.51 * half, 0.0006)
    low, high = (float(part.replace("−", "-")) for part in interval.split(" to "))
    assert low <= high


@given(st.one_of(st.sampled_from([None, math.nan, math.inf, -math.inf]), st.floats(-1e15, 1e15)))
def test_no_number_is_ever_written_as_nan(value):
    for write in (numbers.seconds, numbers.percent, numbers.significant):
        text = write(value)
        assert "nan" not in text
        assert "inf" not in text
        assert "e+" not in text


@pytest.mark.parametrize(
    ("half", "decimals"), [(0.6, 1), (0.19, 2), (0.2, 1), (1.5, 1), (3.0, 0), (17.0, 0), (40.0, -1), (0.0, 2)]
)
def test_decimals_follow_the_uncertainty(half, decimals):
    assert numbers.decimals_for(half) == decimals
