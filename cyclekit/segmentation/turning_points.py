"""Where a robot that never rests turns: places for a program without a dwell.

A program that goes from one position to the next without blending stops at each of them, for no longer than a row or
two of its log. Where a robot rests at places these are waypoints on its way; where it rests at one place at most they
are all that divides its motion. Places at which it rests are the business of `places`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.segmentation.motion import RobotRun, pieces
from cyclekit.segmentation.places import MERGE_M, cluster
from cyclekit.segmentation.standstills import Stop

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.segmentation.motion import Run


SLOW = 0.1
"""At a turn the robot is slower than this fraction of its usual speed."""
APART_S = 0.5
"""Of slow rows nearer than this to each other the slowest is the turn."""


def with_turns(runs: Sequence[Run], stops: Sequence[Stop]) -> list[Stop]:
    """Return the stops, and the turns of runs that turn or stand at a spot more than once, in order.

    Args:
        runs: All runs.
        stops: Their standstills.
    """
    turns = [
        Stop(number, row, row, xyz, free=True)
        for number, run in enumerate(runs)
        for begin, part in pieces(run)
        for row, xyz in _turns(begin, part)
    ]
    both = [*stops, *turns]
    xyz = np.array([stop.xyz_m for stop in both]).reshape(-1, 3)
    again = {i for group in cluster(xyz, np.arange(len(both)), MERGE_M) if len(group) > 1 for i in group.tolist()}
    kept = [stop for i, stop in enumerate(both) if i < len(stops) or i in again]
    return sorted(kept, key=lambda stop: (stop.run, stop.first))


def _turns(begin: int, part: RobotRun) -> list[tuple[int, tuple[float, float, float]]]:
    """Return the rows at which speed falls nearly to zero and rises again at once, and where."""
    speed = part.speed_m_s
    usual = float(np.nanquantile(speed, 0.9)) if np.isfinite(speed).any() else 0.0
    slow = np.flatnonzero(speed < SLOW * usual)
    groups = np.split(slow, np.flatnonzero(np.diff(part.t_s[slow]) > APART_S) + 1) if len(slow) else []
    found = []
    for rows in groups:
        if rows[0] == 0 or rows[-1] == part.rows - 1 or part.t_s[rows[-1]] - part.t_s[rows[0]] > APART_S:
            continue  # it stood: that is no turn
        row = int(rows[int(speed[rows].argmin())])
        x, y, z = (float(value) for value in part.xyz_m[row])
        found.append((begin + row, (x, y, z)))
    return found
