"""Checks of a task list as a whole: tasks without an end, overlapping tasks of one agent, wrong units.

No row is set aside, because a planner may start an agent's next task before the previous one is booked as done.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.ingest.validate.checks import Checks
from cyclekit.ingest.validate.window import HERE, PLACE
from cyclekit.text.numbers import compact, fixed

if TYPE_CHECKING:
    from collections.abc import Sequence

LONGEST_S, SHORTEST_S = 86_400.0, 1e-3
"""Plausible range of the median task duration, s; outside of it the unit of time is probably wrong."""
SHOWN = 6
"""Maximum number of agents in messages."""
TOUCH_S = 1e-3
"""Tolerance, s: a task may start this much before its agent's previous one ends, because times are rounded."""
_READ = ("t_s", "end_s", "agent_name", "execution")


class TaskChecks(Checks):
    """Checks of a task list; days may pass between its tasks."""

    def __init__(self) -> None:
        super().__init__("a task")
        self._rows: list[pl.DataFrame] = []

    def check(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the window without implausible rows."""
        frame = super().check(frame)
        here = frame.filter(pl.col(PLACE) == HERE)
        self._rows.append(here.select(name for name in _READ if name in here.columns))
        return frame

    def warnings(self) -> list[str]:
        """Return the warnings, after the last window."""
        messages = self._number_warnings()
        rows = pl.concat(self._rows) if self._rows else pl.DataFrame()
        if rows.is_empty() or set(rows.columns) != set(_READ):
            return messages
        if open_ends := rows["end_s"].null_count():
            messages.append(f"{open_ends} of {rows.height} tasks have no end: how long they took is unknown")
        overlaps = overlaps_of(rows, ["agent_name", "execution"])
        messages += self._overlap_warnings(overlaps.filter(pl.col("overlaps") > 0))
        return [*messages, *self.impossible()]

    def impossible(self) -> list[str]:
        """Return the warning about durations that cannot be."""
        rows = pl.concat(self._rows) if self._rows else pl.DataFrame()
        if not {"t_s", "end_s"} <= set(rows.columns):
            return []
        median_s = (rows["end_s"] - rows["t_s"]).median()
        if isinstance(median_s, float) and (median_s > LONGEST_S or 0.0 < median_s < SHORTEST_S):
            said = "which columns are start and end" if self.unit_shown else "the unit of time and give time_unit"
            return [f"half of the tasks take {compact(median_s, 3)} s: check {said}"]
        return []

    def _overlap_warnings(self, agents: pl.DataFrame) -> list[str]:
        messages = [
            f"{count} of {tasks} tasks of {name!r} start before its previous task has ended, by up to "
            f"{fixed(most, 1)} s"
            for name, tasks, count, most in agents[:SHOWN].iter_rows()
        ]
        return (
            [*messages, f"so do tasks of {agents.height - SHOWN} other agents"] if agents.height > SHOWN else messages
        )


def overlaps_of(rows: pl.DataFrame, by: Sequence[str]) -> pl.DataFrame:
    """Return how many tasks of each agent start before all of its earlier ones have ended.

    Args:
        rows: Columns `t_s`, `end_s`, `agent_name`, and those of `by`.
        by: Columns that identify one agent in one clock: `agent_name`, and `execution` if times count from its start.

    Returns:
        Columns `agent_name`, `tasks`, `overlaps`, `overlap_s` (maximum overlap, s), in order of appearance.
    """
    before = pl.col("end_s").cum_max().shift(1).forward_fill().over(by)
    late = rows.sort("t_s", maintain_order=True).with_columns(over_s=before - pl.col("t_s"))
    over = pl.col("over_s").filter(pl.col("over_s") > TOUCH_S)
    found = late.group_by("agent_name", maintain_order=True).agg(
        tasks=pl.len(), overlaps=over.len(), overlap_s=over.max().fill_null(0.0)
    )
    order = rows.select(pl.col("agent_name").unique(maintain_order=True))
    return order.join(found, on="agent_name", how="left", maintain_order="left", nulls_equal=True)
