"""Loss: how much of a log is set aside, with the reason and the place, said where the user looks.

Adapters and checks set rows aside one by one. Here they are counted for the whole log, whatever its format and role.
A row that repeats another one, value by value, and a row without any value are no loss.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import CUT_LINE, NO_VALUE
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cyclekit.adapter import Recording

REPEATED = "repeats a row before it, with all its values"
"""Reason for which a row is set aside without loss."""
NO_LOSS = (REPEATED, NO_VALUE)
SAID, REFUSED = 0.01, 0.5
"""Least shares of a log's rows that are lost from which it is said, and from which ingest refuses the log; defaults of
the product. Half and twice of the first only say it of more or fewer logs; no sound log of the tests loses as much."""
TAIL = 2
"""Least number of last rows, all lost, that are said whatever their share: a single one was cut while being written."""
_SHOWN = 2
_ORDERED = ("robot", "people", "task_list")
"""Tables with a row for each row of the log."""


class LostRows:
    """Counts the rows lost, part after part of one log."""

    def __init__(self) -> None:
        self._read = 0
        self._reasons = Counter[str]()
        self._first: dict[str, int] = {}  # row of the first one, by reason
        self._last_used: int | None = None
        self._after = list[int]()  # rows lost after the last one used
        self._rows_are = "row"

    def add(self, part: Recording, aside: Iterable[pl.DataFrame]) -> None:
        """Add a part of the log, as it remains, and the rows set aside from it: `source_row`, `reason`."""
        self._read, self._rows_are = self._read + part.rows_read, part.rows_are
        some = [frame for frame in aside if frame.height]  # none, nearly always
        rows = pl.concat([pl.DataFrame(schema={"source_row": pl.Int64, "reason": pl.String}), *some])
        if some:
            rows = rows.filter(~pl.col("reason").is_in(NO_LOSS))
            rows = rows.filter(pl.col("source_row").is_null() | pl.col("source_row").is_first_distinct())
            by_reason = rows.group_by("reason").agg(pl.len(), pl.col("source_row").min().alias("first"))
            for reason, count, first in by_reason.iter_rows():
                self._reasons[reason] += count
                if first is not None:
                    self._first[reason] = min(first, self._first.get(reason, first))
            rows = rows.filter(~pl.col("reason").str.ends_with(CUT_LINE))
        used = [table["source_row"].max() for name, table in part.tables().items() if name in _ORDERED]
        self._last_used = max((row for row in (self._last_used, *used) if isinstance(row, int)), default=None)
        lost = [*self._after, *rows["source_row"].drop_nulls()]
        self._after = [row for row in lost if self._last_used is None or row > self._last_used]

    def warnings(self) -> list[str]:
        """Return the warning, after the last part."""
        lost, tail = min(self._reasons.total(), self._read), len(self._after)
        ends = tail >= TAIL and self._rows_are != "message"  # messages are counted by topic
        if not lost or (lost < SAID * self._read and not ends):
            return []
        often = sorted(self._reasons.items(), key=lambda one: (-one[1], one[0]))
        reason = often[0][0]
        where = f", the first is {self._rows_are} {self._first[reason]}" if reason in self._first else ""
        if ends and 2 * tail > lost:
            where = f", from {self._rows_are} {min(self._after)} to the end"
        counts = [f"{text} ({count})" for text, count in often[:_SHOWN]] if len(often) > 1 else [reason]
        more = f"; {len(often) - _SHOWN} other reasons" if len(often) > _SHOWN else ""
        share = percent(lost / self._read)
        return [f"{lost} of {self._read} {self._rows_are}s ({share}) are set aside{where}: {'; '.join(counts)}{more}"]

    def impossible(self) -> list[str]:
        """Return the warning if more than half of the log is lost."""
        return self.warnings() if self._reasons.total() > REFUSED * self._read else []
