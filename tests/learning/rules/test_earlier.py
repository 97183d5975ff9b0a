"""Values at an earlier time: interpolated within a stretch, flagged before its start."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.learning.rules.samples.earlier import earlier

T_S = np.array([0.0, 0.1, 0.2, 0.2, 0.3, 0.4])
RUN = np.array([0, 0, 0, 1, 1, 1])
VALUES = np.array([1.0, 2.0, 4.0, 10.0, 30.0, 70.0])


def test_values_are_interpolated_within_each_stretch() -> None:
    found, early = earlier(VALUES, T_S, RUN, 0.05)
    assert found[[1, 2, 4, 5]] == pytest.approx([1.5, 3.0, 20.0, 50.0])
    assert early.tolist() == [True, False, False, True, False, False]


@pytest.mark.parametrize("by_s", [0.1, 0.2, 0.3])
def test_a_time_of_a_sample_gives_its_value_whatever_is_next_to_it(by_s: float) -> None:
    t_s = 1000.0 + np.arange(50) / 10
    values = np.where(np.arange(50) % 2 == 0, np.nan, np.arange(50))
    found, early = earlier(values, t_s, np.full(50, 7), by_s)
    shift = round(10 * by_s)
    assert early.tolist() == [True] * shift + [False] * (50 - shift)
    assert found[shift:] == pytest.approx(values[:-shift], nan_ok=True)


def test_a_time_at_the_start_of_a_stretch_is_known_whatever_the_stretch_before_holds() -> None:
    values = np.column_stack([VALUES, np.where(RUN == 0, np.nan, VALUES)])
    found, early = earlier(values, T_S, RUN, 0.125)
    assert early.tolist() == [True, True, False, True, True, False]
    assert found[5] == pytest.approx([25.0, 25.0])
    found, early = earlier(values, np.array([0.0, 0.25, 0.5, 0.5, 0.75, 1.0]), RUN, 0.25)
    assert early.tolist() == [True, False, False, True, False, False]
    assert found[4] == pytest.approx([10.0, 10.0])
