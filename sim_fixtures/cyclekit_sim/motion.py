"""Robot motion at scaling 1: each move planned once, sampled finely in nominal time.

A move goes joint to joint between two places, time-optimal and jerk-limited. The safety function later stretches time
along these tables and never changes the path. `program` decides the order of moves.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from ruckig import InputParameter, Result, Ruckig, Trajectory

from cyclekit_sim.arm import Array, forward, jacobian, quaternion, reach
from cyclekit_sim.errors import SimulationError

Place = tuple[float, float, float]
# Default speed and acceleration of UR's movej (60 deg/s, 80 deg/s^2); the jerk is ours.
SPEED_RAD_S = 1.05
ACCELERATION_RAD_S2 = 1.4
JERK_RAD_S3 = 10.0
_GRID_S = 0.001


@dataclass(frozen=True)
class MotionTable:
    """All moves, stacked row by row (R rows, about 1 ms of nominal time apart).

    Attributes:
        q_rad: Joints (R, 6).
        qd_rad_s: Joint speeds at scaling 1 (R, 6).
        tcp_m: TCP position (R, 3), base frame.
        quaternion: TCP orientation x, y, z, w (R, 4).
        twist: TCP velocity at scaling 1, linear m/s and angular rad/s (R, 6).
        first_row: First row of the move of a (start, goal) pair.
        rows: Number of steps of that move; it has one row more.
        duration_s: Nominal duration of that move.
    """

    q_rad: Array
    qd_rad_s: Array
    tcp_m: Array
    quaternion: Array
    twist: Array
    first_row: dict[tuple[str, str], int]
    rows: dict[tuple[str, str], int]
    duration_s: dict[tuple[str, str], float]


def plan_moves(places: Mapping[str, Place], pairs: Iterable[tuple[str, str]]) -> MotionTable:
    """Plan the move of every (start, goal) pair of place names.

    Raises:
        SimulationError: A place is out of reach, or ruckig finds no motion.
    """
    wanted = sorted(set(pairs))
    first_row, rows, duration_s = {}, {}, {}
    parts: list[tuple[Array, ...]] = []
    at = 0
    for pair in wanted:
        *part, duration = _move(places[pair[0]], places[pair[1]])
        first_row[pair], rows[pair], duration_s[pair] = at, len(part[0]) - 1, duration
        at += len(part[0])
        parts.append(tuple(part))
    q_rad, qd_rad_s, tcp_m, turned, twist = (np.concatenate(column) for column in zip(*parts, strict=True))
    return MotionTable(q_rad, qd_rad_s, tcp_m, turned, twist, first_row, rows, duration_s)


@lru_cache(maxsize=256)
def _move(start: Place, goal: Place) -> tuple[Array, Array, Array, Array, Array, float]:
    """Return joints, joint speeds, TCP, orientation, twist and duration of one move.

    Computed per move, so that a move is bit-identical whatever other moves are planned; cached, because the next
    simulation of a scene uses the same moves.
    """
    q, qd, duration = _plan(_joints(start), _joints(goal))
    tcp_m, rotation = forward(q)
    return q, qd, tcp_m, quaternion(rotation), np.einsum("tij,tj->ti", jacobian(q), qd), duration


@lru_cache(maxsize=256)
def _joints(place: Place) -> Array:
    return reach(place)


def _plan(start: Array, goal: Array) -> tuple[Array, Array, float]:
    """Return joints and joint speeds of one move on an even grid that ends exactly at its end, and its duration."""
    task = InputParameter(6)
    task.current_position, task.target_position = start.tolist(), goal.tolist()
    task.max_velocity = [SPEED_RAD_S] * 6
    task.max_acceleration = [ACCELERATION_RAD_S2] * 6
    task.max_jerk = [JERK_RAD_S3] * 6
    path = Trajectory(6)
    result = Ruckig(6).calculate(task, path)
    if result not in (Result.Working, Result.Finished):
        raise SimulationError(f"no motion from joints {start.round(3)} to {goal.round(3)}: {result}")
    steps = max(2, int(np.ceil(path.duration / _GRID_S)))
    samples = [path.at_time(t)[:2] for t in np.linspace(0.0, path.duration, steps + 1)]
    q, qd = np.array([s[0] for s in samples]), np.array([s[1] for s in samples])
    qd[[0, -1]] = 0.0
    return q, qd, float(path.duration)
