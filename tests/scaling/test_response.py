"""What the safety function does in time, read from logs of cells whose latency, ramps and hysteresis are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.scaling.response import LATENCIES_S, Change, Changes, changes_of, read_dynamics

if TYPE_CHECKING:
    from simulated_cells import Cells

SLOW = {"latency_s": 0.2, "ramp_down_per_s": 2.5, "ramp_up_per_s": 1.0, "hysteresis_m": 0.1}


def test_latency_ramps_and_hysteresis_are_read_from_the_logs(cells: Cells):
    found = cells("pick-and-package", 4, **SLOW).dataset.card["dynamics"]
    assert found["latency_s"] == pytest.approx(0.2, abs=0.02)
    assert found["hysteresis_m"] == pytest.approx(0.1, abs=0.02)
    assert found["ramp_down_per_s"] == pytest.approx(2.5, rel=0.05)
    assert found["ramp_up_per_s"] == pytest.approx(1.0, rel=0.05)


def test_a_safety_system_that_reacts_at_once_has_no_latency_and_no_ramps(cells: Cells):
    found = cells("pick-and-package").dataset.card["dynamics"]
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
    found = read_dynamics([Changes.seen(changes, t_s, np.ones(1000))])
    assert (found.changes, found.latency_s, found.hysteresis_m) == (2, None, None)


def approaches(session_s: float, count: int = 40) -> tuple[list[Change], np.ndarray, np.ndarray]:
    """Return changes 0.3 s after an operator comes nearer than 1 m, every 10 s at another speed, and the distances."""
    t_s = session_s + np.arange(0.0, 10.0 * count, 0.1)
    passed_s = t_s - session_s
    distance_m = 1.0 + (0.5 + 0.1 * (passed_s // 10.0 % 7)) * (4.0 - passed_s % 10.0)
    crossed_s = session_s + 10.0 * np.arange(count) + 4.0
    return [Change(float(t) + 0.3, 0, False, None) for t in crossed_s], t_s, distance_m


def test_sessions_tell_together_what_one_is_too_short_for():
    (early, late) = (Changes.seen(*approaches(begin, 12)) for begin in (0.0, 3.0))  # their times overlap
    assert read_dynamics([early]).latency_s is None
    assert read_dynamics([early, late]).latency_s == pytest.approx(0.3)


def test_of_very_many_changes_some_are_looked_at_and_all_are_counted():
    seen = Changes.seen(*approaches(0.0, 500), most=100)
    assert seen.near_m.shape == (100, len(LATENCIES_S))
    found = read_dynamics([seen])
    assert (found.changes, found.latency_s) == (500, pytest.approx(0.3))


def test_an_unknown_scaling_ends_a_level():
    t_s = np.arange(600) / 125
    scaling = np.where(t_s < 2, 1.0, np.where(t_s < 2.2, np.nan, 0.5))
    (change,) = changes_of(t_s, scaling, (0.5, 1.0))
    assert change.rate_per_s is None
    assert changes_of(t_s, np.full(600, np.nan), (0.5, 1.0)) == []
