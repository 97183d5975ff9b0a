"""The rate of a log: its median step, its mean rate, and the number of lost samples.

Rows per duration is not the rate if several people share a table, or if the log had gaps. So steps are computed per
person, and gaps are left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from cyclekit.schema import Vector


_GAP_PERIODS, _GAP_S = 5.0, 0.25
"""Minimum length of a gap: the larger of this many median steps and this time, s."""
ONE_INSTANT_S = 1e-6
"""Minimum step, s; closer time stamps count as one instant, since nothing in a cell is sampled faster."""
WHOLE_STEP_TOLERANCE, MIN_WHOLE_SHARE = 0.2, 0.8
"""Tolerance, as a share of the median step, and minimum share of steps that are whole multiples of it, to count lost
samples."""


def max_step_s(period_s: float | None) -> float:
    """Return the maximum step between rows without a gap, s; `period_s`: their median step, None = unknown."""
    return max(_GAP_PERIODS * (period_s or 0.0), _GAP_S)


class Rate(NamedTuple):
    """The rate of a table.

    Attributes:
        step_s: Median step.
        mean_hz: Steps per second, without gaps.
        lost: Number of samples missing between rows, without gaps; None if steps vary too much.
    """

    step_s: float
    mean_hz: float
    lost: int | None


class Rates:
    """Computes the rate of a table from its parts, in the order of the log."""

    def __init__(self) -> None:
        self._own, self._all = _Steps(), _Steps()
        self._last_s = np.nan
        self._last: pl.DataFrame | None = None  # last row of each person in the previous part

    def add(self, frame: pl.DataFrame) -> None:
        """Add a part: columns `t_s` and, for people, `person`."""
        if not frame.height:
            return
        times = frame["t_s"].to_numpy()
        steps = np.diff(times, prepend=self._last_s)
        self._last_s = float(times[-1])
        self._all.add(steps)
        if "person" not in frame.columns:
            return
        rows = frame.select("t_s", "person")
        rows = rows if self._last is None else pl.concat([self._last, rows])
        if rows["person"].n_unique() > 1:
            steps = rows.select(pl.col("t_s").diff().over("person")).to_series().drop_nulls().to_numpy()
        self._own.add(steps)
        self._last = rows.group_by("person").last().select("t_s", "person")

    def found(self) -> Rate | None:
        """Return the rate; None with fewer than two instants.

        If ids of people change too often to give steps, the steps of the whole table are used.
        """
        return (self._own if self._own.count >= 0.5 * self._all.count else self._all).rate()


class _Steps:
    """Statistics of one kind of steps."""

    def __init__(self) -> None:
        self.count, self._sum_s = 0, 0.0
        self._lost, self._whole_steps = 0.0, 0
        self._step_s: float | None = None

    def add(self, steps: Vector) -> None:
        steps = steps[steps >= ONE_INSTANT_S]  # drops NaN and negative steps, too
        if not len(steps):
            return
        usual = float(np.sort(steps)[(len(steps) - 1) // 2]) if self._step_s is None else self._step_s
        self._step_s = usual
        steps = steps[steps <= max_step_s(usual)]
        whole = np.rint(steps / usual)
        self.count += len(steps)
        self._sum_s += float(steps.sum())
        self._whole_steps += int((np.abs(steps / usual - whole) <= WHOLE_STEP_TOLERANCE).sum())
        self._lost += float(np.maximum(whole - 1.0, 0.0).sum())

    def rate(self) -> Rate | None:
        if self._step_s is None or not self.count:
            return None
        lost = round(self._lost) if self._whole_steps >= MIN_WHOLE_SHARE * self.count else None
        return Rate(self._step_s, self.count / self._sum_s, lost)
