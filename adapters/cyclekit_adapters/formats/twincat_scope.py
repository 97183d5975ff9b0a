"""Beckhoff TwinCAT Scope: the text file that Scope View and the Scope Export Tool write ("Export to csv").

The file holds a block about itself (Name, File, start and end of the export), a block of header lines about the
channels (Name, Data-Type, SampleTime[ms], ...), and rows. Channels with one sample time follow a time column of their
own, and every header line repeats its key above that column. Times are milliseconds since the start of the export or,
with "Full Timestamp", counts of 100 ns since 1601, like the start; the start is in UTC. Sources: Beckhoff's pages
"Export to csv" and "Export to svb" (TE13xx TC3 ScopeView) and "Scope Settings" (TwinCAT Scope 2), and published files
of Scope 3.4.3145 for separators and line forms.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import ConfigError, DamagedLog, EmptyLog
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.tasks.state_changes import StateChanges
from cyclekit_adapters.tasks.trace_signals import are_states, is_real, left_out
from cyclekit_adapters.text.delimited import TextLayout, TextRows, row_blocks, unique
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import blocks_of, file_encoding, head_lines

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_DELIMITERS = "\t;:,"
_HEADER_LINES = 600
_STARTS = ("Starttime of export", "StartRecord")
_TICKS_1970, _TICK_S = 116_444_736_000_000_000, 1e-7
_FULL_TICKS = 1e16
"""Minimum time value that counts ticks since 1601; in milliseconds it would be 300,000 years."""
_NUMBER = re.compile(r"[+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?")
_DIGITS = 20
"""Maximum number of digits of a count of ticks."""
_T_S = "\x1ft_s"
_LOOKED_AT = 200


@dataclass(frozen=True)
class _Group:
    """Channels that share a time column."""

    time: str
    channels: tuple[str, ...]


@dataclass(frozen=True)
class _Header:
    """Content of the lines above the rows.

    Attributes:
        layout: Layout of the rows; its header lines are all lines above them.
        groups: Channels by time column.
        start_s: Start of the export, s since 1970; None if the file does not give it.
        full: Times are ticks since 1601.
        real: Channels of real numbers, which are left out.
        facts: Facts to display.
    """

    layout: TextLayout
    groups: tuple[_Group, ...]
    start_s: float | None
    full: bool
    real: tuple[str, ...]
    facts: dict[str, str]


class _TwincatScope:
    def recognises(self, path: Path) -> bool:
        lines = head_lines(path, 2)
        mark = lines[0][4:5] if lines else ""
        return (
            len(lines) == 2
            and mark != ""
            and mark in _DELIMITERS
            and lines[0][:4] == "Name"
            and _key(lines[1], mark) == "File"
        )

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        words(options, "TwinCAT Scope", {})
        if options.role not in (None, "events"):
            raise ConfigError(f"a TwinCAT Scope export cannot be read as {options.role}", cure='Give role = "events".')
        header = _header(path)
        states = StateChanges()

        def make(rows: TextRows) -> Recording:
            events = [_events(rows.frame, group, header, states) for group in header.groups]
            return Recording(
                events=pl.concat(events).sort("t_s", "source_row", maintain_order=True),
                clock="relative" if header.start_s is None else "epoch",
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            return replace(last, warnings=tuple(left_out(header.real)), facts=header.facts)

        layout = header.layout
        blocks = row_blocks(
            _whole_rows(path, header),
            replace(layout, header_lines=0),
            numbers=[group.time for group in header.groups],
            texts=[name for group in header.groups for name in group.channels],
            first_line=layout.header_lines + 1,
        )
        yield from in_parts(path, blocks, make, finish)


def _key(line: str, mark: str) -> str:
    return line.partition(mark)[0].strip()


def _events(frame: pl.DataFrame, group: _Group, header: _Header, states: StateChanges) -> pl.DataFrame:
    """Return the events of channels that share a time column."""
    time = pl.col(group.time)
    t_s = (time - _TICKS_1970) * _TICK_S if header.full else time * 1e-3 + (header.start_s or 0.0)
    return states.changes(frame.select(t_s.alias(_T_S), "source_row", *group.channels), _T_S, group.channels)


def _header(path: Path) -> _Header:
    """Parse the lines above the rows.

    Raises:
        DamagedLog: They are not those of a TwinCAT Scope export, or no channel is a signal.
    """
    encoding = file_encoding(path) or "utf-8"
    lines = head_lines(path, _HEADER_LINES, encoding)
    mark = lines[0][4:5] if lines else ""
    if mark not in _DELIMITERS or not mark:
        raise DamagedLog(path, "no `Name` and delimiter in the first line", cure="Export it again with its header.")
    named = next((i for i, line in enumerate(lines) if i > 1 and _key(line, mark) == "Name"), None)
    if named is None:
        raise DamagedLog(path, "no header line of channels", cure="Export it with the names of the channels.")
    cells = [cell.strip() for cell in lines[named].rstrip(mark).split(mark)]
    first = next((i for i in range(named + 1, len(lines)) if _is_row(lines[i], mark)), None)
    if first is None:
        raise EmptyLog(path)
    columns = unique(f"time {i + 1}" if cell == "Name" else cell or f"#{i + 1}" for i, cell in enumerate(cells))
    rows = [line.split(mark) for line in lines[first : first + _LOOKED_AT]]
    types = _types(lines[named + 1 : first], mark, cells)
    begins = [i for i, cell in enumerate(cells) if cell == "Name"]
    groups, real = list[_Group](), list[str]()
    for begin, end in zip(begins, [*begins[1:], len(cells)], strict=True):
        signals = list[str]()
        for i in range(begin + 1, end):
            sample = (row[i] for row in rows if i < len(row))
            fits = not is_real(types[i]) if types else are_states(sample)
            (signals if fits else real).append(columns[i])
        groups.append(_Group(columns[begin], tuple(signals)))
    if not any(group.channels for group in groups):
        cause = f"all {len(real)} channels are of real numbers: none is a signal"
        raise DamagedLog(path, cause, cure="Export the channels of inputs and outputs (BOOL) too.")
    about = dict(line.split(mark, 1) for line in lines[:named] if mark in line)
    comma = mark != "," and any("," in cell for row in rows for cell in row)
    layout = TextLayout(columns, mark, first, decimal_comma=comma, encoding=encoding)
    full = any(
        _NUMBER.fullmatch(rows[0][i].strip()) and float(rows[0][i].replace(",", ".")) > _FULL_TICKS
        for i in begins
        if i < len(rows[0])
    )
    facts = {
        "channels": ", ".join(name for group in groups for name in group.channels)[:2000],
        "scope": about.get("Name", "").strip(mark),
    }
    return _Header(layout, tuple(groups), _start(about, mark), full, tuple(real), facts)


def _types(lines: list[str], mark: str, names: list[str]) -> list[str]:
    """Return the data type of each column; empty if the export has none."""
    found = next((line.rstrip(mark).split(mark) for line in lines if _key(line, mark) == "Data-Type"), [])
    return found if len(found) == len(names) else []


def _is_row(line: str, mark: str) -> bool:
    cells = [cell.strip() for cell in line.split(mark)]
    non_empty = [cell for cell in cells if cell]
    return (
        len(cells) > 1
        and bool(non_empty)
        and _NUMBER.fullmatch(non_empty[0]) is not None
        and all(_NUMBER.fullmatch(cell) or are_states([cell]) for cell in non_empty)
    )


def _start(about: dict[str, str], mark: str) -> float | None:
    for key in _STARTS:
        ticks = about.get(key, "").partition(mark)[0].strip()
        if ticks.isascii() and ticks.isdigit() and len(ticks) <= _DIGITS and int(ticks) > _TICKS_1970:
            return (int(ticks) - _TICKS_1970) * _TICK_S
    return None


def _whole_rows(path: Path, header: _Header) -> Iterator[bytes]:
    """Yield the rows; a row that lacks slower channels, because they have ended, is filled up."""
    layout = header.layout
    mark, width = layout.delimiter.encode(), len(layout.names)
    places = {name: place for place, name in enumerate(layout.names)}
    ends = {places[group.time] for group in header.groups}
    for block in blocks_of(path, layout.encoding, skip_lines=layout.header_lines, delimiter=layout.delimiter):
        lines = block.split(b"\n")
        for number, line in enumerate(lines):
            if (cells := line.count(mark) + 1) in ends and line.strip() and number < len(lines) - 1:
                bare = line.rstrip(b"\r")
                lines[number] = bare + mark * (width - cells)
            elif line.strip() == b"EOF":
                lines[number] = b""
        yield b"\n".join(lines)


ADAPTER: StreamingAdapter = _TwincatScope()
