"""Facts of task lists (durations by agent and task) and of safety systems' logs (durations by override)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.dataset.rates import max_step_s
from cyclekit.ingest.validate.task_lists import overlaps_of
from cyclekit.inspect.facts import AgentFacts, ListedTask, SafetyFacts, Span, TaskListFacts
from cyclekit.scaling.override_log import override_rows, response_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.scaling.override_log import OverrideResponse
    from cyclekit.schema import Vector


_AGENT = ("agent_name", "agent", "tasks", "overlaps", "overlap_s")
_DECIMALS = 4
"""Number of decimals to which overrides are distinguished: integer percent, and finer."""
MAX_ROWS = 5_000_000
"""Approximate maximum number of rows, from the start of a log, for levels and rates: two days at 30 Hz."""
_MANY = 10_000
"""Maximum number of different values; above, the override is continuous and rounded to two decimals."""


def task_list_facts(tasks: pl.DataFrame) -> TaskListFacts:
    """Return the facts of a task list.

    Args:
        tasks: Table TASK_LIST; if it has a column `session`, only times of one session share a clock.
    """
    tasks = tasks.with_columns(took_s=pl.col("end_s") - pl.col("t_s"))
    clocks = [name for name in ("session",) if name in tasks.columns]
    told = tasks.group_by("agent_name", maintain_order=True).agg(pl.col("agent").first())
    agents = overlaps_of(tasks, ["agent_name", "execution", *clocks])
    agents = agents.join(told, on="agent_name", how="left", maintain_order="left")
    kinds = tasks.group_by("agent_name", "task", maintain_order=True).agg(
        pl.len().alias("count"),
        pl.col("took_s").mean().alias("mean"),
        pl.col("took_s").std().alias("sd"),
        pl.col("took_s").min().alias("least"),
        pl.col("took_s").max().alias("most"),
        (pl.col("outcome") == "failed").sum().alias("failed"),
        pl.col("end_s").is_null().sum().alias("open"),
    )
    named = (
        tasks.drop_nulls("execution").group_by("execution").agg(begin=pl.col("t_s").min(), end=pl.col("end_s").max())
    )
    lasted = (named["end"] - named["begin"]).drop_nulls().to_numpy()
    return TaskListFacts(
        agents=tuple(AgentFacts(*row) for row in agents.select(_AGENT).iter_rows()),
        tasks=tuple(ListedTask(*row) for row in kinds.sort("agent_name", "task").iter_rows()),
        executions=named.height,
        execution_s=span_of(lasted),
        failed=int((tasks["outcome"] == "failed").sum()),
        no_end=tasks["end_s"].null_count(),
        planned=tasks.height - tasks["planned_start_s"].null_count(),
    )


def span_of(values: Vector) -> Span | None:
    """Return minimum, median and maximum of some values; None without values."""
    if not len(values):
        return None
    return Span(float(values.min()), float(np.median(values)), float(values.max()))


class _Held(NamedTuple):
    value: float
    seconds: float


class SafetySurvey:
    """Collects facts of table SAFETY, part by part."""

    def __init__(self) -> None:
        self._held: dict[float, float] = {}
        self._last: tuple[float, float] | None = None
        self._period_s: float | None = None
        self._distances: list[Vector] = []
        self._last_m, self._repeats, self._measured = np.nan, 0, 0
        self._rows: list[pl.DataFrame] = []
        self._count = 0

    def add(self, frame: pl.DataFrame) -> None:
        """Add a part, in the order of the log."""
        times = frame["t_s"].to_numpy()
        if not len(times):
            return
        steps = np.diff(times)
        if self._period_s is None and (steps > 0).any():
            self._period_s = float(np.median(steps[steps > 0]))
        if frame["override"].count():
            self._add_override(times, frame["override"].fill_null(np.nan).to_numpy())
            if self._count < MAX_ROWS:
                self._rows.append(frame.select("t_s", "override"))
                self._count += frame.height
        if frame["distance_m"].count():
            self._add_distance(frame["distance_m"].drop_nulls().to_numpy())

    def _add_override(self, times: Vector, values: Vector) -> None:
        """Add the time of each value: until the next row, limited to the minimum length of a gap."""
        if self._last is not None:
            times, values = np.r_[self._last[0], times], np.r_[self._last[1], values]
        self._last = float(times[-1]), float(values[-1])
        lasted = np.clip(np.diff(times), 0.0, max_step_s(self._period_s))
        decimals = _DECIMALS if len(self._held) < _MANY else 2
        told, which = np.unique(np.round(values[:-1], decimals), return_inverse=True)
        for value, seconds in zip(told.tolist(), np.bincount(which, lasted, len(told)).tolist(), strict=True):
            if np.isfinite(value):
                self._held[value] = self._held.get(value, 0.0) + seconds
        if np.isfinite(last := round(float(values[-1]), decimals)):
            self._held.setdefault(last, 0.0)

    def _add_distance(self, values: Vector) -> None:
        self._repeats += int((np.diff(values, prepend=self._last_m) == 0.0).sum())
        self._last_m, self._measured = float(values[-1]), self._measured + len(values)
        self._distances.append(values)

    def facts(self) -> SafetyFacts:
        """Return the facts."""
        held = sorted((_Held(*item) for item in self._held.items()), key=lambda one: -one.seconds)
        total = sum(one.seconds for one in held)
        distances = np.concatenate([np.empty(0), *self._distances])
        return SafetyFacts(
            override=span_of(self._weighted(held)) if held else None,
            override_values=tuple((one.value, one.seconds) for one in held),
            override_s=total,
            distance_m=span_of(distances),
            distance_repeats=self._repeats / max(self._measured, 1),
            response=self._response(),
        )

    def _response(self) -> OverrideResponse | None:
        rows = override_rows(pl.concat(self._rows)) if self._rows else None
        return None if rows is None else response_of(rows)

    def _weighted(self, held: Sequence[_Held]) -> Vector:
        """Return minimum, time-weighted median and maximum of the override, as an array."""
        values = np.array([one.value for one in sorted(held)])
        seconds = np.cumsum([one.seconds for one in sorted(held)])
        median = values[np.searchsorted(seconds, seconds[-1] / 2)] if seconds[-1] else float(np.median(values))
        return np.array([values[0], median, values[-1]])
