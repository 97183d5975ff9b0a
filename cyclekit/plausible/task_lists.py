"""What is odd about a task list as a whole: tasks without an end, tasks of one agent at the same time, wrong units.

No row is set aside for it: a planner may well start an agent's next task before the last one is booked as done.
"""

from __future__ import annotations

import polars as pl

from cyclekit.plausible.checks import Checks
from cyclekit.plausible.window import HERE, PLACE

LONGEST_S, SHORTEST_S = 86_400.0, 1e-3
"""Half of the tasks of a list lie between these, unless its unit of time is another."""
TOUCH_S = 1e-3
"""A task may start so much before its agent's last one has ended: clocks are rounded."""
_READ = ("t_s", "end_s", "agent_name")


class TaskChecks(Checks):
    """A task list: days may lie between its tasks."""

    def __init__(self) -> None:
        super().__init__()
        self._rows: list[pl.DataFrame] = []

    def look(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the window without what cannot be."""
        frame = self.timed(self.finite(frame))
        here = frame.filter(pl.col(PLACE) == HERE)
        self._rows.append(here.select(name for name in _READ if name in here.columns))
        return frame

    def warnings(self) -> list[str]:
        """Say what was found, once all was seen."""
        said = self._said_of_numbers()
        rows = pl.concat(self._rows) if self._rows else pl.DataFrame()
        if rows.is_empty() or set(rows.columns) != set(_READ):
            return said
        if open_ends := rows["end_s"].null_count():
            said.append(f"{open_ends} of {rows.height} tasks have no end: how long they took is unknown")
        for (name,), mine in rows.group_by(["agent_name"], maintain_order=True):
            over = overlaps_s(mine).to_list()
            if over:
                begun = f"{len(over)} of {mine.height} tasks of {name!r} start before its last one has ended"
                said.append(f"{begun}, by up to {max(over):.1f} s")
        median_s = (rows["end_s"] - rows["t_s"]).median()
        if isinstance(median_s, float) and (median_s > LONGEST_S or 0.0 < median_s < SHORTEST_S):
            said.append(f"half of the tasks take {median_s:.3g} s: is the unit of time right? give time_unit")
        return said


def overlaps_s(rows: pl.DataFrame) -> pl.Series:
    """Return by how much tasks of one agent (`t_s`, `end_s`) start before all of its earlier ones have ended, s."""
    before = pl.col("end_s").cum_max().shift(1).forward_fill()
    over = rows.sort("t_s", maintain_order=True).select(over_s=before - pl.col("t_s"))["over_s"]
    return over.filter(over > TOUCH_S)
