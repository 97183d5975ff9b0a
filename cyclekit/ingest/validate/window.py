"""The rows of a table that comes in parts, each with the rows beside it.

Whether a row can be is told by its neighbours. So the last rows of a part wait for those of the next one, and the last
rows that were judged, whatever came of it, go along once more, to be looked at and not judged again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Callable

PLACE = "\x1fplace"
"""Column of a window: BEFORE (judged already), HERE (to be judged) or AHEAD (to be judged with the next part)."""
BEFORE, HERE, AHEAD = 0, 1, 2


class Sliding:
    """Makes windows of consecutive parts."""

    def __init__(self, beside: Callable[[pl.DataFrame], int]) -> None:
        """Begin.

        Args:
            beside: How many rows before and behind a row are its neighbours, told from a part of the table.
        """
        self._beside = beside
        self._before: pl.DataFrame | None = None
        self._waiting: pl.DataFrame | None = None

    def with_neighbours(self, frame: pl.DataFrame, *, last: bool) -> pl.DataFrame:
        """Return the next window: rows judged before, those that waited and those of `frame`."""
        known = [rows for rows in (self._before, self._waiting) if rows is not None]
        seen = pl.concat([*known, frame], rechunk=True) if known else frame
        judged = 0 if self._before is None else self._before.height
        rows = seen[judged:]
        ahead = 0 if last else min(self._beside(rows), rows.height)
        here = rows.height - ahead
        self._waiting, to_here = rows[here:], seen[: seen.height - ahead]
        self._before = to_here.tail(self._beside(to_here))
        place = np.repeat(np.array([BEFORE, HERE, AHEAD], np.int8), [judged, here, ahead])
        return seen.hstack([pl.Series(PLACE, place)])


def judged_rows(window: pl.DataFrame) -> slice:
    """Return which rows of a window are judged and still there: they stand one behind the other."""
    first, end = np.searchsorted(window[PLACE].to_numpy(), [HERE, AHEAD]).tolist()
    return slice(first, end)


def let_through(window: pl.DataFrame) -> pl.DataFrame:
    """Return the rows of a window that were judged and are still there."""
    rows = window[judged_rows(window)].clone()
    rows.drop_in_place(PLACE)
    return rows
