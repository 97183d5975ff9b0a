"""The level of the logs: rollouts of logged orders take as long on average as these took, if nobody was logged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.estimate.operator.tracks import OperatorTracks
from cyclekit.estimate.validation.check import Check
from cyclekit.estimate.validation.log_level import LogLevel, log_level

if TYPE_CHECKING:
    from cyclekit.schema import Floats, Vector

NAMES = tuple(f"{number:03}" for number in range(40))


def tracks(names: tuple[str, ...] = NAMES) -> OperatorTracks:
    """Return one track for each execution."""
    count = len(names)
    return OperatorTracks(np.zeros((count, 2, 3)), np.zeros((count, 2), np.int64), (), np.full(count, 2), names, 0.1)


def cycles(seed: int, *, bias: float = 1.0, slow: float = 0.1) -> tuple[Vector, Floats]:
    """Return logged durations of 40 orders, (40,), and rolled-out ones with each operator, (40, 40), s."""
    rng = np.random.default_rng(seed)
    order_s, operator = rng.uniform(50.0, 70.0, 40), 1.0 + slow * rng.standard_normal(40)
    rolled = bias * order_s[:, None] * operator
    np.fill_diagonal(rolled, np.nan)
    return order_s * operator, rolled


@pytest.mark.parametrize("bias", [0.97, 1.0, 1.03])
def test_rollouts_are_brought_to_the_level_of_the_logs(bias: float) -> None:
    logged_s, rolled_s = cycles(1, bias=bias)
    level = log_level(NAMES, logged_s, rolled_s, NAMES)
    assert level is not None
    assert level.factor == pytest.approx(1.0 / bias, rel=2e-3)
    assert level.factor * np.nanmean(rolled_s, axis=1).sum() == pytest.approx(logged_s.sum())


def test_the_mean_then_varies_over_resamples_as_the_logged_durations_do() -> None:
    logged_s, rolled_s = cycles(2)
    level = log_level(NAMES, logged_s, rolled_s, NAMES)
    assert level is not None
    # Operators who are slow in the logs are slow in the rollout: the factor hardly varies.
    assert level.resampled(tracks(), 0).std() < 0.002
    # If the rollout shows all operators alike, only the factor shows how many slow ones were drawn.
    order_s, same_s = cycles(2, slow=0.0)
    alike = log_level(NAMES, logged_s, same_s, NAMES)
    assert alike is not None
    chance = float((logged_s / order_s).std()) / 40**0.5
    assert alike.resampled(tracks(), 0).std() == pytest.approx(chance, rel=0.15)


def test_several_tracks_of_an_execution_count_as_one_operator() -> None:
    logged_s, rolled_s = cycles(3)
    both = log_level(NAMES, logged_s, np.hstack([rolled_s, rolled_s]), (*NAMES, *NAMES))
    once = log_level(NAMES, logged_s, rolled_s, NAMES)
    assert both is not None
    assert once is not None
    assert both.slowness == pytest.approx(once.slowness)
    assert both.resampled(tracks((*NAMES, *NAMES)), 0) == pytest.approx(once.resampled(tracks(), 0))


def test_orders_that_never_ended_do_not_count() -> None:
    logged_s, rolled_s = cycles(4)
    rolled_s[5] = np.inf
    level = log_level(NAMES, logged_s, rolled_s, NAMES)
    assert level is not None
    assert NAMES[5] not in level.executions
    assert np.isfinite(level.resampled(tracks(), 0)).all()
    assert log_level(NAMES, logged_s, np.full((40, 40), np.inf), NAMES) is None


def test_a_validation_with_a_level_corrects_by_it() -> None:
    check = Check(40, 0, 0.0, 0.01, 0.02, 0.0, (0.0,) * 40, None, None, (0.05, 0.95))
    assert check.factor == 1.0
    known = replace(check, level=LogLevel(("a", "b"), (50.0, 54.0), (48.0, 52.0), (1.0, 1.0)))
    assert known.factor == pytest.approx(1.04)
    assert known.to_dict()["level"] == pytest.approx(1.04)
