"""One log of any supported format to one table: at its own rate, or averaged over equal intervals.

For inspection with other tools. Clocks, frames and executions are not handled: the table is in the log's own clock and
frame. It is checked as in `ingest` (`validate`), and rows set aside are counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.config import Cell, load_cell
from cyclekit.dataset.guard import Kind, check_output
from cyclekit.dataset.rates import max_step_s
from cyclekit.errors import ConfigError, LogError, UnknownName
from cyclekit.ingest.discover import cell_for, find_all, options_of
from cyclekit.ingest.read.tool_point import TCP, with_tool_point
from cyclekit.ingest.registry import adapter_named
from cyclekit.ingest.validate.validate import examined_parts
from cyclekit.storage.atomic import replaced
from cyclekit.text.numbers import given
from cyclekit.text.plain_text import FORMULA
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from cyclekit.adapter import ReadOptions, Recording
    from cyclekit.ingest.discover import Log
    from cyclekit.schema import Vector


TABLES = {name: table for name, table in schema.OF_LOGS.items() if name != "stamps"}


@dataclass(frozen=True, repr=False)
class Converted(Result):
    """Result of a conversion."""

    out: Path
    adapter: str
    table: str
    rows: int
    rows_read: int
    rows_set_aside: int
    warnings: tuple[str, ...]

    def _lines(self) -> list[str]:
        aside = f", {self.rows_set_aside} of {self.rows_read} set aside" if self.rows_set_aside else ""
        return [f"{self.out}: {self.rows} rows of {self.table}, read by {self.adapter}{aside}"]


def convert(
    log: str | Path,
    out: str | Path,
    *,
    table: str | None = None,
    rate_hz: float | None = None,
    columns: Sequence[str] = (),
    cell: Cell | str | Path | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Converted:
    """Write one table of a log as Parquet or CSV, in SI units and in the log's own clock and frame.

    Args:
        log: A file, or a folder that is one log.
        out: `.parquet` or `.csv` file; written atomically.
        table: robot, people, events, task_list, safety or skeletons; by default the first one in the log.
        rate_hz: Output rows per second: numbers are averaged over each interval, texts are the last ones in it. By
            default every row of the log.
        columns: Columns to write; by default all non-empty ones; `t_s` is always written.
        cell: Cell file that describes how to read the log; by default the one next to it.
        progress: Called with the fraction done and a description.

    Raises:
        LogError: The log cannot be used, or has no such table.
        ConfigError: A name, a rate or the output format is unknown.
        OutputError: The output would replace the log, or a file not written by a conversion.
        CyclekitError: The output cannot be written.
    """
    log, out = Path(log), Path(out)
    kind: Kind = "table-csv" if out.suffix.lower() == ".csv" else "table-parquet"
    check_output(out, kind, [log, None if isinstance(cell, Cell) else cell], endings=(".parquet", ".csv"))
    if table is not None and table not in TABLES:
        raise UnknownName("convert", "table", table, TABLES)
    settings = cell if isinstance(cell, Cell) else cell_for([log], None) if cell is None else load_cell(Path(cell))
    found, _ = find_all([log], settings, follow_links=True)
    if len(found) != 1:
        raise LogError(log, f"holds {len(found)} logs", cure="Convert one at a time, or use `cyclekit ingest`.")
    computed = found[0].robot is not None and not {*TCP}.isdisjoint(columns)  # needs columns that were not requested
    wanted = () if computed else tuple(columns)
    options = replace(options_of(found[0].source, skeletons=table == "skeletons"), columns=wanted)
    parts = _Parts(found[0], options)
    with replaced(out) as temporary:
        rows = _write(parts, temporary, out, table, rate_hz, columns, progress)
    about = (found[0].adapter, parts.table, rows, parts.rows_read, parts.set_aside)
    return Converted(out, *about, warnings=parts.warnings)


class _Parts:
    """Parts of one table of a log, with row counts and warnings."""

    def __init__(self, log: Log, options: ReadOptions) -> None:
        self.path, self._robot, self._activities = log.path, log.robot, log.activities
        self._adapter, self._options = adapter_named(log.adapter), options
        self.table, self.rows_read, self.set_aside, self.warnings = "", 0, 0, tuple[str, ...]()

    def of(self, table: str | None) -> Iterator[pl.DataFrame]:
        read = self._adapter.parts(self.path, self._options, self._activities)
        for part in examined_parts(with_tool_point(read, self._robot)):
            self._note(part)
            tables = part.tables()
            self.table = self.table or table or next((name for name in TABLES if name in tables), "")
            if self.table not in tables:
                has = ", ".join(name for name in TABLES if name in tables) or "none"
                raise LogError(self.path, f"has no table {self.table!r}; its tables: {has}", cure="Choose --table.")
            yield schema.conform(tables[self.table], TABLES[self.table])

    def _note(self, part: Recording) -> None:
        self.rows_read += part.rows_read
        self.set_aside += 0 if part.set_aside is None else part.set_aside.height
        self.warnings = tuple(dict.fromkeys([*self.warnings, *part.said]))


def _write(
    parts: _Parts,
    temporary: Path,
    out: Path,
    table: str | None,
    rate_hz: float | None,
    columns: Sequence[str],
    progress: Callable[[float, str], None] | None,
) -> int:
    thin = Thinner(rate_hz) if rate_hz is not None else None
    writer: _Output | None = None
    try:
        for frame in parts.of(table):
            frame = pl.DataFrame([frame[name] for name in _chosen(frame, columns, parts.table)])
            ready = thin.add(frame) if thin else frame
            writer = writer or _Output(temporary, out.suffix.lower(), ready, parts.table)
            writer.write(ready)
            if progress:
                progress(0.5, f"{writer.rows} rows")
        if writer is not None:
            if thin:
                writer.write(thin.rest())
            writer.close()
    except BaseException:
        if writer is not None:
            writer.abandon()  # before its file is removed
        raise
    if writer is None:
        raise LogError(parts.path, "holds no rows", cure="Record again, or remove the file.")
    return writer.rows


def _chosen(frame: pl.DataFrame, columns: Sequence[str], table: str) -> list[str]:
    for name in columns:
        if name not in frame.columns:
            raise UnknownName(f"table {table}", "column", name, frame.columns)
    return ["t_s", *(name for name in frame.columns if name != "t_s" and (not columns or name in columns))]


class _Output:
    """Writer of the output file."""

    def __init__(self, file: Path, suffix: str, first: pl.DataFrame, table: str) -> None:
        from cyclekit.storage.parquet import TableWriter  # Arrow is imported while the next blocks are parsed

        self.rows = 0
        known = TABLES[table]
        columns = {name: known[name] for name in first.columns if name in known}
        more = [name for name in first.columns if name not in known]
        as_parquet = partial(TableWriter, file, columns, more=more, made_by="cyclekit convert")
        self._parquet = as_parquet() if suffix == ".parquet" else None
        self._file = file

    def write(self, frame: pl.DataFrame) -> None:
        if self._parquet is not None:
            self._parquet.write(frame)
        else:
            with self._file.open("ab") as handle:
                _no_formulas(frame).write_csv(handle, include_header=self.rows == 0 and handle.tell() == 0)
        self.rows += frame.height

    def close(self) -> None:
        if self._parquet is not None:
            self._parquet.close()

    def abandon(self) -> None:
        if self._parquet is not None:
            self._parquet.abandon()


def _no_formulas(frame: pl.DataFrame) -> pl.DataFrame:
    """Return a table with an apostrophe before each text that a spreadsheet would execute as a formula."""
    for name in [name for name, dtype in frame.schema.items() if dtype == pl.String]:
        text = pl.col(name)
        formula = text.str.contains(FORMULA) & text.cast(pl.Float64, strict=False).is_null()
        frame = frame.with_columns(pl.when(formula).then("'" + text).otherwise(text).alias(name))
    return frame


class Thinner:
    """Averages a table over equal intervals, part by part, but not across a gap or a backward step of the clock.

    The `source_row` of an output row is that of its last input row. Rows of different people are averaged separately.
    """

    def __init__(self, rate_hz: float) -> None:
        """Set the rate.

        Args:
            rate_hz: Output rows per second.

        Raises:
            ConfigError: The rate is invalid.
        """
        if not 0.0 < rate_hz < 1e5:
            raise ConfigError(f"rate_hz = {given(rate_hz)} is not a rate", cure="Give rows per second, for example 10.")
        self._rate_hz = rate_hz
        self._period_s: float | None = None
        self._waiting: pl.DataFrame | None = None

    def add(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the rows that are complete; the rows of the last interval wait for the next part."""
        rows = frame if self._waiting is None else pl.concat([self._waiting, frame], rechunk=True)
        cells = self._cells(rows["t_s"].to_numpy())
        last = int(np.searchsorted(cells, cells[-1])) if len(cells) else 0
        self._waiting = rows[last:]
        return _averaged(rows[:last], cells[:last])

    def rest(self) -> pl.DataFrame:
        """Return the rows of the last interval."""
        rows = self._waiting if self._waiting is not None else pl.DataFrame()
        return _averaged(rows, self._cells(rows["t_s"].to_numpy()))

    def _cells(self, t_s: Vector) -> NDArray[np.int64]:
        """Return the interval number of each row, ascending; a gap or a backward step starts a new interval."""
        steps = np.diff(t_s)
        if self._period_s is None and (steps > 0).any():
            self._period_s = float(np.median(steps[steps > 0]))
        gap = (steps > max_step_s(self._period_s)) | (steps < 0)
        length = np.floor(t_s * self._rate_hz + 1e-6)
        new = np.concatenate([[False], gap | (np.diff(length) != 0)]) if len(t_s) else np.zeros(0, bool)
        return np.cumsum(new)


