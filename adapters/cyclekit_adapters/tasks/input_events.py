"""Digital inputs of a controller as events: each change of one bit of a bit field.

A button, a PLC or a tracker's sync output wired to an input appears there on the controller's clock. Only changes are
events; the state at the start of the log is not an edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from cyclekit.schema import EVENTS, conform

_BITS = 53  # in a number read as float


@dataclass
class InputEvents:
    """Detects changes of the bits of a column, block after block of one log.

    Attributes:
        column: Name of the bit field.
        time: Name of the time column, s.
    """

    column: str
    time: str
    _last: int | None = None

    def changes(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return table EVENTS of the next rows: signals `digital-input 0`, ..., values "0" and "1"."""
        known = frame.filter(pl.col(self.column).is_between(0, 2**_BITS))
        bits = known[self.column].to_numpy().astype(np.int64)
        before = np.concatenate([bits[:1] if self._last is None else [self._last], bits])[: bits.size]
        self._last = int(bits[-1]) if bits.size else self._last
        rows = np.flatnonzero(bits != before)
        flipped = ((bits ^ before)[rows, None] >> np.arange(_BITS)) & 1
        at, bit = np.nonzero(flipped)
        value = (bits[rows[at]] >> bit) & 1
        found = known[rows[at]].select(pl.col(self.time).alias("t_s"), "source_row")
        signal = pl.Series("signal", [f"digital-input {number}" for number in bit.tolist()], pl.String())
        return conform(found.with_columns(signal, pl.Series("value", value).cast(pl.String())), EVENTS)
