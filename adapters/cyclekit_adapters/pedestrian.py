"""Tables of pedestrians: `frame id x y`, with or without a header (PeTrack, JuPedSim, trajectory benchmarks).

The person is the tracked point as the file has it, usually head or feet, by `id`. A header of column names, or a last
comment line of them (`# id frame x/m y/m z/m`), says the order and the unit; without one the four columns are frame,
id, x, y in metres, unless `columns` and `unit` in the cell file say otherwise. People walk: where the nameless columns
taken in the other order give much smaller steps, the log is refused until `columns` says which it is. The clock is
frame / rate; the rate comes from a comment `# framerate: 25` or from `rate_hz` in the cell file and is never invented.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from statistics import median
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, whole
from cyclekit.errors import DamagedLog, LogError
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.delimited import Layout, Rows, row_blocks
from cyclekit_adapters.in_parts import in_parts
from cyclekit_adapters.sightings import Sightings, only
from cyclekit_adapters.source_map import words
from cyclekit_adapters.text_blocks import HEAD_BYTES, blocks_of, file_encoding, head_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ORDERS = ("frame id x y", "id frame x y", "frame id x y z", "id frame x y z")
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
_LONGEST_TITLES = 64 * _WIDEST
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
        return whole(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        chosen = words(options, "pedestrian", {"columns": _ORDERS, "unit": tuple(_METRES)})
        header = _ordered(path, chosen.get("columns"))
        rate_hz = header.rate_hz or options.rate_hz
        if not rate_hz or rate_hz <= 0.0:
            cause = "frames are counted and no rate is stated: their times are unknown"
            raise LogError(path, cause, cure="Give rate_hz (frames per second) in the source of the cell file.")
        unit = chosen.get("unit") or header.unit or "m"
        seen, reach = Sightings(), _Reach()

        def make(rows: Rows) -> Recording:
            people = _table(rows.frame, rate_hz, _METRES[unit])
            if not header.titled and people.select("t_s", "person").is_duplicated().any():
                cause = "one id twice in a frame: the nameless columns are in another order, or a row was doubled"
                raise LogError(path, cause, cure='Say the order in [sources.map]: columns = "id frame x y".')
            seen.add(people)
            reach.add(people)
            return Recording(
                people=conform(only(people, options.body), PEOPLE),
                clock="relative",
                up="z",
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            seen.require(path, options.body)
            stated = "by the cell file" if "unit" in chosen else "by the header" if header.unit else "not in the file"
            facts = {
                "point": "as the tracker has it: usually the head or the feet",
                "columns": " ".join(header.names),
                "unit": f"{unit}, {stated}",
                "rate_hz": f"{rate_hz:g}, {'by the header' if header.rate_hz else 'by the cell file'}",
            }
            return replace(last, warnings=tuple(_warnings(header, reach.most_m, rate_hz, options)), facts=facts)

        layout = Layout(header.names, "\\s+" if header.delimiter == " " else header.delimiter, 0, quotes=True)
        numbers = ["frame", *(axis for axis in "xyz" if axis in header.names)]
        lines = _lines(path, header)
        required = ["frame", "id"]
        blocks = row_blocks(
            lines, layout, numbers=numbers, texts=["id"], required=required, first_line=header.lines + 1
        )
        yield from in_parts(path, blocks, make, finish)


def _ordered(path: Path, columns: str | None) -> _Header:
    """Return the header, its columns in the order that the file or the cell file states.

    Raises:
        DamagedLog: It is no such table.
        LogError: Nameless columns that are rather in the other order.
    """
    head = head_of(path, 1 << 20)
    header = _header(head, columns)
    if header is None:
        raise DamagedLog(path, "no table of frame, id, x and y", cure='Map it with adapter = "csv".')
    if header.titled:
        return header
    if columns is not None:
        return replace(header, names=(*columns.split(), *header.names[len(columns.split()) :]))
    rows = [row for row in _rows(head, header) if len(row) >= len(_ORDERS[0].split())]
    here, other = _step(rows, 0, 1), _step(rows, 1, 0)
    if here > _FARTHER * other > 0.0:
        cause = (
            f"the nameless columns are rather id, frame, x, y: taken as frame, id a person moves {here:.3g} between "
            f"two rows, the other way {other:.3g}"
        )
        raise LogError(path, cause, cure='Say the order in [sources.map]: columns = "id frame x y".')
    return header


_FARTHER = 5.0  # a stranger's place is metres away, one's own in the next frame is centimetres


def _step(rows: list[list[float]], frame: int, who: int) -> float:
    """Return how far a person typically moves in a frame, if these columns are frame and id; 0 where nobody goes on."""
    last: dict[float, list[float]] = {}
    steps = []
    for row in rows:
        before = last.get(row[who])
        if before is not None and row[frame] > before[frame]:
            far = max(abs(row[2] - before[2]), abs(row[3] - before[3]))
            steps.append(far / (row[frame] - before[frame]))
        last[row[who]] = row
    return median(steps) if steps else 0.0


@dataclass
class _Reach:
    """How far the places lie from zero, so far."""

    most_m: float = 0.0

    def add(self, people: pl.DataFrame) -> None:
        self.most_m = max(self.most_m, *(float(str(people[name].abs().max() or 0.0)) for name in ("x_m", "y_m")))


def _header(head: str, columns: str | None = None) -> _Header | None:
    """Take apart comments, a line of column names if there is one, and the first data row; None if it is no table.

    Nameless rows have four fields, or as many as `columns` names.
    """
    lines = head.split("\n", _LINES_LOOKED_AT)[:_LINES_LOOKED_AT]
    at = next((i for i, line in enumerate(lines) if line.strip() and not _is_comment(line)), len(lines))
    comments = [line.strip().lstrip("#").strip() for line in lines[:at] if line.strip()]
    named = _names(lines[at]) if at < len(lines) else None
    at += named is not None
    if named is None and comments:
        named = _names(comments[-1])
    row = lines[at].strip() if at < len(lines) else ""
    delimiter = next((mark for mark in "\t,;" if mark in row), " ")
    width = len(_cells(row, delimiter))
    nameless = len(columns.split()) if columns else 4
    if not (4 <= width <= _WIDEST) or (named is None and width != nameless) or (named and len(named[0]) > width):
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
    if len(line) > _LONGEST_TITLES:
        return None
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


def _rows(head: str, header: _Header) -> list[list[float]]:
    """Return the numbers of the first data rows, an empty list for what is no row of numbers."""
    whole = head.split("\n")[:-1] if len(head) >= HEAD_BYTES else head.split("\n")
    begin = whole[header.lines : header.lines + 2 * _LINES_LOOKED_AT]
    lines = [line for line in begin if line.strip() and not _is_comment(line)][:_LINES_LOOKED_AT]
    return [_floats(_cells(line, header.delimiter)) for line in lines]


def _looks_like_frames(head: str, header: _Header) -> bool:
    """Tell whether nameless rows can be frame, id, x, y: whole numbers that are counted, then two places."""
    rows = _rows(head, header)
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


def _table(frame: pl.DataFrame, rate_hz: float, metres: float) -> pl.DataFrame:
    number = pl.col("id").cast(pl.Float64, strict=False)
    counted = number.is_not_null() & (number == number.round()) & (number.abs() < 1e15)
    person = pl.when(counted).then(number.cast(pl.Int64, strict=False).cast(pl.String)).otherwise(pl.col("id"))
    places = {f"{axis}_m": pl.col(axis) * metres for axis in "xyz" if axis in frame.columns}
    t_s = pl.Series("t_s", frame["frame"].to_numpy() / rate_hz)
    return frame.select(t_s, person.alias("person"), "source_row", **places)


def _warnings(header: _Header, reach_m: float, rate_hz: float, options: ReadOptions) -> list[str]:
    said = []
    if header.rate_hz and options.rate_hz and abs(header.rate_hz - options.rate_hz) > 1e-9 * rate_hz:
        said.append(f"the header's rate ({header.rate_hz:g} Hz) is used, not the cell file's ({options.rate_hz:g} Hz)")
    if not header.titled and "columns" not in options.map:
        said.append("the columns have no names: they are taken as frame, id, x, y")
    if header.unit is None and "unit" not in options.map:
        said.append("no unit is stated: x and y are taken as metres; see `unit`")
    if reach_m > _SPREAD_M:
        said.append(f"places reach {reach_m:.0f} m: they may be centimetres, millimetres or pixels; see `unit`")
    return said


ADAPTER: StreamingAdapter = _Pedestrians()
