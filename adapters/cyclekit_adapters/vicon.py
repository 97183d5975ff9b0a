"""Vicon Nexus CSV: the section Trajectories of an ASCII export.

A file is one or more sections with a blank line between them; each has a title, its rate in Hz, names over the first of
their three columns, `Frame, Sub Frame, X, Y, Z, ...`, and a row of units. Only marker trajectories are positions of
people: a file of devices or model outputs alone is refused. A person is the middle of the pelvis markers seen, by
subject (`Subject:Marker`). The clock is the trial's, (frame - 1) / rate: no time is in the file. Which axis is up is
not in it either; Nexus is Z up unless the cell file says `up = "y"`.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.delimited import Layout, delimiter_of, fields_of, rows_of
from cyclekit_adapters.markers import choose_people, marker_facts, marker_warnings, marker_words, people_table
from cyclekit_adapters.text_blocks import blocks_of, file_encoding, head_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_TITLES = ("Trajectories", "Devices", "Model Outputs", "Segments", "Joints")
_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_HEADER_LINES = 5
_HEADER_BYTES = 1 << 20  # hundreds of markers and channels
_EXPORT = "Export the trial again from Nexus as ASCII, with trajectories"


@dataclass(frozen=True)
class _Section:
    """The section of trajectories: its five header lines taken apart."""

    rate_hz: float
    layout: Layout
    markers: dict[str, tuple[str, str, str]]
    metres: float


class _ViconCsv:
    def recognises(self, path: Path) -> bool:
        title = head_of(path, 64).lstrip('"')
        if not title.startswith(_TITLES):
            return False
        lines = head_of(path, _HEADER_BYTES).splitlines()
        if len(lines) < _HEADER_LINES - 1:
            return False
        delimiter = delimiter_of(lines[3], ",;\t")
        first = [fields_of(line, delimiter)[0].strip() for line in lines[:2]]
        return first[0] in _TITLES and _number(first[1]) is not None and lines[3].startswith("Frame" + delimiter)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        up = marker_words(options, "Vicon")
        lines, first, titles = _trajectories(path)
        section = _section(path, [line.decode("utf-8", "replace") for line in lines[:_HEADER_LINES]])
        names = tuple(section.markers)
        people = choose_people(path, names, options, "Vicon")
        cells = [cell for triple in section.markers.values() for cell in triple]
        body = [b"".join(lines)]
        rows = rows_of(body, section.layout, numbers=["Frame", *cells], required=["Frame"], first_line=first)
        rows = rows.or_refuse(path)
        points = np.stack([rows.frame.select(triple).to_numpy() for triple in section.markers.values()], axis=1).astype(
            np.float64
        )
        t_s = (rows.frame["Frame"].to_numpy() - 1.0) / section.rate_hz
        table = people_table(people, points * section.metres, t_s, rows.frame["source_row"].to_numpy())
        said = marker_warnings(people, table, options)
        if (t_s[1:] <= t_s[:-1]).any():
            said.append("frames do not increase throughout: the rows were edited or joined")
        return Recording(
            people=conform(table, PEOPLE),
            clock="relative",
            up=cast('Literal["y", "z"]', up or "z"),
            rows_are="line",
            rows_read=rows.rows_read,
            set_aside=rows.set_aside,
            warnings=tuple(said),
            facts={
                "rate_hz": f"{section.rate_hz:g}",
                "unit": next(name for name, metres in _METRES.items() if metres == section.metres),
                "up": f"{up}, by the cell file" if up else "z, as Nexus has it; not in the file",
                "sections": ", ".join(titles),
                **marker_facts(people, names),
            },
        )


def _number(text: str) -> float | None:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        return None
    return value if 0.0 < value < 1e6 else None


def _lines(path: Path) -> Iterator[bytes]:
    try:
        for block in blocks_of(path, file_encoding(path) or "utf-8"):
            yield from io.BytesIO(block)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its rights.") from error


def _trajectories(path: Path) -> tuple[list[bytes], int, list[str]]:
    """Return the lines of the trajectories with their header, the number of the first, and all sections' titles."""
    titles: list[str] = []
    found: list[bytes] = []
    begins, inside, first = True, False, 1
    for number, line in enumerate(_lines(path), 1):
        text = line.strip(b' \t,;\r\n"')
        if not text:  # a spreadsheet fills a blank line with delimiters
            begins, inside = True, False
        elif begins:
            title = text.decode("utf-8", "replace")
            begins = title not in _TITLES
            inside = title == "Trajectories" and not found
            if not begins:
                titles.append(title)
        if inside:
            first = first if found else number
            found.append(line)
    if not found:
        has = f"its sections are {', '.join(titles)}" if titles else "it has no section"
        raise DamagedLog(path, f"no positions: {has}, and none is Trajectories", cure=f"{_EXPORT}.")
    return found, first, titles


def _section(path: Path, header: list[str]) -> _Section:
    if len(header) < _HEADER_LINES:
        raise DamagedLog(path, "the header of the trajectories is cut", cure=f"{_EXPORT}.")
    delimiter = delimiter_of(header[3], ",;\t")
    rows = [[cell.strip() for cell in fields_of(line, delimiter)] for line in header]
    rate_hz = _number(rows[1][0])
    if rate_hz is None:
        raise DamagedLog(path, f"no rate in the line below Trajectories: {rows[1][0][:40]!r}", cure=f"{_EXPORT}.")
    titles, axes, units = (row + [""] * (len(rows[3]) - len(row)) for row in (rows[2], rows[3], rows[4]))
    width = max((i for i, cell in enumerate(axes) if cell), default=0) + 1
    markers: dict[str, tuple[str, str, str]] = {}
    named = set()
    for at in range(2, width - 2):
        if titles[at] and axes[at : at + 3] == ["X", "Y", "Z"] and titles[at] not in markers:
            markers[titles[at]] = (f"#{at}", f"#{at + 1}", f"#{at + 2}")
            named.update(units[at : at + 3])
    if not markers or rows[3][0] != "Frame":
        raise DamagedLog(path, "no positions: no names over columns X, Y, Z", cure=f"{_EXPORT}.")
    unit = named.pop() if len(named) == 1 else f"{', '.join(sorted(named))}"
    if unit not in _METRES:
        cause = f"unknown length unit {unit!r}"
        raise DamagedLog(path, cause, nearest=nearest(unit, _METRES), cure=f"{_EXPORT} in mm.")
    columns = ("Frame", "Sub Frame", *(f"#{at}" for at in range(2, width)))
    comma = delimiter == ";"
    layout = Layout(columns, delimiter, _HEADER_LINES, decimal_comma=comma)
    return _Section(rate_hz, layout, markers, _METRES[unit])


ADAPTER: Adapter = _ViconCsv()
