"""Detection of image landmarks by their values: depth relative to the hips, head at the top.

MediaPipe measures depth from the hip centre, in image landmarks and in world landmarks: one hip is as far in front of
it as the other is behind. No camera sees hips around its own lens, so such depths are not positions in a room.
`landmark_tables` handles the table formats.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

LANDMARKS = 33
_FACE, _SHOULDERS, _HIPS, _FEET = slice(0, 11), slice(11, 13), slice(23, 25), slice(27, 33)
_OPPOSITE, _MIN_SHARE = 0.15, 0.8
_PICTURE = (-1.0, 2.0)
"""Range of coordinates as fractions of the image, including what MediaPipe extrapolates outside of it."""
_MAX_VALUE = 1e9  # a larger number is garbled
_FEW = 3  # rows, of many numbers each
_LEAD, _TRAIL = 4, 1
"""Maximum number of columns before and after the landmarks: frame, time, label."""


def depths_around_hips(left: NDArray[np.float64], right: NDArray[np.float64]) -> bool:
    """Return whether the depths of two hips, shape (N,), are opposite in most rows, so relative to their centre."""
    size = np.abs(left) + np.abs(right)
    seen = np.isfinite(size) & (size > 0.0)
    return bool(seen.any() and np.mean((np.abs(left + right) <= _OPPOSITE * size)[seen]) >= _MIN_SHARE)


def in_picture(above: NDArray[np.float64], below: NDArray[np.float64]) -> bool:
    """Return whether heights, shape (N,), are above others in image fractions, with the vertical axis pointing down."""
    both = np.stack([above, below])
    seen = np.isfinite(both).all(axis=0) & both.any(axis=0)
    if not seen.any():
        return False
    inside = ((both > _PICTURE[0]) & (both < _PICTURE[1])).all(axis=0)
    return bool(np.mean((inside & (below - above > 0.02))[seen]) >= _MIN_SHARE)


def is_pose(points: NDArray[np.float64]) -> bool:
    """Return whether (N, 33, 2 to 4) are MediaPipe landmarks: by hip depths, or an upright person in an image."""
    if not len(points):
        return False
    if points.shape[2] == 2:
        heights = [points[:, part, 1].mean(axis=1) for part in (_FACE, _SHOULDERS, _HIPS, _FEET)]
        return all(in_picture(above, below) for above, below in pairwise(heights))
    hips = points[:, _HIPS, 2]
    sure = points.shape[2] == 3 or bool(((points[:, :, 3] >= 0.0) & (points[:, :, 3] <= 1.0)).all())
    return sure and _is_body(points[:, :, :3]) and depths_around_hips(hips[:, 0], hips[:, 1])


def _is_body(points: NDArray[np.float64]) -> bool:
    """Return whether (N, 33, 3) are bodies: small face, shoulders apart; on a path, consecutive points are close."""
    size = np.linalg.norm(np.ptp(points, axis=1), axis=1)
    face = np.linalg.norm(np.ptp(points[:, _FACE, :2], axis=1), axis=1)
    shoulders = np.linalg.norm(points[:, 11] - points[:, 12], axis=1)
    seen = size > 0.0
    return bool(seen.any() and np.mean(((face < 0.4 * size) & (shoulders > 0.05 * size))[seen]) >= _MIN_SHARE)


def may_be_nameless(width: int, rows: int) -> bool:
    """Return whether a table of this width and number of rows may hold landmarks without names."""
    wide = any(0 <= width - count * LANDMARKS <= _LEAD + _TRAIL for count in (4, 3, 2))
    return wide or (rows >= LANDMARKS and 3 <= width <= 4 + _LEAD)


def are_nameless_landmarks(rows: Sequence[Sequence[str]]) -> bool:
    """Return whether rows without a header are landmarks: 33 per row, or one in each of 33 rows."""
    width = len(rows[0])
    rows = rows[1:] if _are_counted(rows[0]) else rows
    if width <= 4 + _LEAD:
        stacked = as_numbers(rows[:LANDMARKS], range(width))
        return any(_are_poses(stacked[:, -count:], count) for count in (4, 3) if count <= width <= count + _LEAD)
    table = as_numbers(rows[:_FEW], range(width))
    for count in (4, 3, 2):
        spare = width - count * LANDMARKS
        for before in range(max(spare - _TRAIL, 0), min(spare, _LEAD) + 1):
            if _are_poses(table[:, before : before + count * LANDMARKS], count):
                return True
    return False


def _are_counted(cells: Sequence[str]) -> bool:
    """Return whether a row numbers its columns, as pandas does for columns without names."""
    numbers = [int(cell) for cell in cells if cell.isdecimal() and len(cell) < 10]
    return len(numbers) >= len(cells) - _TRAIL and numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def _are_poses(table: NDArray[np.float64], count: int) -> bool:
    """Return whether a table holds poses of `count` numbers per landmark; incomplete poses are ignored."""
    poses = table[: table.size // (LANDMARKS * count) * (LANDMARKS * count) // table.shape[1]]
    poses = poses.reshape(-1, LANDMARKS, count)
    return is_pose(poses[np.isfinite(poses).all(axis=(1, 2))])


def as_numbers(rows: Sequence[Sequence[str]], columns: Sequence[int]) -> NDArray[np.float64]:
    """Return cells as numbers, shape (N, C), NaN if empty or garbled; rows that are too short are dropped."""
    most = max(columns, default=0)
    table = [[_number(row[at]) for at in columns] for row in rows if len(row) > most]
    return np.array(table, dtype=np.float64).reshape(len(table), len(columns))


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return np.nan
    return value if abs(value) < _MAX_VALUE else np.nan
