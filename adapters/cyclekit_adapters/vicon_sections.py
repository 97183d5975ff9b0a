"""The sections of a Vicon Nexus CSV: which there are, and the lines of the trajectories among them.

A section is a title, its rate in Hz, names, axes and units, then rows that begin with a frame number; a blank line
ends it. A spreadsheet fills that blank line with delimiters. What the trajectories mean is the business of `vicon`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit_adapters.delimited import Layout, delimiter_of, fields_of
from cyclekit_adapters.header_line import has_decimal_comma
from cyclekit_adapters.text_blocks import blocks_of, file_encoding

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TITLES = ("Trajectories", "Devices", "Model Outputs", "Segments", "Joints", "Events")
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
HEADER_LINES = 5
EXPORT = "Export the trial again from Nexus as ASCII, with trajectories"
_LOOKED_AT = 20  # rows
_FILL = b' \t,;\r\n"'
_BLANK = re.compile(rb'\n[ \t,;"]*\r?(?=\n)')  # found fast: rows begin with a digit

Triple = tuple[str, str, str]


@dataclass(frozen=True)
class Section:
    """The section of trajectories: its five header lines taken apart."""

    rate_hz: float
    layout: Layout
    markers: dict[str, Triple]
    metres: float


@dataclass
class Trajectories:
    """The lines of the first section of trajectories.

    Attributes:
        first: Number of its first line, known once lines were taken.
        titles: Those of all sections, known at the end.
    """

    path: Path
    first: int = 0
    titles: list[str] = field(default_factory=list)

    def lines(self) -> Iterator[bytes]:
        """Yield the lines of the section, from its title on, in pieces.

        Raises:
            LogError: The file cannot be opened.
        """
        number, inside, fresh = 1, False, True
        try:
            for piece, blank in _pieces(self.path):
                if fresh and (title := _title(piece)):
                    inside = title == "Trajectories" and "Trajectories" not in self.titles
                    self.titles.append(title)
                    self.first = number if inside else self.first
                if inside:
                    yield piece
                number, fresh = number + piece.count(b"\n"), blank
        except OSError as error:
            cause = f"cannot be read: {error.strerror}"
            raise LogError(self.path, cause, cure="Check the path and its rights.") from error

    def require(self) -> DamagedLog:
        """Return the error for a file without trajectories."""
        has = f"its sections are {', '.join(self.titles)}" if self.titles else "it has no section"
        return DamagedLog(self.path, f"no positions: {has}, and none is Trajectories", cure=f"{EXPORT}.")


def _pieces(path: Path) -> Iterator[tuple[bytes, bool]]:
    """Yield the lines of the file, many at once, and bare line ends (True) for the blank ones."""
    for block in blocks_of(path, file_encoding(path) or "utf-8"):
        begin = 0
        for blank in _BLANK.finditer(b"\n" + block):  # so that in `block` the blank line begins where this does
            if lines := block[begin : blank.start()]:
                yield lines, False
            yield b"\n", True
            begin = blank.end()
        if lines := block[begin:]:
            yield lines, False


def _title(piece: bytes) -> str:
    """Return the title that a piece begins with, "" if it goes on with rows.

    A known title, or a line of a single word: a section that Nexus had added since.
    """
    cells = [cell.strip(_FILL) for cell in re.split(rb"[,;\t]", piece.partition(b"\n")[0])]
    words = [cell.decode("utf-8", "replace") for cell in cells if cell]
    return words[0] if len(words) == 1 and words[0][:1].isalpha() else ""


def read_section(lines: Iterator[bytes], log: Trajectories) -> tuple[Section, Iterator[bytes]]:
    """Take the header lines apart; return them and the lines from the first header line on.

    Raises:
        DamagedLog: There is no such section, or its header is not whole.
    """
    taken: list[bytes] = []
    for piece in lines:
        taken.append(piece)
        if sum(part.count(b"\n") for part in taken) >= HEADER_LINES + _LOOKED_AT:
            break
    if not taken:
        raise log.require()
    first = b"".join(taken).decode("utf-8", "replace").split("\n", HEADER_LINES + _LOOKED_AT)
    rows = first[HEADER_LINES : HEADER_LINES + _LOOKED_AT]
    return _section(log.path, first[:HEADER_LINES], rows), chain(taken, lines)


def _section(path: Path, header: list[str], first_rows: list[str]) -> Section:
    if len(header) < HEADER_LINES:
        raise DamagedLog(path, "the header of the trajectories is cut", cure=f"{EXPORT}.")
    delimiter = delimiter_of(header[3], ",;\t")
    rows = [[cell.strip() for cell in fields_of(line, delimiter)] for line in header]
    rate_hz = rate_of(rows[1][0])
    if rate_hz is None:
        raise DamagedLog(path, f"no rate in the line below Trajectories: {rows[1][0][:40]!r}", cure=f"{EXPORT}.")
    titles, axes, units = (row + [""] * (len(rows[3]) - len(row)) for row in (rows[2], rows[3], rows[4]))
    width = max((i for i, cell in enumerate(axes) if cell), default=0) + 1
    markers: dict[str, Triple] = {}
    named = set()
    for at in range(2, width - 2):
        if titles[at] and axes[at : at + 3] == ["X", "Y", "Z"] and titles[at] not in markers:
            markers[titles[at]] = (f"#{at}", f"#{at + 1}", f"#{at + 2}")
            named.update(units[at : at + 3])
    if not markers or rows[3][0] != "Frame":
        raise DamagedLog(path, "no positions: no names over columns X, Y, Z", cure=f"{EXPORT}.")
    unit = named.pop() if len(named) == 1 else f"{', '.join(sorted(named))}"
    if unit not in METRES:
        cause = f"unknown length unit {unit!r}"
        raise DamagedLog(path, cause, nearest=nearest(unit, METRES), cure=f"{EXPORT} in mm.")
    columns = ("Frame", "Sub Frame", *(f"#{at}" for at in range(2, width)))
    layout = Layout(columns, delimiter, HEADER_LINES, decimal_comma=has_decimal_comma(first_rows, delimiter))
    return Section(rate_hz, layout, markers, METRES[unit])


def rate_of(text: str) -> float | None:
    """Return the rate in the line below a title, None if it is none."""
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        return None
    return value if 0.0 < value < 1e6 else None
