"""Windows of a table that comes in parts: its rows with their neighbours.

A row is judged by its neighbours. So the last rows of a part wait for the next one, and the rows judged last are
included again as neighbours, but not judged again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Callable

PLACE = "\x1fplace"
"""Column of a window: BEFORE (already judged), HERE (judged now) or AHEAD (judged with the next part)."""
BEFORE, HERE, AHEAD = 0, 1, 2


class SlidingWindow:
    """Makes windows of consecutive parts."""

    def __init__(self, neighbours: Callable[[pl.DataFrame], int]) -> None:
        """Set the function for the number of neighbours.

        Args:
            neighbours: Function from a part of the table to the number of rows before and after a row that are its
                neighbours.
        """
        self._neighbours = neighbours
        self._before: pl.DataFrame | None = None
        self._waiting: pl.DataFrame | None = None

    def with_neighbours(self, frame: pl.DataFrame, *, last: bool) -> pl.DataFrame:
        """Return the next window: rows judged before, waiting rows and those of `frame`."""
        known = [rows for rows in (self._before, self._waiting) if rows is not None]
        seen = pl.concat([*known, frame], rechunk=True) if known else frame
        judged = 0 if self._before is None else self._before.height
        rows = seen[judged:]
        ahead = 0 if last else min(self._neighbours(rows), rows.height)
        here = rows.height - ahead
        self._waiting, to_here = rows[here:], seen[: seen.height - ahead]
        self._before = to_here.tail(self._neighbours(to_here))
        place = np.repeat(np.array([BEFORE, HERE, AHEAD], np.int8), [judged, here, ahead])
        return seen.hstack([pl.Series(PLACE, place)])


def judged_rows(window: pl.DataFrame) -> slice:
    """Return the slice of a window's rows that are judged now and were not removed."""
    first, end = np.searchsorted(window[PLACE].to_numpy(), [HERE, AHEAD]).tolist()
    return slice(first, end)


def kept_rows(window: pl.DataFrame) -> pl.DataFrame:
    """Return the judged rows of a window that were not removed."""
    rows = window[judged_rows(window)].clone()
    rows.drop_in_place(PLACE)
    return rows
