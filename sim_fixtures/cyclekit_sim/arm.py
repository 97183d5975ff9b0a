"""The arm, a UR5e by its public Denavit-Hartenberg parameters: joint angles to TCP and back.

The TCP is the flange (no tool offset), so a log can be checked with the same parameters. `motion` plans the joints over
time.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.errors import SimulationError

Array: TypeAlias = NDArray[np.float64]

JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
_D_M = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
_A_M = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
_ALPHA_RAD = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)


def link_frames(q_rad: Array) -> tuple[Array, Array, Array]:
    """Return origins (7, T, 3) in m, z axes (7, T, 3) and TCP rotation (T, 3, 3) for joints `q_rad` (T, 6)."""
    count = len(q_rad)
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
    origin = np.zeros((count, 3))
    origins, axes = [origin], [rotation[:, :, 2]]
    for joint in range(6):
        c, s = np.cos(q_rad[:, joint]), np.sin(q_rad[:, joint])
        ca, sa = np.cos(_ALPHA_RAD[joint]), np.sin(_ALPHA_RAD[joint])
        link = np.zeros((count, 3, 3))
        link[:, 0, 0], link[:, 0, 1], link[:, 0, 2] = c, -s * ca, s * sa
        link[:, 1, 0], link[:, 1, 1], link[:, 1, 2] = s, c * ca, -c * sa
        link[:, 2, 1], link[:, 2, 2] = sa, ca
        offset = np.stack([_A_M[joint] * c, _A_M[joint] * s, np.full(count, _D_M[joint])], axis=1)
        origin = origin + np.einsum("tij,tj->ti", rotation, offset)
        rotation = rotation @ link
        origins.append(origin)
        axes.append(rotation[:, :, 2])
    return np.stack(origins), np.stack(axes), rotation


def forward(q_rad: Array) -> tuple[Array, Array]:
    """Return the TCP position (T, 3) in m and its rotation (T, 3, 3) in the base frame, for joints (T, 6) in rad."""
    origins, _, rotation = link_frames(q_rad)
    return origins[-1], rotation


def jacobian(q_rad: Array) -> Array:
    """Return the geometric Jacobian (T, 6, 6): rows linear then angular velocity, columns joints."""
    origins, axes, _ = link_frames(q_rad)
    linear = np.cross(axes[:6], origins[6] - origins[:6])
    return np.concatenate([linear, axes[:6]], axis=2).transpose(1, 2, 0)


def reach(tcp_m: tuple[float, float, float]) -> Array:
    """Return the joints (6,), rad, that put the TCP at `tcp_m` with the tool pointing down, elbow up.

    The tool turns with the direction from base to place, so that all places share one arm branch and motions between
    them stay short.

    Raises:
        SimulationError: The place is out of reach.
    """
    target = np.array(tcp_m)
    heading = np.arctan2(tcp_m[1], tcp_m[0])
    c, s = np.cos(heading), np.sin(heading)
    wanted = np.array([[s, -c, 0.0], [-c, -s, 0.0], [0.0, 0.0, -1.0]])
    q = np.array([heading, -np.pi / 2, -np.pi / 2, -np.pi / 2, np.pi / 2, 0.0])
    for _ in range(200):
        position, rotation = forward(q[None])
        turn = 0.5 * np.cross(rotation[0].T, wanted.T).sum(axis=0)
        error = np.concatenate([target - position[0], turn])
        if np.abs(error).max() < 1e-12:
            return np.asarray(q)
        j = jacobian(q[None])[0]
        step = j.T @ np.linalg.solve(j @ j.T + 1e-8 * np.eye(6), error)
        q = q + np.clip(step, -0.2, 0.2)
    raise SimulationError(f"place {tcp_m} is out of the arm's reach (0.85 m): move it nearer to the base")


def quaternion(rotation: Array) -> Array:
    """Return unit quaternions x, y, z, w (T, 4) of rotations (T, 3, 3), without sign changes along the series."""
    m = rotation
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    squares = np.stack([2 * m[:, i, i] - trace for i in range(3)] + [trace], axis=1) + 1.0
    big = np.argmax(squares, axis=1)
    skew = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=1)
    outer = np.zeros((len(m), 4, 4))
    outer[:, :3, :3] = m + m.transpose(0, 2, 1)
    outer[:, :3, 3] = outer[:, 3, :3] = skew
    outer[:, range(4), range(4)] = squares
    q = outer[np.arange(len(m)), big]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    flips = np.cumprod(np.where(np.einsum("ti,ti->t", q[1:], q[:-1]) < 0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    return np.asarray(q)


def rotation_vector(quaternions: Array) -> Array:
    """Return rotation vectors (T, 3), rad, of unit quaternions x, y, z, w (T, 4); angles in [0, pi]."""
    q = np.where(quaternions[:, 3:] < 0, -quaternions, quaternions)
    sine = np.linalg.norm(q[:, :3], axis=1)
    angle = 2 * np.arctan2(sine, q[:, 3])
    scale = np.divide(angle, sine, out=np.full_like(angle, 2.0), where=sine > 1e-12)
    return np.asarray(q[:, :3] * scale[:, None])
