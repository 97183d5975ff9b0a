"""Qualisys Track Manager TSV: 3D trajectories of markers.

Header lines are a key, a tab and values; a row of column names may follow, with a trailing tab that the data rows do
not have; Frame and Time columns are optional. A person is the middle of the pelvis markers seen. Lengths are
millimetres; Z is up unless the cell file says `up = "y"`. An empty cell, `NULL` and a place of exactly 0, 0, 0 are a
marker that was not seen. The clock is the measurement's, (frame - 1) / frequency: `TIME_STAMP` counts from the start of
the PC, and Qualisys advises against using it. With an external timebase (`FREQUENCY EXT`) the Time column is the clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.delimited import INDEX, Layout, Rows, read_rows
from cyclekit_adapters.markers import choose_people, marker_facts, marker_warnings, marker_words, people_table
from cyclekit_adapters.text_blocks import file_encoding, head_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Numbers = NDArray[np.float64]

_HEADER_BYTES = 4 << 20
_KEYS = frozenset(
    {
        *("FILE_VERSION", "NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "NO_OF_BODIES", "NO_OF_ANALOG"),
        *("FREQUENCY", "ANALOG_FREQUENCY", "DESCRIPTION", "TIME_STAMP", "DATA_INCLUDED", "EVENT"),
        *("MARKER_NAMES", "TRAJECTORY_TYPES", "BODY_NAMES"),
    }
)
_MM = 1e-3
_MEASURED = "Measured"
_EXPORT = "Export the measurement again from QTM as TSV, 3D data with header"


@dataclass(frozen=True)
class _Header:
    """Keys above the data, marker names, and which columns there are."""

    about: dict[str, list[str]]
    markers: tuple[str, ...]
    layout: Layout
    rate_hz: float | None


class _QualisysTsv:
    def recognises(self, path: Path) -> bool:
        lines = head_of(path).splitlines()
        keys = [line.partition("\t")[0] for line in lines[:12] if "\t" in line]
        return bool(keys) and keys[0] in ("FILE_VERSION", "NO_OF_FRAMES") and len(_KEYS.intersection(keys)) >= 3

    def read(self, path: Path, options: ReadOptions) -> Recording:
        up = marker_words(options, "Qualisys")
        header = _header(path, options)
        people = choose_people(path, header.markers, options, "Qualisys")
        cells = [name for name in header.layout.names if name.startswith("#")]
        clock = [name for name in ("Frame", "Time") if name in header.layout.names]
        rows = read_rows(path, header.layout, numbers=[*clock, *cells], required=clock[:1]).or_refuse(path)
        t_s, clock_said = _times(path, rows, header)
        raw = rows.frame.select(cells).to_numpy().astype(np.float64)
        points = raw.reshape(len(raw), -1, 3)
        points[(points == 0.0).all(axis=2)] = np.nan
        table = people_table(people, points * _MM, t_s, rows.frame["source_row"].to_numpy())
        said = [*clock_said, *marker_warnings(people, table, options), *_filled(header, people.tracks)]
        told = {key: " ".join(values) for key, values in header.about.items() if key not in ("MARKER_NAMES", "EVENT")}
        return Recording(
            people=conform(table, PEOPLE),
            clock="relative",
            up=cast('Literal["y", "z"]', up or "z"),
            rows_are="line",
            rows_read=rows.rows_read,
            set_aside=rows.set_aside,
            warnings=tuple(said),
            facts={
                **{key: value[:200] for key, value in told.items() if value and key != "TRAJECTORY_TYPES"},
                "unit": "mm, as the format has it",
                "up": f"{up}, by the cell file" if up else "z, as QTM has it; not in the file",
                **marker_facts(people, header.markers),
            },
        )


def _header(path: Path, options: ReadOptions) -> _Header:
    lines = head_of(path, _HEADER_BYTES).split("\n")
    about: dict[str, list[str]] = {}
    at = 0
    for at, line in enumerate(lines):  # noqa: B007  # where the keys end is what is wanted
        key, *values = line.rstrip("\r\n").split("\t")
        if key not in _KEYS:
            break
        about[key] = [value.strip() for value in values]
    markers = tuple(name for name in about.get("MARKER_NAMES", []) if name)
    included = " ".join(about.get("DATA_INCLUDED", ["3D"]))
    if included != "3D":
        raise DamagedLog(
            path, f"it holds {included or 'no'} data, not the 3D trajectories of markers", cure=f"{_EXPORT}."
        )
    if not markers:
        raise DamagedLog(path, "no positions: no MARKER_NAMES in the header", cure=f"{_EXPORT}.")
    first = lines[at].rstrip("\r\n").split("\t")
    titled = first[0].strip() in ("Frame", "Time") or not _is_number(first[0])
    row = (lines[at + titled] if at + titled < len(lines) else "").rstrip("\r\n").split("\t")
    names = _columns(path, markers, [cell.strip() for cell in first] if titled else [], row)
    layout = Layout(names, "\t", at + titled, encoding=file_encoding(path) or "utf-8")
    stated = about.get("FREQUENCY", [""])[0]
    return _Header(about, markers, layout, float(stated) if _is_number(stated) else options.rate_hz)


def _columns(path: Path, markers: tuple[str, ...], titles: list[str], row: list[str]) -> tuple[str, ...]:
    """Return the column names: Frame and Time where they are, then #0, #1, ... three for each marker."""
    cells = tuple(f"#{index}" for index in range(3 * len(markers)))
    if titles:
        lead = tuple(title for title in titles[:2] if title in ("Frame", "Time"))
        return (*lead, *cells)
    width = len(row) - (len(row) > 1 and not row[-1].strip())  # data rows may end with a tab as well
    if width not in (len(cells), len(cells) + 2):
        cause = f"rows of {width} fields, where {len(markers)} markers need {len(cells)}, or two more with time data"
        raise DamagedLog(path, cause, cure=f"{_EXPORT} and column names.")
    return (*(("Frame", "Time") if width > len(cells) else ()), *cells)


