"""Positions that logs write for an unknown one: 0, 0, 0; -1, -1, -1; 9999, 9999, 9999; all joints at 0.

Read as positions, they put a person at the robot's base, and the tool inside of it. No measurement of a person is
exactly equal on three axes, so the position is unknown in such a row. With x and y only it is kept if the person was
right next to it before or is after it. So it is for robots, which may rest at joint angles or in a frame of 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.ingest.validate.window import BEFORE, HERE, PLACE
from cyclekit.schema import is_joint
from cyclekit.text.numbers import given

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Vector


NUMBERS = (0.0, -1.0, -99.0, *(sign * number for number in (999.0, 9999.0, 99999.0) for sign in (1.0, -1.0)))
UNITS_M = (1.0, 0.01, 0.001, 0.0254)
UNKNOWN_M = np.unique(np.outer(UNITS_M, NUMBERS))
"""Values of NUMBERS in m, for each unit of length."""
MAX_STEP = 0.3
"""Maximum plausible step of a person or a tool from one row to the next, m, and of all joints together, rad."""


@dataclass
class Placeholders:
    """Finds such rows, window after window, and makes their positions unknown.

    Attributes:
        axes: Columns of the position, of which the third may be unknown; none = all joint angles.
        robot: They are a robot's.
        said: Warning, with places for `value`, `count` and `rows`.
    """

    axes: tuple[str, ...]
    said: str
    robot: bool = False
    _rows: dict[float, int] = field(default_factory=dict)
    _seen: int = 0
    _last: dict[str | None, Vector] = field(default_factory=dict)  # last position of each person

    def check(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the window with unknown positions in such rows."""
        here = frame[PLACE].to_numpy() == HERE
        self._seen += int(here.sum())
        axes = self.axes or [name for name in frame.columns if is_joint(name) and name.endswith("_rad")]
        if not self.axes and not _any_row_of_zeros(frame, axes):  # nearly always; its last row is all that is needed
            last = frame[np.flatnonzero(here)[-1:]]
            at = np.array([last[name].cast(pl.Float64).to_numpy() for name in axes], np.float64)
            at = at[np.isfinite(at[:, 0])] if at.size else at[:0]
            if at.size:
                self._remember(last, at, np.ones(1, np.bool_))
            return frame
        at = np.full((len(axes), frame.height), np.nan)
        for axis, name in enumerate(axes):
            if name in frame.columns:
                values = frame[name].cast(pl.Float64).to_numpy()
                at[axis] = np.where(np.isfinite(values), values, np.nan)
        if self.axes:
            x, y, z = at
            weak = np.isnan(z)
            odd = (x == y) & (weak | (z == x))
            odd[odd] = _means_unknown(x[odd])
            at = at[: 3 if self.robot and not weak.any() else 2]
            weak |= self.robot
        else:
            at = at[~np.isnan(at).all(axis=1)]
            odd = (at == 0.0).all(axis=0) & (len(at) > 1)
            weak = np.ones(len(odd), bool)
        if (odd & weak).any():
            odd &= ~(weak & self._close_to_track(frame, at, odd))
        if weak.any():
            self._remember(frame, at, here & ~odd & np.isfinite(at).all(axis=0))
        if not odd.any():
            return frame
        for value, count in zip(*np.unique(at[0][odd & here] + 0.0, return_counts=True), strict=True):
            self._rows[float(value)] = self._rows.get(float(value), 0) + int(count)
        known = pl.Series(~odd)
        computed = [] if self.axes else _computed(frame.filter(odd))
        return frame.with_columns(
            pl.when(known).then(pl.col(name)).alias(name) for name in (*axes, *computed) if name in frame.columns
        )

    def _close_to_track(self, frame: pl.DataFrame, at: Vector, odd: Bools) -> Bools:
        """Return a mask of odd rows near the previous or the next position of their person; a robot may have none."""
        close, judged = np.zeros(len(odd), bool), frame[PLACE].to_numpy() != BEFORE
        for person, rows in rows_of(frame).items():
            mine, last = odd[rows], self._last.get(person)
            before, after = _neighbours(mine)
            for other in (before, after):
                way = _way(at[:, rows] - at[:, rows[np.maximum(other, 0)]])
                near = (way <= MAX_STEP) | (self.robot & np.isnan(way))  # no jump is seen
                close[rows] |= mine & (other >= 0) & near
            if last is not None:
                near = _way(at[:, rows] - last[:, None]) <= MAX_STEP
                close[rows] |= mine & (before < 0) & judged[rows] & near
            elif self.robot:
                close[rows] |= mine & (before < 0) & (after < 0)
        return close

    def _remember(self, frame: pl.DataFrame, at: Vector, known: Bools) -> None:
        for person, rows in rows_of(frame).items():
            if (seen := rows[known[rows]]).size:
                self._last[person] = at[:, seen[-1]].copy()  # a view would keep all the other rows

    def warnings(self) -> list[str]:
        """Return warnings with the positions that stand for an unknown one, and their counts."""
        return [
            self.said.format(value=given(value), count=count, rows=self._seen)
            for value, count in sorted(self._rows.items(), key=lambda item: -item[1])
        ]


def _any_row_of_zeros(frame: pl.DataFrame, names: Sequence[str]) -> bool:
    """Return whether in some row all columns are 0 that have a value in any row; most often one column tells."""
    rows, told = np.ones(frame.height, np.bool_), 0
    for name in names:
        values = frame[name].cast(pl.Float64).to_numpy()
        zero = values == 0.0
        if zero.any():
            rows, told = rows & zero, told + 1
        elif np.isfinite(values).any():
            return False
    return told > 1 and bool(rows.any())


def _computed(odd: pl.DataFrame) -> list[str]:
    """Return the columns of the TCP if it is one and the same in all these rows, as if computed from their joints."""
    names = [name for name in odd.columns if name in ("tcp_x_m", "tcp_y_m", "tcp_z_m")]
    return names if all(odd[name].n_unique() <= 1 for name in names) else []


def _way(steps: Vector) -> Vector:
    return np.asarray(np.sqrt((steps * steps).sum(axis=0)))


def _means_unknown(values: Vector) -> Bools:
    """Return a mask of values equal to one of UNKNOWN_M, up to rounding in a unit conversion."""
    at = np.clip(np.searchsorted(UNKNOWN_M, values), 1, len(UNKNOWN_M) - 1)
    nearest = np.minimum(np.abs(values - UNKNOWN_M[at]), np.abs(values - UNKNOWN_M[at - 1]))
    return np.asarray(nearest <= 1e-12 * np.abs(values))


def rows_of(frame: pl.DataFrame) -> Mapping[str | None, NDArray[np.int64]]:
    """Return the rows of each person, in order."""
    if "person" not in frame.columns:
        return {None: np.arange(frame.height)}
    groups = frame.select("person", row=pl.int_range(pl.len())).group_by("person", maintain_order=True).agg("row")
    return {person: np.array(rows, np.int64) for person, rows in groups.iter_rows()}


def _neighbours(odd: Bools) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for each row the last row before it and the first row after it that are not odd; -1 = none."""
    at = np.arange(len(odd))
    before = np.maximum.accumulate(np.where(odd, -1, at))
    after = np.minimum.accumulate(np.where(odd, len(odd), at)[::-1])[::-1]
    return before, np.where(after < len(odd), after, -1)
