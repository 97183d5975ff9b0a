"""Arrivals and departures that the tracker missed: the way takes as long as people walk."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.people.lost_edges import WALK_M_S, standstill_times
from cyclekit.people.tracks import find_operator_standstills

LEFT_S, CAME_S = 5.0, 5.0 + 3.0 / WALK_M_S


def _times(lost: tuple[float, float]) -> np.ndarray:
    """Return the standstills of who stands, walks 3 m from LEFT_S on, and stands again, lost for a while."""
    t_s = np.arange(0.0, 15.0, 0.1)
    human = np.column_stack([np.interp(t_s, [LEFT_S, CAME_S], [0.0, 3.0]), 0.0 * t_s, 0.0 * t_s + 1.0])
    human[(t_s > lost[0]) & (t_s < lost[1])] = np.nan
    return np.asarray(standstill_times(t_s, human[:, :2], find_operator_standstills(t_s, human)))


@pytest.mark.parametrize("lost", [(99.0, 99.0), (3.0, 6.0), (4.0, 7.0), (6.0, 9.0), (4.2, 8.6)])
def test_who_is_lost_as_he_goes_or_comes_walks_at_the_usual_speed(lost: tuple[float, float]) -> None:
    assert _times(lost) == pytest.approx(np.array([[0.0, LEFT_S], [CAME_S, 14.9]]), abs=0.25)


def test_who_is_lost_for_long_may_have_been_away() -> None:
    assert _times((2.0, 9.0))[:, 1][0] == pytest.approx(2.0, abs=0.2)
