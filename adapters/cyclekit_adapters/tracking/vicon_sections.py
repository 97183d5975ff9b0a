"""Sections of a Vicon CSV: their titles, and the lines of the section that holds positions.

A section is a title, its rate in Hz, names, axes and units, then rows that start with a frame number; a blank line ends
it. A spreadsheet fills that blank line with delimiters. Markers have X, Y, Z below their name; segments and objects
have a rotation (RX, RY, RZ, with RW for a quaternion) and TX, TY, TZ. `vicon` interprets them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit_adapters.text.delimited import TextLayout, delimiter_of, fields_of
from cyclekit_adapters.text.header_line import has_decimal_comma
from cyclekit_adapters.text.text_blocks import blocks_of, file_encoding
from cyclekit_adapters.tracking.frame_clock import MAX_HZ, positive

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TRAJECTORIES = "Trajectories"
WITH_PLACES = (TRAJECTORIES, "Objects", "Segments")
"""Sections that hold positions, in order of preference."""
TITLES = (*WITH_PLACES, "Devices", "Model Outputs", "Joints", "Events")
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
HEADER_LINES = 5
EXPORT = "Export the trial again from Nexus as ASCII, with trajectories"
_MARKER, _TRANSLATION = ["X", "Y", "Z"], ["TX", "TY", "TZ"]
_ANGLES = re.compile(r"^Global Angle (?:\([^)]*\) )?")
_LOOKED_AT = 20  # rows
_FILL = b' \t,;\r\n"'
_BLANK = re.compile(rb'\n[ \t,;"]*\r?(?=\n)')  # fast to search: rows start with a digit

Triple = tuple[str, str, str]


@dataclass(frozen=True)
class Section:
    """A section of positions: its five parsed header lines; columns of positions by marker or segment."""

    rate_hz: float
    layout: TextLayout
    places: dict[str, Triple]
    metres: float


@dataclass
class Sections:
    """Reader of the first section with a given title.

    Attributes:
        path: The file.
        title: Title of the section.
        first: Number of its first line, known after iteration has started.
        titles: Titles of all sections, complete at the end.
    """

    path: Path
    title: str
    first: int = 0
    titles: list[str] = field(default_factory=list)

    def lines(self) -> Iterator[bytes]:
        """Yield the lines of the section, starting with its title, in pieces.

        Raises:
            LogError: The file cannot be opened.
        """
        number, inside, fresh = 1, False, True
        try:
            for piece, blank in _pieces(self.path):
                if fresh and (title := _title(piece)):
                    inside = title == self.title and title not in self.titles
                    self.titles.append(title)
                    self.first = number if inside else self.first
                if inside:
                    yield piece
                number, fresh = number + piece.count(b"\n"), blank
        except OSError as error:
            cause = f"cannot be read: {error.strerror}"
            raise LogError(self.path, cause, cure="Check the path and its permissions.") from error


def open_section(path: Path, title: str | None) -> tuple[Sections, Section, Iterator[bytes]]:
    """Find the section that holds positions, or the one called `title`, and parse its header lines.

    Returns:
        The sections reader, the section, and its lines from the first header line on.

    Raises:
        DamagedLog: There is no such section, or its header is incomplete.
        LogError: The file cannot be opened.
    """
    log = Sections(path, "")
    for name in (title,) if title else WITH_PLACES:
        log = Sections(path, name)
        lines = log.lines()
        taken = _begin_of(lines)
        if taken:
            return log, _section(log, taken), chain(taken, lines)
    has = f"its sections are {', '.join(log.titles)}" if log.titles else "it has no section"
    wanted = f"is {title}" if title else f"is {', '.join(WITH_PLACES[:-1])} or {WITH_PLACES[-1]}"
    raise DamagedLog(path, f"no positions: {has}, and none {wanted}", cure=f"{EXPORT}.")


def _pieces(path: Path) -> Iterator[tuple[bytes, bool]]:
    """Yield the lines of the file in pieces of many lines, and each blank line as a bare line end with True."""
    for block in blocks_of(path, file_encoding(path) or "utf-8"):
        begin = 0
        for blank in _BLANK.finditer(b"\n" + block):  # match starts are offsets in `block`
            if lines := block[begin : blank.start()]:
                yield lines, False
            yield b"\n", True
            begin = blank.end()
        if lines := block[begin:]:
            yield lines, False


def _title(piece: bytes) -> str:
    """Return the title at the start of a piece; "" if the piece continues with rows.

    A title is a line of a single word, known or not, because Nexus may add sections.
    """
    cells = [cell.strip(_FILL) for cell in re.split(rb"[,;\t]", piece.partition(b"\n")[0])]
    words = [cell.decode("utf-8", "replace") for cell in cells if cell]
    return words[0] if len(words) == 1 and words[0][:1].isalpha() else ""


def _begin_of(lines: Iterator[bytes]) -> list[bytes]:
    """Take the header lines and the first rows; empty if the section is absent."""
    taken: list[bytes] = []
    for piece in lines:
        taken.append(piece)
        if sum(part.count(b"\n") for part in taken) >= HEADER_LINES + _LOOKED_AT:
            break
    return taken


def _section(log: Sections, begin: list[bytes]) -> Section:
    lines = b"".join(begin).decode("utf-8", "replace").split("\n", HEADER_LINES + _LOOKED_AT)
    header, first_rows = lines[:HEADER_LINES], lines[HEADER_LINES : HEADER_LINES + _LOOKED_AT]
    if len(header) < HEADER_LINES:
        cause = f"line {log.first}: the header of the section {log.title} is cut"
        raise DamagedLog(log.path, cause, cure=f"{EXPORT}.")
    delimiter = delimiter_of(header[3], ",;\t")
    rows = [[cell.strip() for cell in fields_of(line, delimiter)] for line in header]
    rate_hz = positive(rows[1][0], below=MAX_HZ)
    if rate_hz is None:
        cause = f"line {log.first + 1}: no rate in the line below {log.title}: {rows[1][0][:40]!r}"
        raise DamagedLog(log.path, cause, cure=f"{EXPORT}.")
    titles, axes, units = (row + [""] * (len(rows[3]) - len(row)) for row in (rows[2], rows[3], rows[4]))
    width = max((i for i, cell in enumerate(axes) if cell), default=0) + 1
    found = _places(titles, axes[:width])
    if not found or rows[3][0] != "Frame":
        axes_due = "X, Y, Z" if log.title == TRAJECTORIES else "TX, TY, TZ"
        cause = f"lines {log.first + 2} and {log.first + 3}: no positions: no names over columns {axes_due}"
        raise DamagedLog(log.path, cause, cure=f"{EXPORT}.")
    named = {unit for at in found.values() for unit in units[at : at + 3]}
    unit = named.pop() if len(named) == 1 else f"{', '.join(sorted(named))}"
    if unit not in METRES:
        cause = f"line {log.first + 4}: unknown length unit {unit!r}"
        raise DamagedLog(log.path, cause, nearest=nearest(unit, METRES), cure=f"{EXPORT} in mm.")
    places = {name: (f"#{at}", f"#{at + 1}", f"#{at + 2}") for name, at in found.items()}
    columns = ("Frame", "Sub Frame", *(f"#{at}" for at in range(2, width)))
    layout = TextLayout(columns, delimiter, HEADER_LINES, decimal_comma=has_decimal_comma(first_rows, delimiter))
    return Section(rate_hz, layout, places, METRES[unit])


def _places(titles: list[str], axes: list[str]) -> dict[str, int]:
    """Return the x column for each name, which is above it or above the rotation before it; the first one counts."""
    found: dict[str, int] = {}
    for at, title in enumerate(titles[: len(axes)]):
        if at < 2 or not title:
            continue
        if axes[at : at + 3] == _MARKER:
            found.setdefault(title, at)
        for x in (at, at + 3, at + 4):  # no rotation, angles, a quaternion
            if axes[x : x + 3] == _TRANSLATION:
                found.setdefault(_ANGLES.sub("", title), x)
                break
    return found
