"""The median of few values is numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from cyclekit.segmentation.median import FEW, median


@given(
    arrays(
        np.float64, array_shapes(min_dims=1, max_dims=2, max_side=9), elements=st.floats(-1e9, 1e9) | st.just(np.nan)
    )
)
def test_the_median_of_few_is_that_of_numpy(values: np.ndarray):
    np.testing.assert_array_equal(median(values), np.median(values, axis=0))


@pytest.mark.parametrize("count", [1, 2, FEW - 1, FEW, FEW + 1])
def test_however_many_there_are(count: int):
    values = np.random.default_rng(count).normal(size=(count, 3))
    np.testing.assert_array_equal(median(values), np.median(values, axis=0))