def _is_number(text: str) -> bool:
    try:
        return 0.0 <= float(text) < 1e9
    except ValueError:
        return False


def _times(path: Path, rows: Rows, header: _Header) -> tuple[Numbers, list[str]]:
    """Return seconds since the measurement began: frame over rate, unless the Time column contradicts the rate."""
    frame = rows.frame
    logged = frame["Time"].to_numpy() if "Time" in frame.columns and not frame["Time"].has_nulls() else None
    if not header.rate_hz:
        if logged is None:
            cause = "neither a frequency in Hz nor a Time column"
            raise LogError(path, cause, cure="Give rate_hz in the source, or export again with time data.")
        return logged, []
    count = frame["Frame"].to_numpy() - 1.0 if "Frame" in frame.columns else frame[INDEX].to_numpy()
    exact = count / header.rate_hz
    if logged is None or not len(exact):
        return exact, []
    off = np.abs((logged / 2 - logged[0] / 2) - (exact / 2 - exact[0] / 2)).max() * 2.0
    if off <= max(2e-3, 0.5 / header.rate_hz):
        return exact, []
    return logged, [f"the frequency ({header.rate_hz:g} Hz) does not fit the Time column: the Time column is used"]


def _filled(header: _Header, tracks: dict[str, list[int]]) -> list[str]:
    """Say which markers in use were not simply measured: a filled gap is no measurement."""
    kinds = [kind for kind in header.about.get("TRAJECTORY_TYPES", []) if kind]
    used = {index for members in tracks.values() for index in members}
    made = [header.markers[i] for i in sorted(used) if i < len(kinds) and kinds[i] != _MEASURED]
    return [f"trajectories partly filled or edited, not measured: {', '.join(made[:20])}"] if made else []


ADAPTER: Adapter = _QualisysTsv()
