"""Separate standstill from slow motion, by the noise and resolution of the logged positions.

Speed over a few rows is not sufficient: at 3 mm/s, a log with a resolution of 0.1 mm repeats most of its rows, which
look like a standstill. So the criterion is the distance covered within a time in which slow motion exceeds the noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cyclekit.segmentation.motion import lengths
from cyclekit.segmentation.stored_run import Run, pieces

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Points, Vector


MIN_STOP_S = 0.15
"""Minimum duration of a standstill, s: the reversal of a path takes one or two controller cycles."""
MOVES_M_S = 5e-4
"""Minimum speed of motion, m/s: welding and gluing are slow. Below it, a robot at standstill settles or drifts."""
_SPAN = 8.0
"""Maximum spread of positions at standstill, in standard deviations of all axes together."""
AXES = 1.8
"""Maximum spread of positions at standstill, in quanta: each of the three axes may flip between two values. In motion,
the same two values occur for at most twice as long."""
_HELD = 0.2
"""Minimum share of positions that repeat the one before for a quantum; share of the log, the quietest one, from which
the noise is computed."""
SMOOTH_S = 0.04
"""Averaging time of positions, s, which reduces noise and flips of quanta."""
_SAME_M = 1e-9
_ROWS, _WINDOW, _WINDOW_S = 20_000, 16, 0.25


class Stillness(NamedTuple):
    """Criterion of a standstill in a log.

    Attributes:
        reach_m: Maximum spread of positions at standstill, averaged over SMOOTH_S, m.
        within_s: Time within which a moving robot exceeds that spread, s.
    """

    reach_m: float
    within_s: float

    def stretches(self, run: Run, first: int, last: int, lasts_s: float) -> list[tuple[int, int]]:
        """Return the first and last rows of the standstills in some slow rows, in order.

        Args:
            run: The run.
            first: First slow row.
            last: Last slow row, inclusive.
            lasts_s: Duration of the slow rows; the window is at most half of it.
        """
        if lasts_s < MIN_STOP_S:
            return [(first, last)]
        window_s = min(self.within_s, max(MIN_STOP_S, lasts_s / 2))
        rows = min(max(int(np.ceil(window_s / run.period_s)) + 1, 3), last - first + 1)
        found: list[tuple[int, int]] = []
        for begin, part in pieces(run, first, last, overlap=rows - 1):
            for a, b in _within(part.xyz_m, rows, _smooth_rows(run), self.reach_m):
                if found and begin + a <= found[-1][1] + 1:
                    found[-1] = found[-1][0], max(found[-1][1], begin + b)
                else:
                    found.append((begin + a, begin + b))
        return found


def stillness_of(run: Run, slow: Sequence[tuple[int, int]]) -> Stillness:
    """Return the criterion of a standstill in a run, from the noise of its positions in slow parts.

    Args:
        run: The run.
        slow: First and last rows of its slow parts.
    """
    window = max(_WINDOW, round(_WINDOW_S / run.period_s))
    each = max(window + 2, _ROWS // max(1, len(slow)))
    parts = [run.window(a, min(b, a + each - 1)).xyz_m for a, b in slow if b - a > _WINDOW]
    steps = np.concatenate([*(lengths(np.diff(xyz, axis=0)) for xyz in parts), np.empty(0)])
    noise, quantum = _noise(parts, window) / np.sqrt(_smooth_rows(run)), quantum_of(steps)
    reach = max(0.7 * MOVES_M_S * (MIN_STOP_S - SMOOTH_S), _SPAN * noise + AXES * quantum)
    leaves_s = (1.5 * _SPAN * noise + 2 * AXES * quantum) / MOVES_M_S
    return Stillness(reach, max(MIN_STOP_S, leaves_s + SMOOTH_S))


def _smooth_rows(run: Run) -> int:
    return max(1, round(SMOOTH_S / run.period_s))


def _noise(parts: Sequence[Points], window: int) -> float:
    """Return the noise of positions, all axes together, m, from second differences (steady motion cancels)."""
    seconds = [np.square(np.diff(xyz, 2, axis=0)).sum(axis=1) for xyz in parts]
    windows = [one[: len(one) // window * window].reshape(-1, window).mean(axis=1) for one in seconds]
    known = np.concatenate([*windows, np.empty(0)])
    known = known[np.isfinite(known)]
    return float(np.sqrt(np.quantile(known, _HELD) / 6.0)) if len(known) else 0.0


def quantum_of(steps_m: Vector) -> float:
    """Return the quantum of positions from their steps (N,), m: the 5 % quantile; 0 if positions rarely repeat."""
    steps = steps_m[np.isfinite(steps_m)]
    moved = steps[steps > _SAME_M]
    return float(np.quantile(moved, 0.05)) if 0 < len(moved) <= (1 - _HELD) * len(steps) else 0.0


def _within(xyz_m: Points, rows: int, smooth: int, reach_m: float) -> list[tuple[int, int]]:
    """Return first and last rows of the parts covered by windows of `rows` rows with a spread of at most `reach_m`.

    Args:
        xyz_m: Positions, shape (T, 3), m.
        rows: Number of rows of a window.
        smooth: Number of rows that are averaged first.
        reach_m: Maximum spread, m.
    """
    if len(xyz_m) < rows:
        return []
    smooth = min(smooth, rows - 1)
    averaged = sliding_window_view(xyz_m, smooth, axis=0).mean(axis=-1) if smooth > 1 else xyz_m
    within = rows - smooth + 1
    spread = _extreme(averaged, within, np.fmax) - _extreme(averaged, within, np.fmin)
    still = lengths(spread) <= reach_m
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8))).reshape(-1, 2)
    found: list[tuple[int, int]] = []
    for a, b in (edges + np.array([0, rows - 2])).tolist():
        if found and a <= found[-1][1] + 1:
            found[-1] = found[-1][0], b
        else:
            found.append((a, b))
    return found


def _extreme(values: Points, rows: int, which: np.ufunc) -> Points:
    """Return the maximum or minimum of each window of `rows` rows, shape (T - rows + 1, D)."""
    reach = 1
    while 2 * reach <= rows:
        values = which(values[:-reach], values[reach:])
        reach *= 2
    rest = rows - reach
    return np.asarray(which(values[: len(values) - rest], values[rest:]))
