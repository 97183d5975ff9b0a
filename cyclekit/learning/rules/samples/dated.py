"""When the level changed between two samples, from the rows of the robot's log: many times as many as samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from cyclekit.scaling.commanded import commanded_levels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.scaling.commanded import Response
    from cyclekit.schema import Bools, Floats, Ints, Vector

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


def dated(
    dataset: Dataset,
    executions: Sequence[str],
    rows: RowsWithLevels,
    t_s: Vector,
    levels: Sequence[float],
    response: Response,
) -> Floats:
    """Return for each row the times around the change of the level since the row before, shape (N, 2).

    These are the times of the last row of the log before the change and of the first after it, as parts (0 to 1) of the
    time between both samples. NaN if the level did not change, if the log shows no more than the samples do, or if its
    scaling is not that of the samples (inferred, by another log, divided by a slider).

    Args:
        dataset: Dataset of the rows.
        executions: Names of the executions, by number.
        rows: N rows.
        t_s: Session time of each sample, by its number, s.
        levels: Levels of the speed scaling, ascending.
        response: Response of the safety function to remove; without reaction time if the rows are without it.
    """
    found = np.full((len(rows), 2), np.nan)
    before = rows.before
    near = (before >= 0) & (rows.sample - rows.sample[before] <= MAX_SAMPLES)
    changes = np.flatnonzero(near & rows.known & rows.known[before] & (rows.level != rows.level[before]))
    for number in np.unique(rows.execution[changes]):
        log = dataset.native_robot(executions[number], ("t_s", "scaling"))
        if log is None or log["scaling"].is_null().all():
            continue
        mine = changes[rows.execution[changes] == number]
        time_s, scaling = log["t_s"].to_numpy(), log["scaling"].fill_null(np.nan).to_numpy()
        level = commanded_levels(time_s, scaling, levels, response).level.astype(np.int64)
        for row in mine.tolist():
            ends = (float(t_s[rows.sample[before[row]]]), float(t_s[rows.sample[row]]))
            between = _between(time_s, level, ends, (int(rows.level[before[row]]), int(rows.level[row])))
            if between is not None and between[1] - between[0] <= MAX_PART:
                found[row] = between
    return found


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
