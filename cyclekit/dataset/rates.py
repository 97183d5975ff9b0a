"""How fast a log was written: the usual step, the rate on average, and the samples that it lost.

Rows over duration are no rate where several people share a table, nor where the log was silent for a while. So steps
are those from one row of a person to the next one of the same person, and silences are left out of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from cyclekit.schema import Vector


GAP_PERIODS, GAP_S = 5.0, 0.25
"""A silence is a gap when it is longer than both: five usual steps, and a quarter of a second."""
ONE_INSTANT_S = 1e-6
"""Nothing in a cell is sampled faster: stamps nearer than this to each other are of one instant."""
EVEN, MOSTLY = 0.2, 0.8
"""Samples can be counted as lost where this many of the steps are whole multiples of the usual one, to within EVEN."""


class Rate(NamedTuple):
    """The rate of a table.

    Attributes:
        step_s: Median step.
        mean_hz: Steps a second, gaps left out.
        lost: Samples missing between rows, gaps left out; None where steps are of any length.
    """

    step_s: float
    mean_hz: float
    lost: int | None


class Rates:
    """Takes in a table part after part, in the order of the log."""

    def __init__(self) -> None:
        self._own, self._all = _Steps(), _Steps()
        self._last_s = np.nan
        self._last: pl.DataFrame | None = None  # the last row of each person in the part before

    def add(self, frame: pl.DataFrame) -> None:
        """Take in a part: columns `t_s` and, of people, `person`."""
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
        """Return the rate; None below two instants.

        Where ids of people do not last they have no steps of their own, and the instants of the table count.
        """
        return (self._own if self._own.count >= 0.5 * self._all.count else self._all).rate()


class _Steps:
    """Steps of one kind, counted."""

    def __init__(self) -> None:
        self.count, self._sum_s = 0, 0.0
        self._lost, self._even = 0.0, 0
        self._step_s: float | None = None

    def add(self, steps: Vector) -> None:
        steps = steps[steps >= ONE_INSTANT_S]  # NaN and steps back are none
        if not len(steps):
            return
        usual = float(np.sort(steps)[(len(steps) - 1) // 2]) if self._step_s is None else self._step_s
        self._step_s = usual
        steps = steps[steps <= max(GAP_PERIODS * usual, GAP_S)]
        whole = np.rint(steps / usual)
        self.count += len(steps)
        self._sum_s += float(steps.sum())
        self._even += int((np.abs(steps / usual - whole) <= EVEN).sum())
        self._lost += float(np.maximum(whole - 1.0, 0.0).sum())

    def rate(self) -> Rate | None:
        if self._step_s is None or not self.count:
            return None
        lost = round(self._lost) if self._even >= MOSTLY * self.count else None
        return Rate(self._step_s, self.count / self._sum_s, lost)
