"""Facts of a table read in parts: rate, duration, known values, gaps; for logs of any size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.rates import ONE_INSTANT_S, Rates, max_step_s
from cyclekit.dataset.time_grid import USUAL_HZ
from cyclekit.inspect.facts import Gap, TableFacts
from cyclekit.scaling.levels import find_staircase

if TYPE_CHECKING:
    from cyclekit.schema import Vector


_VALUES = 2_000_000  # maximum number of scaling values in which levels are searched


class TableSurvey:
    """Collects facts of one table, part by part."""

    def __init__(self, *, rated: bool = True) -> None:
        """Start without rows.

        Args:
            rated: Whether its rows have a rate; events have none.
        """
        self.rows = 0
        self._rates = Rates() if rated else None
        self._known: dict[str, int] = {}
        self._first_s, self._last_s, self._span_s = np.inf, -np.inf, 0.0
        self._period_s: float | None = None
        self._gaps: list[Gap] = []
        self._scaling: list[Vector] = []
        self._every = 1

    def add(self, frame: pl.DataFrame) -> None:
        """Add a part, in the order of the log."""
        self.rows += frame.height
        for name in frame.columns:
            self._known[name] = self._known.get(name, 0) + frame.height - frame[name].null_count()
        if self._rates is not None:
            self._rates.add(frame)
        self._add_times(frame["t_s"].drop_nulls().unique().sort().to_numpy())
        if "scaling" in frame.columns:
            self._add_scaling(frame["scaling"].drop_nulls().to_numpy())

    def _add_times(self, times: Vector) -> None:
        if not len(times):
            return
        here = times if not np.isfinite(self._last_s) else np.concatenate([[self._last_s], times])
        steps = np.diff(here)
        forward = steps[steps >= ONE_INSTANT_S]
        if self._period_s is None and len(forward):
            self._period_s = float(np.median(forward))
        silent = np.flatnonzero(steps > max_step_s(self._period_s))
        self._gaps += [Gap(float(here[at]), float(steps[at])) for at in silent.tolist()]
        self._first_s, self._last_s = min(self._first_s, float(times[0])), float(times[-1])
        self._span_s = max(self._span_s, self._last_s - self._first_s)

    def _add_scaling(self, values: Vector) -> None:
        self._scaling.append(np.asarray(values[:: self._every], float))
        if sum(map(len, self._scaling)) > _VALUES:
            self._scaling, self._every = [part[::2] for part in self._scaling], 2 * self._every

    def facts(self) -> TableFacts:
        """Return the facts."""
        columns = {name: count for name, count in self._known.items() if count and name not in ("t_s", "source_row")}
        known = {name: count / self.rows for name, count in columns.items()}
        period_s = self._period_s
        if period_s is None:
            return TableFacts(self.rows, None, 0.0, known, ())
        rate = None if self._rates is None else self._rates.found()
        step_s, mean_hz, lost = rate or (None, None, None)
        return TableFacts(self.rows, mean_hz, self._span_s, known, tuple(self._gaps), step_s, lost)

    def levels(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the levels of the scaling and the share of its rows on each; empty if no scaling is known."""
        values = np.concatenate([np.empty(0), *self._scaling])
        if not len(values):
            return (), ()
        rate_hz = USUAL_HZ if self._period_s is None else 1 / (self._every * self._period_s)
        staircase = find_staircase(values, rate_hz=rate_hz)
        return tuple(map(float, staircase.levels)), tuple(map(float, staircase.share))
