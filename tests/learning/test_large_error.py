"""When the error of a model is large: held against its levels, and against always predicting the mean."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.cli.train import summary
from cyclekit.dataset.cards import MetricsCard, SplitCard, TrainingCard
from cyclekit.learning.networks.metrics import large_error

FIVE = (0.0, 0.25, 0.5, 0.75, 1.0)


def errors(mae: float, mse: float, constant: float | None = None) -> MetricsCard:
    return MetricsCard(rows=100, mse_mean=mse, mae=mae, bias=0.0, mse_constant=constant)


@pytest.mark.parametrize(
    ("mae", "mse", "levels", "said"),
    [
        (0.148, 0.03, FIVE, "more than half a step between its levels (0.125)"),
        (0.148, 0.05, (0.0, 1.0), "36 % of the variance of the speed scaling unexplained"),
        (0.09, 0.05, (), "36 % of the variance"),
        (0.0056, 8e-4, FIVE, ""),
        (0.10, 0.03, FIVE, ""),
    ],
)
def test_an_error_is_large_by_the_levels_or_by_what_it_leaves_unexplained(mae, mse, levels, said):
    found = large_error(errors(mae, mse, 0.138), levels)
    assert said in found
    assert bool(found) == bool(said)


@given(st.floats(0.01, 0.25), st.sampled_from([FIVE, (0.0, 0.5, 1.0), (), (0.0, 1.0)]))
def test_a_model_that_always_predicts_the_mean_has_a_large_error(variance, levels):
    found = large_error(errors(variance**0.5 / 2, variance, variance), levels)
    assert found


def test_a_card_without_the_error_of_the_mean_is_judged_by_its_levels_alone():
    assert large_error(errors(0.02, 0.09), FIVE) == ""
    assert large_error(errors(0.2, 0.09), FIVE)


def test_what_every_execution_served_for_is_told():
    split = SplitCard(train=("e",) * 29, validation=("e",) * 3, test=("e",) * 8)
    told = summary(TrainingCard(network="classifier", problem="now", levels=(), split=split, metrics=errors(0.1, 8e-4)))
    assert "40 executions: 29 for training, 3 for validation, 8 held out" in told
