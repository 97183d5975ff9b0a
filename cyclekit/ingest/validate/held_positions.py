"""Positions that a tracker repeats to the last bit while it does not see the person: found by the jump that ends them.

A person who stands is measured anew in each row, and some trackers round, so a repeated position alone shows nothing.
Who has stood and is farther away in the next row than anybody walks was not there before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.ingest.validate.placeholders import MAX_STEP
from cyclekit.text.numbers import compact, fixed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit.schema import Vector

HELD_S = 1.0
"""Least time, s, that a position is held; a default. Half of it names shorter ones too, twice only those
of 2 s."""
WALK_M_S = 2.0
"""Approach speed of a person's hand or fast walk, m/s (ISO 13855)."""


class HeldPositions:
    """Counts them, window after window."""

    def __init__(self) -> None:
        self._times, self._held_s = 0, 0.0
        self._last: dict[str | None, tuple[float, Vector, float]] = {}  # time and position, since when it is repeated

    def add(self, times: Vector, xyz: Vector, tracks: Mapping[str | None, NDArray[np.int64]]) -> None:
        """Add rows at times (N,) with positions (3, N), m; `tracks` has the rows of each person, in order."""
        xyz = np.stack([*xyz[:2], np.nan_to_num(xyz[2])])  # a tracker may know no height
        for person, rows in tracks.items():
            rows = rows[np.isfinite(xyz[:, rows]).all(axis=0)]
            if not len(rows):
                continue
            t, p = times[rows], xyz[:, rows]
            since = t[0]
            if person in self._last:
                before_s, before, since = self._last[person]
                t, p = np.concatenate([[before_s], t]), np.column_stack([before, p])
            took, way = np.diff(t), np.sqrt(np.square(np.diff(p)).sum(axis=0))
            moves = np.flatnonzero(way)  # rows after which the position changes
            begins = np.concatenate([[since], t[moves + 1]])
            stood_s = t[moves] - begins[:-1]
            jumps = (stood_s >= HELD_S) & (took[moves] > 0) & (way[moves] > MAX_STEP + WALK_M_S * took[moves])
            self._times, self._held_s = self._times + int(jumps.sum()), self._held_s + float(stood_s[jumps].sum())
            self._last[person] = (float(t[-1]), p[:, -1].copy(), float(begins[-1]))

    def warnings(self) -> list[str]:
        """Return the warning, after the last window."""
        if not self._times:
            return []
        return [
            f"a person's position is repeated to the last bit for at least {compact(HELD_S)} s and then jumps, "
            f"{self._times} time(s), {fixed(self._held_s, 1)} s in all: the tracker holds it while it sees nobody; "
            "leave these rows out, or map its confidence"
        ]
