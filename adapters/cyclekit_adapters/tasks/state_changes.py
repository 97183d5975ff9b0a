"""States of signals as events: the first state of each signal and every change.

A PLC trace or an export of inputs repeats the state of every signal in every row; only changes carry information.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.schema import EVENTS, conform, empty

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_TIME, _SIGNAL, _VALUE = "\x1ft_s", "\x1fsignal", "\x1fvalue"  # names that no column of a log has
_CELLS = 1 << 20
"""Number of cells that are looked at together: a table of any width takes time in proportion to its cells."""


@dataclass
class StateChanges:
    """Detects changes of the signals of one log, block after block.

    Attributes:
        names: Column -> signal name, where they differ.
    """

    names: Mapping[str, str] = field(default_factory=dict)
    _states: dict[str, str] = field(default_factory=dict)

    def changes(self, frame: pl.DataFrame, time: str, columns: Iterable[str]) -> pl.DataFrame:
        """Return table EVENTS of the next rows, in their order; an empty cell is no change.

        Args:
            frame: The column `time` (s), `source_row`, and one text column per signal.
            time: Name of the time column; rows without a time are skipped.
            columns: Signal columns.
        """
        names, found = list(columns), [empty(EVENTS)]
        at_once = max(1, _CELLS // max(frame.height, 1))
        for first in range(0, len(names), at_once):
            some = frame.select(pl.col(time).alias(_TIME), "source_row", *names[first : first + at_once])
            samples = some.unpivot(index=[_TIME, "source_row"], variable_name=_SIGNAL, value_name=_VALUE)
            found.append(self.changed(samples.rename({_TIME: "t_s", _SIGNAL: "signal", _VALUE: "value"})))
        return pl.concat(found).sort("source_row", maintain_order=True)

    def changed(self, samples: pl.DataFrame) -> pl.DataFrame:
        """Return table EVENTS of samples `t_s`, `signal`, `value` and `source_row`, those of each signal in order."""
        known = samples.drop_nulls(["t_s", "value"])
        before = pl.col("value").shift(1).over("signal")
        if self._states:
            states = pl.col("signal").replace_strict(self._states, default=None, return_dtype=pl.String)
            before = pl.coalesce(before, states)
        fresh = known.filter((pl.col("value") != before).fill_null(value=True))
        self._states |= dict(known.unique("signal", keep="last").select("signal", "value").iter_rows())
        named = fresh.with_columns(pl.col("signal").replace(dict(self.names))) if self.names else fresh
        return conform(named, EVENTS)
