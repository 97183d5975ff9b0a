"""The samples of one session as a file, which may be larger than memory takes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit import schema
from cyclekit.storage.atomic import write_parquet
from cyclekit.storage.parquet import GROUP_ROWS, TableWriter

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

AT_ONCE = 1 << 14
"""Samples that become a table at once; a sample has four times the bytes there that its numbers have."""


def write_samples(frames: Iterator[pl.DataFrame], file: Path) -> int:
    """Write samples that come in parts, few of them at once, which takes less time; return how many there are.

    Args:
        frames: The parts, each with exactly the columns of table SAMPLES; one at least.
        file: Where.

    Raises:
        OSError: The file cannot be written.
    """
    first, rows = list[pl.DataFrame](), 0
    for frame in frames:
        first.append(frame)
        rows += frame.height
        if rows > GROUP_ROWS:
            break
    else:
        write_parquet(pl.concat(first, rechunk=True), file)
        return rows
    with TableWriter(file, schema.SAMPLES) as writer:
        while first:
            writer.write(first.pop(0))
        for frame in frames:
            writer.write(frame)
    return writer.rows
