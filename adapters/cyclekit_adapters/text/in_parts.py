"""Text logs as consecutive parts, for adapters whose logs may exceed memory.

A few blocks of rows become a part as soon as they are read. Facts known only at the end (how often a clock stepped
back) go into the last part, and a log without any usable row is refused there. The adapters interpret the columns.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import DamagedLog
from cyclekit_adapters.text import text_blocks
from cyclekit_adapters.text.delimited import joined, nothing_usable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from cyclekit.adapter import Recording
    from cyclekit_adapters.text.delimited import TextRows

MIN_ROWS, MIN_USABLE_SHARE = 1_000_000, 0.01
"""A log of more than MIN_ROWS rows is refused if fewer than this share are usable: its format is wrong."""
_PARTS_IN_A_BLOCK = 4


def in_parts(
    path: Path,
    blocks: Iterable[TextRows],
    make: Callable[[TextRows], Recording],
    finish: Callable[[Recording], Recording],
) -> Iterator[Recording]:
    """Yield the parts of a log.

    Args:
        path: The log, for error messages.
        blocks: Its rows.
        make: Turns joined blocks into a part; called in order.
        finish: Adds to the last part what is known only at the end.

    Raises:
        DamagedLog: No row is usable, or less than a share MIN_USABLE_SHARE of more than MIN_ROWS rows.
    """
    last: Recording | None = None
    rows_read, usable, unknown = 0, 0, 0
    aside: pl.DataFrame | None = None
    for rows in _together(blocks):
        part = make(rows)
        refused = rows.set_aside if part.set_aside is None else part.set_aside  # `make` may set rows aside, too
        rows_read += rows.rows_read
        usable += rows.frame.height - (refused.height - rows.set_aside.height)
        unknown += rows.not_finite
        if aside is None and refused.height:
            aside = refused
        if rows_read > MIN_ROWS and usable < rows_read * MIN_USABLE_SHARE and aside is not None:
            raise _barely_usable(path, rows_read, usable, aside)
        if last is not None:
            yield last
        last = part
    if last is None or not usable:
        raise nothing_usable(path, rows_read, pl.DataFrame() if aside is None else aside)
    done = finish(last)
    if unknown:
        message = f"{unknown} values are written as NaN or infinity: unknown there"
        done = replace(done, warnings=(*done.warnings, message))
    yield replace(done, warnings=(*done.warnings, *text_blocks.encoding_notes(path)))


def _together(blocks: Iterable[TextRows]) -> Iterator[TextRows]:
    """Join consecutive blocks until their tables reach a quarter of the size of a text block.

    A check takes about as long for few rows as for many, and with few columns a large block gives a small table.
    """
    waiting: list[TextRows] = []
    size = 0.0
    for rows in blocks:
        waiting.append(rows)
        size += rows.frame.estimated_size() + rows.set_aside.estimated_size()
        if size * _PARTS_IN_A_BLOCK >= text_blocks.BLOCK_BYTES:
            yield joined(waiting)
            waiting, size = [], 0.0
    if waiting:
        yield joined(waiting)


def _barely_usable(path: Path, rows_read: int, usable: int, aside: pl.DataFrame) -> DamagedLog:
    line, reason = aside.row(0)
    cause = f"only {usable} of its first {rows_read} rows can be used; the first bad row (line {line}): {reason}"
    return DamagedLog(path, cause, cure="Check what the file is; to read its good rows, cut them out of it.")
