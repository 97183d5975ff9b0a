"""Positions that trackers write without a person: 0, 0, 0; -1, -1, -1; 9999, 9999, 9999.

Read as positions, they put a person at the robot's base, or far away. No measurement is exactly equal on three axes, so
the person is not seen in such a row. With a tracker of x and y only, such a position is kept if the person was right
next to it before or is after it, because a person may cross the centre of a floor measured in centimetres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.ingest.validate.window import BEFORE, HERE, PLACE
from cyclekit.text.numbers import given

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Vector


AXES = ("x_m", "y_m", "z_m")
NUMBERS = (0.0, -1.0, -99.0, *(sign * number for number in (999.0, 9999.0, 99999.0) for sign in (1.0, -1.0)))
UNITS_M = (1.0, 0.01, 0.001, 0.0254)
NO_PERSON_M = np.unique(np.outer(UNITS_M, NUMBERS))
"""Values of NUMBERS in m, for each unit of length."""
MAX_STEP_M = 0.3
"""Maximum plausible step of a person from one row to the next, m."""


class NoPersonValues:
    """Finds such rows, window after window, and makes their positions unknown."""

    def __init__(self) -> None:
        self._rows: dict[float, int] = {}
        self._seen = 0
        self._last: dict[str | None, tuple[float, float]] = {}  # last position of each person

    def check(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the window with unknown positions where no person is seen."""
        here = frame[PLACE].to_numpy() == HERE
        self._seen += int(here.sum())
        if not {"x_m", "y_m"}.issubset(frame.columns):
            return frame
        x, y, z = (
            frame[axis].cast(pl.Float64).to_numpy() if axis in frame.columns else np.full(len(here), np.nan)
            for axis in AXES
        )
        flat = np.isnan(z)
        odd = (x == y) & (flat | (z == x))
        odd[odd] = _means_no_person(x[odd])
        if (odd & flat).any():
            odd &= ~(flat & self._close_to_track(frame, x, y, odd))
        if flat.any() and "person" in frame.columns:
            self._remember(frame.filter(here & ~odd & np.isfinite(x)))
        if not odd.any():
            return frame
        for value, count in zip(*np.unique(x[odd & here] + 0.0, return_counts=True), strict=True):
            self._rows[float(value)] = self._rows.get(float(value), 0) + int(count)
        known = pl.Series(~odd)
        return frame.with_columns(pl.when(known).then(pl.col(a)).alias(a) for a in AXES if a in frame.columns)

    def _close_to_track(self, frame: pl.DataFrame, x: Vector, y: Vector, odd: Bools) -> Bools:
        """Return a mask of odd rows close to the previous or the next position of their person."""
        close, judged = np.zeros(len(x), bool), frame[PLACE].to_numpy() != BEFORE
        for person, rows in _rows_of(frame).items():
            mine = odd[rows]
            before, after = _neighbours(mine)
            for other in (before, after):
                at = rows[np.maximum(other, 0)]
                near = np.hypot(x[rows] - x[at], y[rows] - y[at]) <= MAX_STEP_M
                close[rows] |= mine & (other >= 0) & near
            if person in self._last:
                last_x, last_y = self._last[person]
                near = np.hypot(x[rows] - last_x, y[rows] - last_y) <= MAX_STEP_M
                close[rows] |= mine & (before < 0) & judged[rows] & near
        return close

    def _remember(self, seen: pl.DataFrame) -> None:
        last = seen.group_by("person").agg(pl.col("x_m").last(), pl.col("y_m").last())
        self._last |= {person: (x, y) for person, x, y in last.iter_rows()}

    def warnings(self) -> list[str]:
        """Return warnings with the positions that meant no person, and their counts."""
        return [
            f"a person is at exactly {given(value)} m on every axis in {count} of {self._seen} rows: "
            "this means no person seen; unknown there"
            for value, count in sorted(self._rows.items(), key=lambda item: -item[1])
        ]


def _means_no_person(values: Vector) -> Bools:
    """Return a mask of values equal to one of NO_PERSON_M, up to rounding in a unit conversion."""
    at = np.clip(np.searchsorted(NO_PERSON_M, values), 1, len(NO_PERSON_M) - 1)
    nearest = np.minimum(np.abs(values - NO_PERSON_M[at]), np.abs(values - NO_PERSON_M[at - 1]))
    return np.asarray(nearest <= 1e-12 * np.abs(values))


def _rows_of(frame: pl.DataFrame) -> Mapping[str | None, NDArray[np.int64]]:
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
