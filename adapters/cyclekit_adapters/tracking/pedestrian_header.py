"""Columns, unit and rate of a pedestrian table, from its comments, names and first rows.

Refused are unnamed columns that are probably in another order, and numbers without a unit that cannot be metres: both
would give wrong positions without notice. `pedestrian` interprets the rows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from statistics import median
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, LogError
from cyclekit.text.numbers import compact
from cyclekit_adapters.text.text_blocks import HEAD_BYTES, head_of

if TYPE_CHECKING:
    from pathlib import Path

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_RATE = re.compile(r"(?:frame\s?_?rate|\bfps)\s*[:=]?\s*([0-9]+(?:\.[0-9]+)?)", re.IGNORECASE)
_IN_UNIT = re.compile(r"\bin (mm|cm|m|metres|meters)\b")
_TITLES = {
    "frame": "frame", "frame_id": "frame", "frameid": "frame", "fr": "frame", "frame_number": "frame",
    "id": "id", "persid": "id", "pers_id": "id", "ped": "id", "ped_id": "id", "pedid": "id",
    "pedestrian": "id", "pedestrian_id": "id", "track_id": "id",
    "agent": "id", "agent_id": "id", "person": "id", "person_id": "id", "personid": "id", "x": "x", "y": "y", "z": "z",
    "pos_x": "x", "pos_y": "y", "pos_z": "z",
}  # fmt: skip
_TIMES = frozenset({"t", "time", "timestamp", "time_s", "seconds"})  # a table with times needs no rate: map it
_TALLEST_M = 4.0
_FASTEST_M_S = 15.0  # faster than any runner; centimetres read as metres give 100 times walking speed
_WIDEST = 64
_LONGEST_TITLES = 64 * _WIDEST
_LINES_LOOKED_AT = 200
CORRUPT = 0.05
"""Maximum share of corrupt rows in a table without names: a few are set aside, more are of another table. Half or twice
of it takes a table with 1 in 40 or 1 in 10 for one."""
_FARTHER = 5.0  # another person is metres away, the same person in the next frame centimetres


@dataclass(frozen=True)
class PedestrianHeader:
    """Number of lines above the data, column names (`frame`, `id`, `x`, `y`, `z` or #n), unit and rate if given."""

    lines: int
    names: tuple[str, ...]
    delimiter: str
    unit: str | None
    rate_hz: float | None
    titled: bool


def read_header(path: Path, columns: str | None) -> PedestrianHeader:
    """Return the header, with columns in the order given in the file or the cell file.

    Raises:
        DamagedLog: The file is no such table.
        LogError: Unnamed columns are probably in the other order.
    """
    head = head_of(path, 1 << 20)
    header = header_of(head, columns)
    if header is None:
        raise DamagedLog(path, "not a table of frame, id, x and y", cure='Map it with adapter = "csv".')
    if header.titled:
        return header
    if columns is not None:
        return replace(header, names=(*columns.split(), *header.names[len(columns.split()) :]))
    rows = _rows(head, header)
    here, other = _step(rows, header.names), _step(rows, ("id", "frame", *header.names[2:]))
    if here > _FARTHER * other > 0.0:
        cause = (
            f"the unnamed columns are probably id, frame, x, y: read as frame, id a person moves {compact(here, 3)} "
            f"between two rows, read the other way {compact(other, 3)}"
        )
        raise LogError(path, cause, cure='Give the order in [sources.map]: columns = "id frame x y".')
    return header


def _step(rows: list[list[float]], names: tuple[str, ...]) -> float:
    """Return the median step of a person per frame under these column names; 0 if no person occurs twice."""
    frame, who, x, y = (names.index(name) for name in ("frame", "id", "x", "y"))
    last: dict[float, list[float]] = {}
    steps = []
    for row in rows:
        if len(row) < len(names):
            continue
        before = last.get(row[who])
        if before is not None and row[frame] > before[frame]:
            far = max(abs(row[x] - before[x]), abs(row[y] - before[y]))
            steps.append(far / (row[frame] - before[frame]))
        last[row[who]] = row
    return median(steps) if steps else 0.0


def check_metres(path: Path, header: PedestrianHeader, rate_hz: float) -> str:
    """Return "m" for a table without a unit, if people then have plausible heights and speeds.

    Raises:
        LogError: Heights or speeds in metres are implausible.
    """
    rows = [row for row in _rows(head_of(path, 1 << 20), header) if len(row) >= len(header.names)]
    heights = [abs(row[header.names.index("z")]) for row in rows] if "z" in header.names else []
    speed_m_s = _step(rows, header.names) * rate_hz
    cause = ""
    if heights and median(heights) > _TALLEST_M:
        cause = f"in metres people would be {compact(median(heights), 3)} m above the floor"
    elif speed_m_s > _FASTEST_M_S:
        cause = f"in metres people would move at {compact(speed_m_s, 3)} m/s"
    if cause:
        raise LogError(
            path, f"no unit is stated, and {cause}", cure='Give it in [sources.map]: unit = "cm" (or "mm", "m").'
        )
    return "m"


def header_of(head: str, columns: str | None = None) -> PedestrianHeader | None:
    """Parse comments, an optional line of column names, and the first data row; None if the text is no such table.

    Rows without names have four fields, or as many as `columns` lists.
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
    return PedestrianHeader(at, names, delimiter, unit or _unit_of(comments), rate_hz, named is not None)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else line.strip().split(delimiter)


def _unit_of(comments: list[str]) -> str | None:
    """Return the unit in a comment (`... coordinates in meters`)."""
    found = next((match[1] for line in comments if (match := _IN_UNIT.search(line.lower()))), None)
    return "m" if found in ("metres", "meters") else found


def _names(line: str) -> tuple[tuple[str, ...], str | None] | None:
    """Return the canonical names and the unit in a line of column names; None if it is no such line."""
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
        if name in ("x", "y") and unit in METRES:
            units.add(unit)
    if not {"frame", "id", "x", "y"}.issubset(names) or _TIMES.intersection(titles):
        return None
    return tuple(names), units.pop() if len(units) == 1 else None


def _rows(head: str, header: PedestrianHeader) -> list[list[float]]:
    """Return the numbers of the first data rows; an empty list for a row that is not numeric."""
    whole = head.split("\n")[:-1] if len(head) >= HEAD_BYTES else head.split("\n")
    begin = whole[header.lines : header.lines + 2 * _LINES_LOOKED_AT]
    lines = [line for line in begin if line.strip() and not _is_comment(line)][:_LINES_LOOKED_AT]
    return [_floats(_cells(line, header.delimiter)) for line in lines]


def looks_like_frames(head: str, header: PedestrianHeader) -> bool:
    """Return whether unnamed rows may be frame, id, x, y: two counting integers, then two coordinates."""
    rows = _rows(head, header)
    good = {(row[0], row[1]): row[2:] for row in rows if len(row) == 4 and _counts_and_places(row)}
    fractions = any(number % 1 for places in good.values() for number in places)
    named = not rows or len(rows[0]) != 4  # the first line holds other names
    return fractions and not named and len(rows) >= 2 and len(good) >= (1.0 - CORRUPT) * len(rows)


def _counts_and_places(row: list[float]) -> bool:
    counted = all(0 <= number < 1e9 and number % 1 == 0 for number in row[:2])
    return counted and all(abs(number) < 1e6 for number in row[2:])


def _floats(cells: list[str]) -> list[float]:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return []
