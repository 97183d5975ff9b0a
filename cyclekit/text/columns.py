"""Escapes text in columns of a table (`plain_text`), because tables may come from anyone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.text.plain_text import NOT_ONE_LINE, one_line

if TYPE_CHECKING:
    from collections.abc import Iterable


def in_one_line(frame: pl.DataFrame, columns: Iterable[str] | None = None) -> pl.DataFrame:
    """Return the table with every text of some columns (None = all) escaped by `one_line`."""
    wanted = [name for name, dtype in frame.schema.items() if dtype == pl.String] if columns is None else columns
    found = frame.select(_is_odd(name) for name in wanted if name in frame.columns)
    odd = [one.name for one in found if one.any()]
    return frame.with_columns(pl.col(odd).map_elements(one_line, return_dtype=pl.String)) if odd else frame


def _is_odd(name: str) -> pl.Expr:
    texts = pl.col(name).cast(pl.String)
    texts = texts.filter(texts.ne_missing(texts.shift(1))).unique()  # repeated values are skipped for speed
    return texts.str.contains(NOT_ONE_LINE).any()
