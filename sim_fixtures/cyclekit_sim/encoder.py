"""Controller measurements of its own motion: joints read by imperfect encoders.

The noise is that of a real UR5 in motion: third differences of its logged joint angles at 125 Hz show 2e-5 rad
(standard deviation) at base, shoulder and elbow, and 1e-4 rad at the wrists. Position, orientation and velocity of the
TCP are computed from the measured joints, as in the controller. The truth is unchanged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cyclekit_sim.arm import forward, jacobian, quaternion
from cyclekit_sim.session import RobotStates

_WRISTS = np.array([1.0, 1.0, 1.0, 5.0, 5.0, 5.0])
_SPEED_PER_S = 20.0  # 1/s, ratio of speed noise to angle noise: controllers filter their differences
_ROWS = 1 << 16  # rows per block


def measured(robot: RobotStates, noise_rad: float, rng: np.random.Generator) -> RobotStates:
    """Return the robot as measured by its encoders; `noise_rad` is the standard deviation at the big joints."""
    if noise_rad <= 0:
        return robot
    spread = noise_rad * _WRISTS
    q_rad = robot.q_rad + rng.normal(0.0, spread, robot.q_rad.shape)
    qd_rad_s = robot.qd_rad_s + rng.normal(0.0, _SPEED_PER_S * spread, robot.qd_rad_s.shape)
    tcp_m, turned, twist = np.empty_like(robot.tcp_m), np.empty_like(robot.quaternion), np.empty_like(robot.twist)
    for begin in range(0, len(q_rad), _ROWS):
        rows = slice(begin, begin + _ROWS)
        tcp_m[rows], rotation = forward(q_rad[rows])
        turned[rows] = quaternion(rotation)
        twist[rows] = np.einsum("tij,tj->ti", jacobian(q_rad[rows]), qd_rad_s[rows])
    return replace(robot, q_rad=q_rad, qd_rad_s=qd_rad_s, tcp_m=tcp_m, quaternion=turned, twist=twist)
