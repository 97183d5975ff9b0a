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
        found = [empty(EVENTS)]
        for name in columns:
            cells = frame.select(pl.col(time).alias("t_s"), pl.col(name).alias("value"), "source_row")
            known = cells.drop_nulls(["t_s", "value"])
            if known.is_empty():
                continue
            same = (known["value"] == known["value"].shift(1, fill_value=self._states.get(name))).fill_null(value=False)
            self._states[name] = known["value"][-1]
            signal = pl.lit(self.names.get(name, name)).alias("signal")
            found.append(conform(known.filter(~same).with_columns(signal), EVENTS))
        return pl.concat(found).sort("source_row", maintain_order=True)
