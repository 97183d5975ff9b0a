"""Whether a slow robot stands or creeps, by the noise and the resolution of the log's own positions.

A speed taken over a few rows tells nothing here: at 3 mm/s a log with a tenth of a millimetre of resolution repeats
most of its rows, and they read as standstill. So the question is how far the robot gets within a time in which a slow
motion leaves the noise behind.
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
"""A shorter standstill is not counted: the reversal of a path takes one or two controller cycles."""
MOVES_M_S = 5e-4
"""A robot at this speed or above moves: welding and gluing are slow. Below it, a standing robot settles or drifts."""
_SPAN = 8.0
"""A standing robot's positions spread over this many standard deviations of all axes together."""
AXES = 1.8
"""Each of the three axes may lie between two values: a standing robot's positions spread over so many quanta. A moving
one shows the same two values for twice as long at most."""
_HELD = 0.2
"""Positions have a quantum if at least this share of them repeats the one before; the noise is that of the quietest
such share of the log."""
SMOOTH_S = 0.04
"""Positions are averaged over this time first: noise, and what of it flips a quantum, is less then."""
_SAME_M = 1e-9
_ROWS, _WINDOW, _WINDOW_S = 20_000, 16, 0.25


class Stillness(NamedTuple):
    """Criterion of a standstill in a log.

    Attributes:
        reach_m: A standing robot's positions, averaged over SMOOTH_S, spread over no more than this.
        within_s: A moving robot gets farther than that within this time.
    """

    reach_m: float
    within_s: float

    def stretches(self, run: Run, first: int, last: int, lasts_s: float) -> list[tuple[int, int]]:
        """Return the first and last rows of the standstills in some slow rows, in order.

        Args:
            run: The run.
            first: First of the slow rows.
            last: Last of them, inclusive.
            lasts_s: How long they last; where that is less than twice `within_s`, half of it must do.
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
    """Return the criterion of a standstill in a run, from the noise of its positions where it is slow.

    Args:
        run: The run.
        slow: First and last rows of the stretches in which it is slow.
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
    """Return the standard deviation of the positions, all axes together: second differences have no steady motion."""
    seconds = [np.square(np.diff(xyz, 2, axis=0)).sum(axis=1) for xyz in parts]
    windows = [one[: len(one) // window * window].reshape(-1, window).mean(axis=1) for one in seconds]
    known = np.concatenate([*windows, np.empty(0)])
    known = known[np.isfinite(known)]
    return float(np.sqrt(np.quantile(known, _HELD) / 6.0)) if len(known) else 0.0


def quantum_of(steps_m: Vector) -> float:
    """Return the smallest usual step (N,) between unequal positions, m; 0 where positions hardly ever repeat."""
    steps = steps_m[np.isfinite(steps_m)]
    moved = steps[steps > _SAME_M]
    return float(np.quantile(moved, 0.05)) if 0 < len(moved) <= (1 - _HELD) * len(steps) else 0.0


def _within(xyz_m: Points, rows: int, smooth: int, reach_m: float) -> list[tuple[int, int]]:
    """Return the stretches whose rows all lie in a window of `rows` rows that spreads over no more than `reach_m`.

    Args:
        xyz_m: Positions, shape (T, 3), metres.
        rows: Rows of a window.
        smooth: Rows that are averaged first.
        reach_m: The reach.
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
    """Return the largest or smallest value of each window of `rows` rows, shape (T - rows + 1, D)."""
    reach = 1
    while 2 * reach <= rows:
        values = which(values[:-reach], values[reach:])
        reach *= 2
    rest = rows - reach
    return np.asarray(which(values[: len(values) - rest], values[rest:]))
