"""Header of a Qualisys TSV: keys, names, columns, and the frame clock.

`qualisys` interprets the columns.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.text.delimited import TextLayout
from cyclekit_adapters.text.header_line import has_decimal_comma
from cyclekit_adapters.text.text_blocks import file_encoding, head_of
from cyclekit_adapters.tracking.frame_clock import FRAME, TIME, FrameClock

if TYPE_CHECKING:
    from pathlib import Path

MARKERS, BODIES = "3D", "6D"
KEYS = frozenset(
    {
        *("FILE_VERSION", "NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "NO_OF_BODIES", "NO_OF_ANALOG"),
        *("FREQUENCY", "ANALOG_FREQUENCY", "DESCRIPTION", "TIME_STAMP", "DATA_INCLUDED", "EVENT"),
        *("MARKER_NAMES", "TRAJECTORY_TYPES", "BODY_NAMES"),
    }
)
_KEY = re.compile(r"[A-Z][A-Z0-9]*_[A-Z0-9_]+")  # an unknown key, but not a column name
_NAMES = {MARKERS: "MARKER_NAMES", BODIES: "BODY_NAMES"}
_HEADER_BYTES = 4 << 20
_LOOKED_AT = 20  # rows
_EXPORT = "Export the measurement again from QTM as TSV, 3D data with header"

Cells = tuple[str, str, str]


@dataclass(frozen=True)
class QualisysHeader:
    """Lines above the rows.

    Attributes:
        about: Values by key.
        kind: MARKERS or BODIES.
        names: Names of the markers or rigid bodies.
        cells: Columns of x, y, z of each.
        layout: Layout of the rows.
        clock: Frame clock.
        events: Line, name, frame and time (s; NaN if absent) of each event set in QTM.
    """

    about: dict[str, list[str]]
    kind: str
    names: tuple[str, ...]
    cells: tuple[Cells, ...]
    layout: TextLayout
    clock: FrameClock
    events: tuple[tuple[int, str, float, float], ...] = ()

    def facts(self) -> dict[str, str]:
        """Return facts about the measurement from the header."""
        passed_over = (*_NAMES.values(), "TRAJECTORY_TYPES", "EVENT")
        lines = {key: " ".join(values) for key, values in self.about.items() if key not in passed_over}
        return {key: value[:200] for key, value in lines.items() if value}


def read_header(path: Path, rate_hz: float | None) -> QualisysHeader:
    """Parse the header; `rate_hz` is used if the file gives no frequency.

    Raises:
        DamagedLog: The file holds other data, no names, or rows that do not match them.
        LogError: There is neither a frequency nor a Time column.
    """
    lines = [line.rstrip("\r") for line in head_of(path, _HEADER_BYTES).split("\n")]
    about: dict[str, list[str]] = {}
    events: list[tuple[int, str, float, float]] = []
    at = 0
    for at, line in enumerate(lines):  # `at` is needed after the loop, too
        key, *values = line.split("\t")
        if key not in KEYS and not (values and _KEY.fullmatch(key)):
            break
        about[key] = [value.strip() for value in values]
        if key == "EVENT" and len(values) > 1:
            frame, time = _number(about[key][1]), _number("".join(about[key][2:3]))
            events.append((at + 1, about[key][0], frame, time))
    kind = " ".join(about.get("DATA_INCLUDED", [MARKERS]))
    if kind not in _NAMES:
        cause = f"it holds {kind or 'no'} data, neither 3D trajectories of markers nor 6D rigid bodies"
        raise DamagedLog(path, cause, cure=f"{_EXPORT}.")
    names = tuple(name for name in about.get(_NAMES[kind], []) if name)
    if not names:
        raise DamagedLog(path, f"no positions: no {_NAMES[kind]} in the header", cure=f"{_EXPORT}.")
    first = [cell.strip() for cell in lines[at].split("\t")]
    titles = first if any(_is_word(cell) for cell in first) else []
    rows = lines[at + bool(titles) :]
    columns, cells = _columns(path, kind, names, titles, rows[0].split("\t") if rows else [])
    comma = has_decimal_comma(rows[:_LOOKED_AT], "\t")
    layout = TextLayout(columns, "\t", at + bool(titles), decimal_comma=comma, encoding=file_encoding(path) or "utf-8")
    clock = _clock(path, about, columns, rate_hz)
    clock.decide(rows, "\t", decimal_comma=comma)
    return QualisysHeader(about, kind, names, cells, layout, clock, tuple(events))


def _columns(
    path: Path, kind: str, names: tuple[str, ...], titles: list[str], row: list[str]
) -> tuple[tuple[str, ...], tuple[Cells, ...]]:
    """Return the column names (Frame and Time if present, then #0, #1, ...) and those of each marker or body."""
    if kind == BODIES:
        return _body_columns(path, names, titles)
    count = 3 * len(names)
    lead = tuple(title for title in titles[:2] if title in (FRAME, TIME))
    if not titles:
        width = len(row) - (len(row) > 1 and not row[-1].strip())  # data rows may also end with a tab
        if width not in (count, count + 2):
            cause = f"rows of {width} fields, where {len(names)} markers need {count}, or two more with time data"
            raise DamagedLog(path, cause, cure=f"{_EXPORT} and column names.")
        lead = (FRAME, TIME) if width > count else ()
    cells = tuple((f"#{i}", f"#{i + 1}", f"#{i + 2}") for i in range(0, count, 3))
    return (*lead, *(name for triple in cells for name in triple)), cells


def _body_columns(path: Path, names: tuple[str, ...], titles: list[str]) -> tuple[tuple[str, ...], tuple[Cells, ...]]:
    """Return the columns and those of x, y, z of each body, found by its name before X; bodies may be separated."""
    while titles and not titles[-1]:
        titles = titles[:-1]
    columns = tuple(title if title in (FRAME, TIME) and i < 2 else f"#{i}" for i, title in enumerate(titles))
    cells = []
    for name in names:
        at = titles.index(f"{name} X") if f"{name} X" in titles else len(titles)
        if titles[at + 1 : at + 3] != ["Y", "Z"]:
            cause = f"no columns X, Y, Z of the body {name!r}"
            raise DamagedLog(
                path, cause, cure="Export the 6DOF data again from QTM as TSV, with header and column names."
            )
        cells.append((columns[at], columns[at + 1], columns[at + 2]))
    return columns, tuple(cells)


def _clock(path: Path, about: dict[str, list[str]], columns: tuple[str, ...], rate_hz: float | None) -> FrameClock:
    stated = about.get("FREQUENCY", [""])[0].replace(",", ".")
    rate = float(stated) if _is_number(stated) else 0.0
    clock = FrameClock(tuple(name for name in columns[:2] if name in (FRAME, TIME)), rate or rate_hz or None, 1)
    if not clock.known:
        cause = "neither a frequency in Hz nor a Time column"
        raise LogError(path, cause, cure="Give rate_hz in the source, or export again with time data.")
    return clock


def _is_word(text: str) -> bool:
    try:
        return text.upper() not in ("", "NULL") and not isinstance(float(text.replace(",", ".", 1)), float)
    except ValueError:
        return True


def _number(text: str) -> float:
    """Return a number of the header; NaN if it is none."""
    return float(text.replace(",", ".")) if _is_number(text.replace(",", ".")) else math.nan


def _is_number(text: str) -> bool:
    try:
        return 0.0 <= float(text) < 1e9
    except ValueError:
        return False
