"""Acme arms: CSV of the controller's trace, millimetres, seconds since the trace began."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, MissingColumns
from cyclekit.schema import ROBOT, conform

if TYPE_CHECKING:
    from pathlib import Path

_NEEDED = {"acme_t", "acme_x", "acme_y", "acme_z"}


class _AcmeTrace:
    def recognises(self, path: Path) -> bool:
        try:
            with path.open("rb") as log:
                return log.read(6) == b"acme_t"
        except OSError:  # a folder, or a file that may not be read
            return False

    def read(self, path: Path, options: ReadOptions) -> Recording:
        try:
            raw = pl.read_csv(path, infer_schema=False, glob=False)
            numbers = raw.select(pl.col(_NEEDED & set(raw.columns)).cast(pl.Float64))
        except pl.exceptions.PolarsError as error:
            raise DamagedLog(path, f"not readable as a table ({error})", cure="Copy it again.") from error
        if missing := _NEEDED.difference(raw.columns):
            raise MissingColumns(path, missing, raw.columns, "Switch the signal on in the trace settings.")
        places = [(pl.col(f"acme_{axis}") / 1000).alias(f"tcp_{axis}_m") for axis in "xyz"]
        robot = numbers.with_row_index("source_row").select("source_row", pl.col("acme_t").alias("t_s"), *places)
        return Recording(robot=conform(robot, ROBOT), clock="relative", rows_read=robot.height)


ADAPTER: Adapter = _AcmeTrace()  # the annotation is the proof that it fits
