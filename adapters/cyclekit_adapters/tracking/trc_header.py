"""Header of a TRC file: rate, unit, marker names, and the first line of the rows.

Line 1 is `PathFileType`, line 2 names the values in line 3 (`DataRate`, `NumFrames`, `NumMarkers`, `Units`, ...), line
4 holds `Frame#`, `Time` and the marker names, line 5 `X1 Y1 Z1 ...`; a blank line may follow. Names are read in order,
because some writers omit the empty cells after them. `trc` interprets the rows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, nearest
from cyclekit.text.numbers import count
from cyclekit_adapters.text.delimited import TextLayout, delimiter_of, fields_of
from cyclekit_adapters.text.header_line import has_decimal_comma
from cyclekit_adapters.text.text_blocks import file_encoding, head_lines
from cyclekit_adapters.text.text_layout import MAX_COLUMNS
from cyclekit_adapters.tracking.frame_clock import FRAME, MAX_HZ, TIME, FrameClock, positive
from cyclekit_adapters.tracking.length_unit import METRES, unit_of

if TYPE_CHECKING:
    from pathlib import Path

FIRST = "PathFileType"
_NAMES, _AXES = 3, 4  # line indices
_LOOKED_AT = 200  # rows
_KEYS = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units")
_WRITE = "Write the file again with OpenSim or Pose2Sim, or copy it again."
_WHOLE_FRAME = 0.1
"""Tolerance, frames: deviation of a time in the first row from a whole frame, due to rounding by writers."""


@dataclass(frozen=True)
class TrcHeader:
    """Lines above the rows.

    Attributes:
        about: Values of line 3 by the keys of line 2.
        names: Marker names, in the order of their columns.
        layout: Layout of the rows: Frame, Time, then #0, #1, ... for x, y, z of each marker.
        clock: Frame clock.
        unit: A key of METRES.
        rows: Cells of the first rows.
    """

    about: dict[str, str]
    names: tuple[str, ...]
    layout: TextLayout
    clock: FrameClock
    unit: str
    rows: tuple[tuple[str, ...], ...]

    def cells(self, marker: int) -> tuple[str, str, str]:
        """Return the columns of x, y and z of a marker."""
        return (f"#{3 * marker}", f"#{3 * marker + 1}", f"#{3 * marker + 2}")

    @property
    def frames_stated(self) -> int:
        """Number of frames given in line 3; 0 if absent."""
        return int(positive(self.about.get("NumFrames", ""), below=1e9) or 0)


def read_header(path: Path, rate_hz: float | None) -> TrcHeader:
    """Parse the header; `rate_hz` is used if the file gives no rate.

    Raises:
        DamagedLog: The header is incomplete, has no known unit, or its counts contradict each other.
        LogError: The file cannot be opened.
    """
    encoding = file_encoding(path) or "utf-8"
    lines = head_lines(path, _AXES + 2 + _LOOKED_AT)
    if len(lines) <= _AXES or not lines[0].lstrip('"').startswith(FIRST):
        cause = f"line {len(lines)}: the header is cut" if len(lines) > 1 else "line 1: no header of a TRC file"
        raise DamagedLog(path, cause, cure=_WRITE)
    about = _about(path, lines)
    unit = _unit(path, about)
    begin = next((i for i in range(_AXES, len(lines)) if lines[i].strip() and not _are_axes(lines[i])), len(lines))
    delimiter = "\t" if "\t" in lines[_NAMES] else delimiter_of(lines[_NAMES], ",; ")
    names = _names(path, lines[_NAMES], delimiter)
    rows = [line for line in lines[begin:] if line.strip()]
    delimiter = "\\s+" if delimiter == " " or (rows and delimiter not in rows[0]) else delimiter
    cells = [tuple(cell.strip() for cell in fields_of(row, delimiter)) for row in rows]
    _require_counts(path, about, names, lines, cells[0] if cells else (), begin)
    comma = has_decimal_comma(rows, delimiter)
    columns = (FRAME, TIME, *(f"#{i}" for i in range(3 * len(names))))
    layout = TextLayout(columns, delimiter, begin, decimal_comma=comma, encoding=encoding)
    rate = positive(about.get("DataRate", ""), below=MAX_HZ) or rate_hz
    points = [tuple(cell.replace(",", ".") if comma else cell for cell in row) for row in cells]
    return TrcHeader(about, names, layout, _clock(points, rate), unit, tuple(points))


def _about(path: Path, lines: list[str]) -> dict[str, str]:
    keys, values = _words(lines[1]), _words(lines[2])
    if "Units" not in keys or "DataRate" not in keys:
        cause = f"line 2: no DataRate and Units among {', '.join(keys)[:80] or 'nothing'}"
        raise DamagedLog(path, cause, cure=_WRITE)
    if len(values) < len(_KEYS):
        cause = f"line 3: {len(values)} values where line 2 names {len(keys)}"
        raise DamagedLog(path, cause, cure=_WRITE)
    return dict(zip(keys, values, strict=False))


def _unit(path: Path, about: dict[str, str]) -> str:
    unit = unit_of(about.get("Units", ""))
    if unit not in METRES:
        cause = f"line 3: unknown length unit {about.get('Units', '')[:20]!r}"
        raise DamagedLog(path, cause, nearest=nearest(unit, METRES), cure=f"Known: {', '.join(METRES)}.")
    return unit


def _names(path: Path, line: str, delimiter: str) -> tuple[str, ...]:
    if line.count(delimiter) >= MAX_COLUMNS:
        cause = f"line 4: more than {count(MAX_COLUMNS)} columns: no tracker writes that"
        raise DamagedLog(path, cause, cure="Check what the file is.")
    cells = [cell.strip() for cell in (line.split() if delimiter == " " else fields_of(line, delimiter))]
    named = [cell for cell in cells if cell]
    if len(named) < 3 or not named[0].lower().startswith("frame") or not named[1].lower().startswith("time"):
        cause = f"line 4: no Frame#, Time and names of markers: {line.strip()[:60]!r}"
        raise DamagedLog(path, cause, cure=_WRITE)
    return tuple(named[2:])


def _words(line: str) -> list[str]:
    """Return the words between tabs or blanks, else between commas or semicolons."""
    words = line.strip().split()
    return words if len(words) > 1 else re.split("[,;]", line.strip())


def _are_axes(line: str) -> bool:
    """Return whether a line is `X1 Y1 Z1 X2 ...`."""
    return [cell[:1].upper() for cell in _words(line) if cell][:3] == ["X", "Y", "Z"]


def _require_counts(
    path: Path, about: dict[str, str], names: tuple[str, ...], lines: list[str], row: tuple[str, ...], begin: int
) -> None:
    """Refuse names, axes and rows with contradicting counts, because columns cannot be assigned to markers."""
    due = 3 * len(names)
    axes = sum(bool(cell) for cell in _words(lines[_AXES])) if _are_axes(lines[_AXES]) else due
    filled = max((i + 1 for i, cell in enumerate(row) if cell), default=0)
    faults = []
    if axes != due:
        faults.append(f"line 5: {axes} axes where the {len(names)} names in line 4 need {due}")
    if filled > due + 2:
        faults.append(f"line {begin + 1}: {filled} fields where the {len(names)} names in line 4 need {due + 2}")
    if faults:
        stated = about.get("NumMarkers", "none")
        raise DamagedLog(path, f"{'; '.join(faults)} (line 3: {stated[:9]} markers)", cure=_WRITE)


_MOST_FRAMES = 1e15
"""Numbers of frames beyond it are no numbers of frames: 30,000 years at 1000 Hz."""


def _clock(rows: list[tuple[str, ...]], rate_hz: float | None) -> FrameClock:
    """Return the clock: frame / rate with the zero of the Time column, or the Time column if the two contradict."""
    clock = FrameClock((FRAME, TIME), rate_hz, 1)
    begin = next((pair for row in rows if (pair := _pair(row))), None)
    if rate_hz and begin:
        zero = begin[0] - begin[1] * rate_hz
        clock.first = round(zero) if abs(zero) < _MOST_FRAMES else 0
        clock.by_time = abs(zero - clock.first) > _WHOLE_FRAME + 1e-3 * rate_hz
    if not clock.by_time:
        clock.decide(["\t".join(row) for row in rows], "\t")
    return clock


def _pair(row: tuple[str, ...]) -> tuple[float, float] | None:
    try:
        return float(row[0]), float(row[1])
    except (ValueError, IndexError):
        return None
