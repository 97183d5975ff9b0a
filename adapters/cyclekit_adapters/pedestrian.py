"""Tables of pedestrians: `frame id x y`, with or without a header (PeTrack, JuPedSim, trajectory benchmarks).

The person is the tracked point as the file has it, usually head or feet, by `id`. A header of column names, or a last
comment line of them (`# id frame x/m y/m z/m`), says the order and the unit; without one the four columns are frame,
id, x, y in metres, unless `columns` and `unit` in the cell file say otherwise. The clock is frame / rate; the rate
comes from a comment `# framerate: 25` or from `rate_hz` in the cell file and is never invented.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.delimited import Layout, rows_of
from cyclekit_adapters.source_map import words
from cyclekit_adapters.text_blocks import HEAD_BYTES, blocks_of, file_encoding, head_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ORDERS = ("frame id x y", "id frame x y")
_RATE = re.compile(r"frame\s?_?rate\s*[:=]?\s*([0-9]+(?:\.[0-9]+)?)", re.IGNORECASE)
_IN_UNIT = re.compile(r"\bin (mm|cm|m|metres|meters)\b")
_TITLES = {
    "frame": "frame", "frame_id": "frame", "frameid": "frame", "fr": "frame", "frame_number": "frame",
    "id": "id", "ped": "id", "ped_id": "id", "pedestrian": "id", "pedestrian_id": "id", "track_id": "id",
    "agent_id": "id", "person_id": "id", "personid": "id", "x": "x", "y": "y", "z": "z",
    "pos_x": "x", "pos_y": "y", "pos_z": "z",
}  # fmt: skip
_TIMES = frozenset({"t", "time", "timestamp", "time_s", "seconds"})  # a table with times needs no rate: map it
_SPREAD_M = 500.0
_WIDEST = 64
_LINES_LOOKED_AT = 200


@dataclass(frozen=True)
class _Header:
    """Lines above the data, column names (`frame`, `id`, `x`, `y`, `z` or #n), unit and rate where stated."""

    lines: int
    names: tuple[str, ...]
    delimiter: str
    unit: str | None
    rate_hz: float | None
    titled: bool


class _Pedestrians:
    def recognises(self, path: Path) -> bool:
        header = _header(head_of(path))
        if header is None:
            return False
        return header.titled or _looks_like_frames(head_of(path), header)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        chosen = words(options, "pedestrian", {"columns": _ORDERS, "unit": tuple(_METRES)})
        header = _header(head_of(path, 1 << 20))
        if header is None:
            raise DamagedLog(path, "no table of frame, id, x and y", cure='Map it with adapter = "csv".')
        names = header.names
        if not header.titled and "columns" in chosen:
            names = (*chosen["columns"].split(), *names[4:])
        rate_hz = header.rate_hz or options.rate_hz
        if not rate_hz or rate_hz <= 0.0:
            cause = "frames are counted and no rate is stated: their times are unknown"
            raise LogError(path, cause, cure="Give rate_hz (frames per second) in the source of the cell file.")
        layout = Layout(names, "\\s+" if header.delimiter == " " else header.delimiter, 0, quotes=True)
        places = [axis for axis in "xyz" if axis in names]
        numbers, required = ["frame", *places], ["frame", "id"]
        lines = _lines(path, header)
        rows = rows_of(lines, layout, numbers=numbers, texts=["id"], required=required, first_line=header.lines + 1)
        rows = rows.or_refuse(path)
        unit = chosen.get("unit") or header.unit or "m"
        table = _table(path, rows.frame, rate_hz, _METRES[unit], options.body)
        _refuse_other_order(path, table, header)
        stated = "by the cell file" if "unit" in chosen else "by the header" if header.unit else "not in the file"
        return Recording(
            people=conform(table, PEOPLE),
            clock="relative",
            up="z",
            rows_are="line",
            rows_read=rows.rows_read,
            set_aside=rows.set_aside,
            warnings=tuple(_warnings(table, header, rate_hz, options)),
            facts={
                "point": "as the tracker has it: usually the head or the feet",
                "columns": " ".join(names),
                "unit": f"{unit}, {stated}",
                "rate_hz": f"{rate_hz:g}, {'by the header' if header.rate_hz else 'by the cell file'}",
            },
        )


def _header(head: str) -> _Header | None:
    """Take apart comments, a line of column names if there is one, and the first data row; None if it is no table."""
    lines = head.split("\n")[:_LINES_LOOKED_AT]
    at = next((i for i, line in enumerate(lines) if line.strip() and not _is_comment(line)), len(lines))
    comments = [line.strip().lstrip("#").strip() for line in lines[:at] if line.strip()]
    named = _names(lines[at]) if at < len(lines) else None
    at += named is not None
    if named is None and comments:
        named = _names(comments[-1])
    row = lines[at].strip() if at < len(lines) else ""
    delimiter = next((mark for mark in "\t,;" if mark in row), " ")
    width = len(_cells(row, delimiter))
    if not (4 <= width <= _WIDEST) or (named is None and width != 4) or (named and len(named[0]) > width):
        return None
    names, unit = named or (("frame", "id", "x", "y"), None)
    names = (*names, *(f"#{index}" for index in range(len(names), width)))
    rate = next((match for line in comments if (match := _RATE.search(line))), None)
    rate_hz = float(rate[1][:12]) if rate else None
    return _Header(at, names, delimiter, unit or _unit_of(comments), rate_hz, named is not None)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else line.strip().split(delimiter)


def _unit_of(comments: list[str]) -> str | None:
    """Return the unit that a comment states (`... coordinates in meters`)."""
    found = next((match[1] for line in comments if (match := _IN_UNIT.search(line.lower()))), None)
    return "m" if found in ("metres", "meters") else found


def _lines(path: Path, header: _Header) -> Iterator[bytes]:
    """Yield the lines below the header, comments as blank lines; runs of blanks are one delimiter."""
    delimiter = "\\s+" if header.delimiter == " " else header.delimiter
    for block in blocks_of(path, file_encoding(path) or "utf-8", skip_lines=header.lines, delimiter=delimiter):
        yield re.sub(rb"(?m)^[ \t\x1f]*#[^\r\n]*", b"", block) if b"#" in block else block


def _names(line: str) -> tuple[tuple[str, ...], str | None] | None:
    """Return the canonical names in a line of column names and the unit it states; None if it is no such line."""
    titles = [word for word in re.split(r"[,;\t ]+", line.strip().replace('"', "").lower()) if word]
    if len(titles) > _WIDEST:
        return None
    names: list[str] = []
    units: set[str] = set()
    for index, word in enumerate(titles):
        stem, _, unit = word.replace("[", "/").replace("]", "").partition("/")
        name = _TITLES.get(stem, f"#{index}")
        names.append(name if name not in names else f"#{index}")
        if name in ("x", "y") and unit in _METRES:
            units.add(unit)
    if not {"frame", "id", "x", "y"}.issubset(names) or _TIMES.intersection(titles):
        return None
    return tuple(names), units.pop() if len(units) == 1 else None


def _looks_like_frames(head: str, header: _Header) -> bool:
    """Tell whether nameless rows can be frame, id, x, y: whole numbers that are counted, then two places."""
    whole = head.split("\n")[:-1] if len(head) >= HEAD_BYTES else head.split("\n")
    lines = [line for line in whole[header.lines :] if line.strip() and not _is_comment(line)][:_LINES_LOOKED_AT]
    rows = [_floats(_cells(line, header.delimiter)) for line in lines]
    if len(rows) < 2 or any(len(row) != 4 for row in rows):
        return False
    counted = all(0 <= number < 1e9 and number % 1 == 0 for row in rows for number in row[:2])
    places = all(abs(number) < 1e6 for row in rows for number in row[2:])
    fractions = any(number % 1 for row in rows for number in row[2:])
    once = len({(row[0], row[1]) for row in rows}) == len(rows)
    return counted and places and fractions and once


def _floats(cells: list[str]) -> list[float]:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return []


def _table(path: Path, frame: pl.DataFrame, rate_hz: float, metres: float, body: str | None) -> pl.DataFrame:
    number = pl.col("id").cast(pl.Float64, strict=False)
    counted = number.is_not_null() & (number == number.round()) & (number.abs() < 1e15)
    person = pl.when(counted).then(number.cast(pl.Int64, strict=False).cast(pl.String)).otherwise(pl.col("id"))
    places = {f"{axis}_m": pl.col(axis) * metres for axis in "xyz" if axis in frame.columns}
    table = frame.select((pl.col("frame") / rate_hz).alias("t_s"), person.alias("person"), "source_row", **places)
    known = table["person"].unique().sort().to_list()
    if body is not None and body not in known:
        cure = f"In the file: {', '.join(known[:40])}."
        raise LogError(path, f"no body {body!r}", nearest=nearest(body, known), cure=cure)
    table = table.filter(pl.col("person") == body) if body is not None else table
    return table.sort("t_s", maintain_order=True)


def _refuse_other_order(path: Path, table: pl.DataFrame, header: _Header) -> None:
    """Refuse nameless columns in another order: one person cannot be at two places in one frame."""
    if not header.titled and table.select("t_s", "person").is_duplicated().any():
        cause = "one id twice in a frame: the nameless columns are in another order, or a row was doubled"
        raise LogError(path, cause, cure='Say the order in [sources.map]: columns = "id frame x y".')


def _warnings(table: pl.DataFrame, header: _Header, rate_hz: float, options: ReadOptions) -> list[str]:
    said = []
    if header.rate_hz and options.rate_hz and abs(header.rate_hz - options.rate_hz) > 1e-9 * rate_hz:
        said.append(f"the header's rate ({header.rate_hz:g} Hz) is used, not the cell file's ({options.rate_hz:g} Hz)")
    if not header.titled and "columns" not in options.map:
        said.append("the columns have no names: they are taken as frame, id, x, y")
    if header.unit is None and "unit" not in options.map:
        said.append("no unit is stated: x and y are taken as metres; see `unit`")
    reach = max(float(str(table[name].abs().max() or 0.0)) for name in ("x_m", "y_m"))
    if reach > _SPREAD_M:
        said.append(f"places reach {reach:.0f} m: they may be centimetres, millimetres or pixels; see `unit`")
    return said


ADAPTER: Adapter = _Pedestrians()
