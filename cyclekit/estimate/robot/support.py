"""Support: whether positions lie near logged ones.

The learned safety function is valid only for pairs of robot and operator positions that were logged. Logged pairs fill
cells of space; support is the share of a rolled-out cycle that runs through filled cells.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.unknown_height import is_flat

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Floats, Ints

ROBOT_M = 0.15
"""Edge of a cell of robot positions, m."""
HUMAN_M = 0.3
"""Edge of a cell of operator positions, m."""


class Support:
    """Cells of (x_r, x_h) that contain logged samples."""

    def __init__(self, robot_m: Floats, human_m: Floats) -> None:
        """Compute the cells of logged positions, shapes (N, 3) and (N, 3), m; rows with NaN are left out."""
        human_m = _on_one_level(human_m)
        known = np.isfinite(robot_m.sum(axis=1) + human_m.sum(axis=1))
        cells = _cells(robot_m, human_m) if known.all() else _cells(robot_m[known], human_m[known])
        self._filled = np.unique(cells[np.diff(cells, prepend=-1) != 0])  # most samples lie where the last one did

    def near_logged(self, robot_m: Floats, human_m: Floats) -> Bools:
        """Return which pairs of positions, shapes (N, 3) and (N, 3), lie in logged cells, shape (N,).

        A pair without an operator (NaN) counts as logged: the robot then runs at full speed.
        """
        human_m = _on_one_level(human_m)
        absent = ~np.isfinite(human_m).all(axis=1)
        if not len(self._filled):
            return np.asarray(absent)
        asked = _cells(robot_m, np.nan_to_num(human_m))
        at = np.minimum(np.searchsorted(self._filled, asked), len(self._filled) - 1)
        return np.asarray(absent | (self._filled[at] == asked))


def _on_one_level(human_m: Floats) -> Floats:
    """Return positions with height 0 wherever it is unknown: the cells are then those of the floor."""
    flat = is_flat(human_m)
    if not flat.any():
        return human_m
    human_m = human_m.copy()
    human_m[flat, 2] = 0.0
    return human_m


def _cells(robot_m: Floats, human_m: Floats) -> Ints:
    """Pack six cell indices of 10 bits each; unique within +-77 m (robot) and +-153 m (operator)."""
    packed = np.zeros(len(robot_m), dtype=np.int64)
    for positions, edge_m in ((robot_m, ROBOT_M), (human_m, HUMAN_M)):
        for axis in range(3):
            index = np.floor(positions[:, axis] / edge_m).astype(np.int64)
            packed = (packed << 10) | ((index + 512) & 1023)
    return packed
