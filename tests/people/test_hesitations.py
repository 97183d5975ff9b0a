"""Short standstills of the operator: stops where he is always quick, hesitations elsewhere."""

from __future__ import annotations

import numpy as np

from cyclekit.config import Cell
from cyclekit.people.activity import OperatorStandstills, _standstills, operator_places
from cyclekit.people.hesitations import quick_places, without_hesitations

RATE_HZ = 20.0


def _day(stays: list[tuple[float, float]]) -> OperatorStandstills:
    """Stand at x for so many seconds, and walk from one to the next in 2 s, beginning and ending on the way."""
    times, at_m = [0.0], [-2.0]
    for x_m, took_s in stays:
        times += [times[-1] + 2.0, times[-1] + 2.0 + took_s]
        at_m += [x_m, x_m]
    times.append(times[-1] + 2.0)
    at_m.append(-2.0)
    t_s = np.arange(0.0, times[-1], 1.0 / RATE_HZ)
    x = np.interp(t_s, times, at_m)
    return _standstills(t_s, np.column_stack([x, 0.0 * x, 0.0 * x]), [])


def _kept(stays: list[tuple[float, float]]) -> list[float]:
    """Return the positions of the stays that count in the last of three executions."""
    usual = [(0.0, 1.0), (3.0, 4.0), (0.0, 1.1), (3.0, 5.0), (0.0, 1.2)]
    every = [_day(usual), _day(usual), _day(stays)]
    places = operator_places(every, Cell())
    found = without_hesitations(every[-1], places, quick_places(every, places))
    return np.round(found.at_m[:, 0], 1).tolist()


def test_a_short_stop_counts_where_most_stays_are_short() -> None:
    assert _kept([(0.0, 1.0), (3.0, 4.0), (0.0, 0.5), (3.0, 4.0)]) == [0.0, 3.0, 0.0, 3.0]


def test_a_short_stop_where_work_takes_long_is_a_hesitation() -> None:
    assert _kept([(0.0, 1.0), (3.0, 0.5), (0.0, 0.9), (3.0, 4.0)]) == [0.0, 0.0, 3.0]


def test_a_short_stop_elsewhere_is_no_place_and_a_very_short_one_is_none() -> None:
    assert _kept([(0.0, 1.0), (6.0, 0.6), (3.0, 4.0), (0.0, 0.2)]) == [0.0, 3.0]


def test_a_stop_that_the_end_of_the_log_cuts_counts_at_a_place_and_not_elsewhere() -> None:
    """It lasted at least so long; nobody knows how long."""
    stops = [0.0, 3.0, 5.0, 6.0, 8.0, 9.0, 11.0, 12.0, 14.0, 15.0, 17.0, 18.0, 20.0, 29.5, 30.0]
    t_s = np.arange(0.0, 30.0, 1.0 / RATE_HZ)
    for last_m, stays in ((3.0, 7), (6.0, 6)):  # at 20 s he turns and does not stop
        x = np.interp(t_s, stops, [0.0, 0.0, 3.0, 3.0, 0.0, 0.0, 3.0, 3.0, 0.0, 0.0, 3.0, 3.0, 0.0, last_m, last_m])
        mine = _standstills(t_s, np.column_stack([x, 0.0 * x, 0.0 * x]), [])
        places = operator_places([mine], Cell())
        assert mine.times_s[-1, 1] > 29.9
        assert len(without_hesitations(mine, places, ()).times_s) == stays
