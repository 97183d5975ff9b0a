"""Levels and ramp rates of the override in a safety system's log, without positions of robot or people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.dataset.rates import max_step_s
from cyclekit.scaling.levels import find_staircase
from cyclekit.scaling.response import LevelChange, changes_of, rate_of

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector


class OverrideRows(NamedTuple):
    """Rows of an override log: times (N,), s, override (N,), stretch without gaps (N,), and rate, Hz."""

    t_s: Vector
    override: Vector
    run: Ints
    rate_hz: float


@dataclass(frozen=True)
class OverrideResponse:
    """Levels, ascending, share of rows on each, number of changes, and rates down and up, 1/s (None: it jumps)."""

    levels: tuple[float, ...]
    share: tuple[float, ...]
    changes: int
    down_per_s: float | None
    up_per_s: float | None


def override_rows(safety: pl.DataFrame) -> OverrideRows | None:
    """Return the rows of table SAFETY whose override is known; None with fewer than two."""
    known = safety.select("t_s", "override").drop_nulls().sort("t_s")
    t_s, override = known["t_s"].to_numpy(), known["override"].to_numpy()
    steps = np.diff(t_s)
    if not (steps > 0).any():
        return None
    period_s = float(np.median(steps[steps > 0]))
    silent = steps > max_step_s(period_s)
    return OverrideRows(t_s, override, np.cumsum(np.append(False, silent)), 1.0 / period_s)


def response_of(rows: OverrideRows) -> OverrideResponse | None:
    """Return levels and rates of an override; None if it has no levels."""
    found = find_staircase(rows.override, run=rows.run, rate_hz=rows.rate_hz)
    if not found.is_staircase:
        return None
    levels = found.levels.tolist()
    ends = np.flatnonzero(np.diff(rows.run)) + 1
    parts = zip(np.split(rows.t_s, ends), np.split(rows.override, ends), strict=True)
    every: list[LevelChange] = [change for t_s, part in parts for change in changes_of(t_s, part, levels)]
    down, up = (rate_of([change for change in every if change.rises is rises]) for rises in (False, True))
    return OverrideResponse(tuple(levels), tuple(map(float, found.share)), len(every), down, up)