def _averaged(rows: pl.DataFrame, cells: NDArray[np.int64]) -> pl.DataFrame:
    if rows.is_empty():
        return rows
    if "person" in rows.columns:
        keys = ["\x1fcell", *(name for name in ("person", "joint") if name in rows.columns)]
        grouped = rows.with_columns(pl.Series("\x1fcell", cells)).group_by(keys, maintain_order=True)
        kept = grouped.agg(_mean_or_last(name, dtype) for name, dtype in rows.schema.items() if name not in keys)
        return kept.select(rows.columns)
    starts = np.flatnonzero(np.diff(cells, prepend=cells[0] - 1))
    floats = [column for column in rows.get_columns() if column.dtype.is_float()]
    means = {column.name: column for column in _means(floats, starts)}
    others = pl.DataFrame([column for column in rows.get_columns() if column.name not in means])
    in_force = others[np.append(starts[1:], rows.height) - 1] if others.width else others
    return pl.DataFrame([means[name] if name in means else in_force.get_column(name) for name in rows.columns])


def _mean_or_last(name: str, dtype: pl.DataType) -> pl.Expr:
    return pl.col(name).mean() if dtype.is_float() else pl.col(name).drop_nulls().last()


def _means(columns: Sequence[pl.Series], starts: NDArray[np.int64]) -> list[pl.Series]:
    """Return the mean of the known values from each start to the next, per column; NaN if there are none."""
    values = np.stack([column.to_numpy() for column in columns])
    counts = np.diff(np.append(starts, values.shape[1]))
    sums = np.add.reduceat(values, starts, axis=1)
    if np.isnan(sums).any():
        known = np.isfinite(values)
        counts = np.add.reduceat(known, starts, axis=1, dtype=np.int64)
        sums = np.add.reduceat(np.where(known, values, 0.0), starts, axis=1)
    means = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return [pl.Series(column.name, mean, nan_to_null=True) for column, mean in zip(columns, means, strict=True)]
