"""What the safety function does in time, read from logs of cells whose latency, ramps and hysteresis are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.dynamics import changes_of, read_dynamics

if TYPE_CHECKING:
    from conftest import Cells

SLOW = {"latency_s": 0.2, "ramp_down_per_s": 2.5, "ramp_up_per_s": 1.0, "hysteresis_m": 0.1}


def test_latency_ramps_and_hysteresis_are_read_from_the_logs(cells: Cells):
    found = cells("pick-and-package", 6, **SLOW).dataset.card["dynamics"]
    assert found["latency_s"] == pytest.approx(0.2, abs=0.02)
    assert found["hysteresis_m"] == pytest.approx(0.1, abs=0.02)
    assert found["ramp_down_per_s"] == pytest.approx(2.5, rel=0.05)
    assert found["ramp_up_per_s"] == pytest.approx(1.0, rel=0.05)


def test_a_safety_system_that_reacts_at_once_has_no_latency_and_no_ramps(cells: Cells):
    found = cells("pick-and-package", 6).dataset.card["dynamics"]
    assert found["latency_s"] == pytest.approx(0.0, abs=0.02)
    assert found["hysteresis_m"] == pytest.approx(0.0, abs=0.02)
    assert (found["ramp_down_per_s"], found["ramp_up_per_s"]) == (None, None)


def test_where_distance_does_not_decide_latency_and_hysteresis_stay_unknown(cells: Cells):
    found = cells("laser-zones", 6).dataset.card["dynamics"]
    assert (found["latency_s"], found["hysteresis_m"]) == (None, None)


def test_few_changes_say_nothing():
    t_s = np.arange(1000) / 125
    scaling = np.where((t_s > 2) & (t_s < 4), 0.5, 1.0)
    changes = changes_of(t_s, scaling, (0.5, 1.0))
    assert [(change.step, change.rises, change.rate_per_s) for change in changes] == [(0, False, None), (0, True, None)]
    assert changes[0].t_s == pytest.approx(2.0)
    found = read_dynamics(changes, t_s, np.ones(1000))
    assert (found.changes, found.latency_s, found.hysteresis_m) == (2, None, None)


def test_an_unknown_scaling_ends_a_level():
    t_s = np.arange(600) / 125
    scaling = np.where(t_s < 2, 1.0, np.where(t_s < 2.2, np.nan, 0.5))
    (change,) = changes_of(t_s, scaling, (0.5, 1.0))
    assert change.rate_per_s is None
    assert changes_of(t_s, np.full(600, np.nan), (0.5, 1.0)) == []
