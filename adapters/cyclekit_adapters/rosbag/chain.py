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
from cyclekit_adapters.rosbag.transforms import Array, FrameTransforms, Step

NEAR_S = 0.5
"""Maximum time, s, between a moving transform and the requested time; at least two of its periods."""


def leading(way: Sequence[Step]) -> FrameTransforms:
    """Return the link whose times are used for the tool: the one published most often."""
    return max((step.link for step in way), key=lambda link: link.times.size)


def followed(way: Sequence[Step], at_s: Array) -> tuple[Array, Array]:
    """Return position and rotation of the frame at the end of a chain, relative to its start.

    Args:
        way: Links from the first frame to the last; empty if both are the same.
        at_s: Times, shape (T,), s.

    Returns:
        Positions, shape (T, 3), m, and rotations, shape (T, 4); NaN where a link is unknown.
    """
    place, turn = np.zeros((at_s.size, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (at_s.size, 1))
    for step in way:
        pose = _pose(step.link, at_s)
        move, rotation = pose[:, :3], pose[:, 3:]
        if step.back:
            rotation = rotation * [-1.0, -1.0, -1.0, 1.0]
            move = -rotate(rotation, move)
        place = place + rotate(turn, move)
        turn = _multiply(turn, rotation)
    return place, turn


def brought(way: Sequence[Step], at_s: Array, places: Array) -> Array:
    """Transform positions from the frame at the end of a chain to the frame at its start.

    Args:
        way: Links from the first frame to the last.
        at_s: Time of each row, shape (T,), s.
        places: Positions, shape (T, 3) or (T, K, 3), m; NaN stays NaN.
    """
    place, turn = followed(way, at_s)
    if places.ndim == 2:
        return place + rotate(turn, places)
    count = places.shape[1]
    flat = rotate(np.repeat(turn, count, axis=0), places.reshape(-1, 3))
    return place[:, None, :] + flat.reshape(places.shape)


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


def rotate(turn: Array, move: Array) -> Array:
    """Return vectors (T, 3) rotated by quaternions (T, 4)."""
    axis, scalar = turn[:, :3], turn[:, 3:]
    twice = 2.0 * np.cross(axis, move)
    rotated: Array = move + scalar * twice + np.cross(axis, twice)
    return rotated


def _multiply(first: Array, second: Array) -> Array:
    a, u = first[:, 3:], first[:, :3]
    b, v = second[:, 3:], second[:, :3]
    return np.hstack([a * v + b * u + np.cross(u, v), a * b - np.sum(u * v, axis=1, keepdims=True)])
