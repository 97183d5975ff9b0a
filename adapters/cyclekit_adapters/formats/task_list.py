"""Task lists: agent, task, start and end, as CSV, JSON (also of MongoDB and OCEL) or XES.

Written by task planners, MES exports and process mining: an agent, a task, its start and end, and often the execution,
planned times and outcome. They hold no positions. Agents called human, operator, person or worker are people, all
others robots, unless `robot` and `operator` in `[sources.map]` assign them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, Draft, ReadOptions, Recording
from cyclekit.errors import ConfigError, DamagedLog
from cyclekit.text.numbers import count
from cyclekit_adapters.mapped.draft_table import text_draft_table
from cyclekit_adapters.tasks.draft_tasks import task_draft
from cyclekit_adapters.tasks.lifecycle import NO_START, TRANSITIONS, paired
from cyclekit_adapters.tasks.ocel import is_ocel
from cyclekit_adapters.tasks.task_cells import task_table
from cyclekit_adapters.tasks.task_columns import NEEDED, columns_in, is_task_list, require, settings_of
from cyclekit_adapters.tasks.task_json import JsonRecords, json_names, table_of
from cyclekit_adapters.tasks.xes import FIELDS, XesRecords, is_xes
from cyclekit_adapters.text.delimited import (
    TextLayout,
    TextRows,
    delimiter_of,
    fields_of,
    header_names,
    joined,
    read_blocks,
)
from cyclekit_adapters.text.text_blocks import encoding_notes, file_encoding, head_lines, head_of
from cyclekit_adapters.text.text_rows import SET_ASIDE
from cyclekit_adapters.text.workbook import is_workbook

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from cyclekit.adapter import RowKind
    from cyclekit_adapters.tasks.lifecycle import Record
    from cyclekit_adapters.tasks.task_columns import Settings

MAX_TASKS = 1_000_000
"""Maximum number of tasks in one list, which is held in memory as a whole."""


@dataclass(frozen=True)
class _Cells:
    """A task list as texts.

    Attributes:
        frame: A column for each field of `columns`, and `source_row`.
        columns: Field -> column name in the log.
        rows_read: Number of rows, records or events read.
        rows_are: Unit of `source_row`.
        written: File format.
        aside: Rows that are not tasks.
        warnings: One sentence each.
        decimal_comma: Numbers may be written `0,5`.
    """

    frame: pl.DataFrame
    columns: Mapping[str, str]
    rows_read: int
    rows_are: RowKind
    written: str
    aside: list[tuple[int | None, str]] = field(default_factory=list)
    warnings: tuple[str, ...] = ()
    decimal_comma: bool = False


class _TaskList:
    def recognises(self, path: Path) -> bool:
        head = head_of(path)
        first = head.lstrip("\ufeff \t\r\n")[:1]
        if first in ("{", "["):
            return is_ocel(head) or json_names(head) is not None
        return is_xes(head) if first == "<" else _is_table(head)

    def draft(self, path: Path) -> Draft | None:
        table = None if is_workbook(path) else text_draft_table(path)
        return None if table is None else task_draft(table)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        settings = settings_of(options)
        cells = _cells(path, settings)
        _few(path, cells.frame.height)
        found = task_table(path, cells.frame, cells.columns, settings, decimal_comma=cells.decimal_comma)
        aside = pl.DataFrame(cells.aside, schema=SET_ASIDE, orient="row")
        return Recording(
            task_list=found.rows,
            clock=found.clock,
            time_units=found.time_units,
            rows_are=cells.rows_are,
            rows_read=cells.rows_read,
            set_aside=pl.concat([aside, found.set_aside.cast(pl.Schema(SET_ASIDE))]).sort("source_row"),
            warnings=(*cells.warnings, *found.warnings, *encoding_notes(path)),
            facts={"written as": cells.written, **found.facts},
        )


def _cells(path: Path, settings: Settings) -> _Cells:
    first = head_of(path).lstrip("\ufeff \t\r\n")[:1]
    if first in ("{", "["):
        return _of_json(path, settings)
    return _of_xes(path, settings) if first == "<" else _of_table(path, settings)


def _few(path: Path, rows: int) -> None:
    if rows > MAX_TASKS:
        raise DamagedLog(path, f"more than {count(MAX_TASKS)} tasks: too many for one list", cure="Split it.")


def _header(line: str) -> tuple[tuple[str, ...], str]:
    delimiter = delimiter_of(line, ",;\t")
    names = header_names(line, delimiter) if delimiter in line else ()
    return tuple(name.strip().strip('"') for name in names), delimiter


def _is_table(head: str) -> bool:
    """Return whether these are the first characters of a task list; without starts, its rows have to start and end."""
    line, _, rest = head.partition("\n")
    names, delimiter = _header(line)
    found = columns_in(names)
    if not is_task_list(names) or "start" in found:
        return is_task_list(names)
    rows = (fields_of(row, delimiter) for row in rest.split("\n")[:-1])
    at = names.index(found["transition"])
    return any(row[at].strip().lower() in TRANSITIONS for row in rows if len(row) > at)


def _of_table(path: Path, settings: Settings) -> _Cells:
    names, delimiter = _header(next(iter(head_lines(path)), ""))
    columns = require(path, names, settings.columns)
    layout = TextLayout(names, delimiter, 1, encoding=file_encoding(path) or "utf-8", quotes=True)
    texts = list(dict.fromkeys(columns.values()))
    blocks, read = list[TextRows](), 0
    for block in read_blocks(path, layout, numbers=[], texts=texts):
        blocks.append(block)
        read += block.rows_read
        _few(path, read)
    rows = joined(blocks, [], texts)
    frame = rows.frame.select("source_row", *(pl.col(name).alias(key) for key, name in columns.items()))
    aside: list[tuple[int | None, str]] = [(row, reason) for row, reason in rows.set_aside.iter_rows()]
    cells = _Cells(frame, columns, rows.rows_read, "line", "a table", aside, decimal_comma=delimiter != ",")
    return cells if "start" in columns else _of_pairs(path, cells)


def _of_pairs(path: Path, cells: _Cells) -> _Cells:
    """Return the tasks whose starts and ends are rows of their own."""
    rows = cells.frame.iter_rows(named=True)
    events = [{key: str(text) for key, text in row.items() if text is not None} for row in rows]
    passed_over, aside = Counter[str](), list(cells.aside)
    table = table_of(_started(path, paired(events, passed_over), aside), FIELDS, MAX_TASKS + 1)
    _require_starts(path, table, aside)
    columns = {key: cells.columns.get(key, key) for key in FIELDS if table[key].count() or key in NEEDED}
    columns["start"] = cells.columns["end"]
    said = (*cells.warnings, *_passed(passed_over))
    return replace(cells, frame=table.select("source_row", *columns), columns=columns, aside=aside, warnings=said)


def _of_json(path: Path, settings: Settings) -> _Cells:
    records = JsonRecords(path)
    first = list(islice(iter(records), 200))
    names = tuple(dict.fromkeys(key for record in first for key in record))
    if not names and records.broken is not None:
        raise DamagedLog(path, f"not valid JSON ({records.broken})", cure="Copy it again.")
    columns = require(path, names, settings.columns)
    records = JsonRecords(path)
    table = table_of(iter(records), tuple(dict.fromkeys(columns.values())), MAX_TASKS + 1)
    frame = table.select("source_row", *(pl.col(name).alias(key) for key, name in columns.items()))
    aside: list[tuple[int | None, str]] = []
    if records.broken is not None:
        aside = [(frame.height, str(records.broken))]
    passed = [f"{records.others} elements are not objects and are skipped"] if records.others else []
    passed += [_cut(str(records.broken))] if records.broken is not None else []
    cells = _Cells(frame, columns, frame.height, "row", "JSON", aside, tuple(passed))
    return cells if "start" in columns else _of_pairs(path, cells)


def _cut(where: str) -> str:
    return f"{where}: only the tasks before it are read. Export it again"


def _of_xes(path: Path, settings: Settings) -> _Cells:
    if settings.columns:
        name = next(iter(settings.columns))
        raise ConfigError(f"{path}: {name} in [sources.map] names a column, and XES has none", cure="Remove it.")
    records = XesRecords(path)
    aside: list[tuple[int | None, str]] = []
    table = table_of(_started(path, iter(records), aside), FIELDS, MAX_TASKS + 1)
    _require_starts(path, table, aside)
    if table.is_empty() and records.broken is not None:
        raise DamagedLog(path, records.broken, cure="Copy it again.")
    columns = {key: key for key in FIELDS if table[key].count() or key in NEEDED}
    warnings = _passed(records.passed_over)
    if records.broken is not None:
        aside.append((None, records.broken))
        warnings.append(_cut(records.broken))
    return _Cells(table.select("source_row", *columns), columns, records.events, "row", "XES", aside, tuple(warnings))


def _passed(over: Mapping[str, int]) -> list[str]:
    return [f"{count} events {name!r} are skipped" for name, count in over.items()]


def _require_starts(path: Path, table: pl.DataFrame, aside: list[tuple[int | None, str]]) -> None:
    if table.is_empty() and aside:
        cause = "its events say when tasks were completed and not when they started (lifecycle:transition)"
        raise DamagedLog(path, cause, cure="Export start events too.")


def _started(path: Path, records: Iterator[Record], aside: list[tuple[int | None, str]]) -> Iterator[Record]:
    """Yield the tasks that have a start; the others are set aside."""
    for record in records:
        if NO_START in record:
            row = record.get("source_row")
            aside.append((None if row is None else int(row), f"{record[NO_START][:60]!r} completes but never started"))
            _few(path, len(aside))
        else:
            yield record


ADAPTER: Adapter = _TaskList()
