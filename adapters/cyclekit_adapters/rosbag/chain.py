"""Pose at the end of a chain of transforms, over time.

Static links are used as they are. Moving links are looked up at the requested times, by the nearest message, and only
if it is close enough: after a gap in publication the pose is unknown. Positions are in m; rotations are quaternions x,
y, z, w.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cyclekit_adapters.rosbag.envelope import middle
from cyclekit_adapters.rosbag.transforms import Array, FrameTransforms, Link

NEAR_S = 0.5
"""Maximum time, s, between a moving transform and the requested time; at least two of its periods."""


def reference_link(chain: Sequence[Link]) -> FrameTransforms:
    """Return the link whose times are used for the tool: the one published most often."""
    return max((link.transforms for link in chain), key=lambda transforms: transforms.times.size)


def pose_along(chain: Sequence[Link], at_s: Array) -> tuple[Array, Array]:
    """Return position and rotation of the frame at the end of a chain, relative to its start.

    Args:
        chain: Links from the first frame to the last; empty if both are the same.
        at_s: Times, shape (T,), s.

    Returns:
        Positions, shape (T, 3), m, and rotations, shape (T, 4); NaN where a link is unknown.
    """
    position, rotation = np.zeros((at_s.size, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (at_s.size, 1))
    for link in chain:
        pose = _pose(link.transforms, at_s)
        offset, turn = pose[:, :3], pose[:, 3:]
        if link.inverse:
            turn = turn * [-1.0, -1.0, -1.0, 1.0]
            offset = -rotate(turn, offset)
        position = position + rotate(rotation, offset)
        rotation = _multiply(rotation, turn)
    return position, rotation


def transformed(chain: Sequence[Link], at_s: Array, positions: Array) -> Array:
    """Transform positions from the frame at the end of a chain to the frame at its start.

    Args:
        chain: Links from the first frame to the last.
        at_s: Time of each row, shape (T,), s.
        positions: Positions, shape (T, 3) or (T, K, 3), m; NaN stays NaN.
    """
    origin, rotation = pose_along(chain, at_s)
    if positions.ndim == 2:
        return origin + rotate(rotation, positions)
    count = positions.shape[1]
    flat = rotate(np.repeat(rotation, count, axis=0), positions.reshape(-1, 3))
    return origin[:, None, :] + flat.reshape(positions.shape)


def _pose(link: FrameTransforms, at_s: Array) -> Array:
    """Return the pose of a link at some times, shape (T, 7), with unit quaternions; NaN where unknown."""
    if link.is_still():
        pose: Array = np.repeat(link.pose[:1], at_s.size, axis=0)
    else:
        rows = _nearest(link.times, at_s)
        pose = link.pose[rows].copy()
        period = middle(np.diff(np.sort(link.times)))
        pose[np.abs(link.times[rows] - at_s) > max(NEAR_S, 2.0 * period)] = np.nan
    with np.errstate(invalid="ignore"):
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    return pose


def _nearest(times: Array, wanted: Array) -> npt.NDArray[np.int64]:
    order = np.argsort(times, kind="stable")
    ordered = times[order]
    after = np.clip(np.searchsorted(ordered, wanted), 0, ordered.size - 1)
    before = np.clip(after - 1, 0, ordered.size - 1)
    closer = np.abs(ordered[before] - wanted) <= np.abs(ordered[after] - wanted)
    chosen: npt.NDArray[np.int64] = order[np.where(closer, before, after)]
    return chosen


def rotate(rotation: Array, vectors: Array) -> Array:
    """Return vectors (T, 3) rotated by quaternions (T, 4)."""
    axis, scalar = rotation[:, :3], rotation[:, 3:]
    twice = 2.0 * np.cross(axis, vectors)
    rotated: Array = vectors + scalar * twice + np.cross(axis, twice)
    return rotated


def _multiply(first: Array, second: Array) -> Array:
    a, u = first[:, 3:], first[:, :3]
    b, v = second[:, 3:], second[:, :3]
    return np.hstack([a * v + b * u + np.cross(u, v), a * b - np.sum(u * v, axis=1, keepdims=True)])
