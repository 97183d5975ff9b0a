"""When the level changed between two samples, from the rows of the robot's log: many times as many as samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from cyclekit.scaling.commanded import commanded_levels

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.scaling.commanded import Response
    from cyclekit.schema import Bools, Floats, Ints, Vector

SCALING = ("t_s", "scaling")
"""Columns of the log that are read."""
MAX_SAMPLES = 3
"""Maximum number of samples from the row before a change to the row after it."""
MAX_PART = 0.5
"""Maximum part of that time in which the change is hidden; above it, the log shows hardly more than the samples."""


class RowsWithLevels(Protocol):
    """N rows with a level, as `RuleRows`."""

    def __len__(self) -> int:
        """Return N."""

    @property
    def level(self) -> Floats:
        """Index of the level, shape (N,)."""

    @property
    def known(self) -> Bools:
        """Whether the level is known exactly, shape (N,)."""

    @property
    def before(self) -> Ints:
        """Row of the previous sample, shape (N,)."""

    @property
    def execution(self) -> Ints:
        """Number of the execution, shape (N,)."""

    @property
    def sample(self) -> Ints:
        """Number of the sample, shape (N,)."""


class Dating:
    """Dates changes of the level, one execution after the other."""

    def __init__(
        self,
        rows: RowsWithLevels,
        t_s: Vector,
        levels: Sequence[float],
        response: Response,
    ) -> None:
        """Find the changes.

        Args:
            rows: N rows.
            t_s: Session time of each sample, by its number, s.
            levels: Levels of the speed scaling, ascending.
            response: Response of the safety function to remove; without reaction time if the rows are without it.
        """
        before = rows.before
        near = (before >= 0) & (rows.sample - rows.sample[before] <= MAX_SAMPLES)
        changes = np.flatnonzero(near & rows.known & rows.known[before] & (rows.level != rows.level[before]))
        self._rows, self._t_s, self._levels, self._response = rows, t_s, levels, response
        self._changes = {
            int(number): changes[rows.execution[changes] == number] for number in np.unique(rows.execution[changes])
        }
        self.found: Floats = np.full((len(rows), 2), np.nan)
        """For each row the times around the change of the level since the row before, shape (N, 2).

        These are the times of the last row of the log before the change and of the first after it, as parts (0 to 1) of
        the time between both samples. NaN if the level did not change, if the log shows no more than the samples do, or
        if its scaling is not that of the samples (inferred, by another log, divided by a slider)."""

    def read(self, number: int, log: pl.DataFrame | None) -> None:
        """Date the changes in one execution, from `t_s` and `scaling` of the robot's log."""
        changes = self._changes.pop(number, None)
        if changes is None or log is None or log["scaling"].is_null().all():
            return
        rows, before, t_s = self._rows, self._rows.before, self._t_s
        time_s, scaling = log["t_s"].to_numpy(), log["scaling"].fill_null(np.nan).to_numpy()
        level = commanded_levels(time_s, scaling, self._levels, self._response).level.astype(np.int64)
        for row in changes.tolist():
            ends = (float(t_s[rows.sample[before[row]]]), float(t_s[rows.sample[row]]))
            between = _between(time_s, level, ends, (int(rows.level[before[row]]), int(rows.level[row])))
            if between is not None and between[1] - between[0] <= MAX_PART:
                self.found[row] = between

    def read_rest(self, dataset: Dataset, executions: Sequence[str]) -> None:
        """Date the changes in executions whose log was not read yet, given the names of all by number."""
        for number in sorted(self._changes):
            self.read(number, dataset.native_robot(executions[number], SCALING))


def _between(
    time_s: Vector, level: Ints, ends_s: tuple[float, float], levels: tuple[int, int]
) -> tuple[float, float] | None:
    """Return the last time on the first level and the first on the second, as parts; None if others come between."""
    first, last = np.searchsorted(time_s, (ends_s[0] - 1e-6, ends_s[1] + 1e-6))
    seen = level[first:last]
    was, now = (np.flatnonzero(seen == each) for each in levels)
    if not len(was) or not len(now) or was[-1] > now[0]:
        return None
    if (seen[: was[-1]] != levels[0]).any() or (seen[now[0] :] != levels[1]).any():
        return None
    parts = (time_s[first + np.array([was[-1], now[0]])] - ends_s[0]) / (ends_s[1] - ends_s[0])
    return float(parts[0]), float(parts[1])
