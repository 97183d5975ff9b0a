"""One cut of one value: no other cut leaves fewer samples on the wrong side."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.learning.rules.cuts import best_cut

SAMPLES = st.lists(
    st.tuples(st.integers(-20, 20).map(lambda n: n / 4), st.booleans(), st.integers(0, 3)), min_size=1, max_size=40
)


def wrong(cut: float, value: np.ndarray, slow: np.ndarray, weight: np.ndarray) -> float:
    return float(weight[(value < cut) != slow].sum())


@given(SAMPLES)
def test_no_other_cut_is_better(samples: list[tuple[float, bool, int]]) -> None:
    value, slow, weight = (np.array(part) for part in zip(*samples, strict=True))
    found = best_cut(value, slow, weight.astype(float))
    assert found.below < found.above
    others = [*(value - 0.125), *(value + 0.125)]
    least = min(wrong(cut, value, slow, weight) for cut in others)
    inside = found.above - 0.125 if np.isfinite(found.above) else found.below + 0.125
    assert wrong(inside, value, slow, weight) == least


@given(st.lists(st.floats(0.0, 5.0), min_size=2, max_size=50), st.floats(0.5, 4.5))
def test_without_noise_the_threshold_lies_within_its_bounds(apart: list[float], threshold_m: float) -> None:
    value = np.array(apart)
    found = best_cut(value, value < threshold_m, np.ones(len(value)))
    assert found.below < threshold_m <= found.above


def test_samples_without_anybody_move_no_threshold() -> None:
    value = np.array([0.5, 0.9, 1.1, np.inf, np.inf])
    assert best_cut(value, value < 1.0, np.ones(5)) == (0.9, 1.1)
    assert best_cut(value, value < 9.0, np.ones(5)).card() is None
