"""TRC, the text file of marker positions that OpenSim, Pose2Sim, OpenCap and Cortex write.

Tab-separated cells; markers or keypoints of one person, in the unit of `Units`. The person's position is the centre of
the visible pelvis markers (`RHip`, `L.ASIS`, ...). An empty cell, NaN and exactly 0, 0, 0 mean not seen. Time is frame
/ `DataRate`, with the zero of the Time column, or the Time column if the two contradict each other. OpenSim uses Y up,
which the file does not show, and files exported as recorded are often Z up. So heads above feet decide, if such markers
exist, unless the cell file gives `up = "z"`. Skeletons, if requested, hold the markers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import LogError
from cyclekit_adapters.text.delimited import TextRows, read_blocks
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import head_of
from cyclekit_adapters.tracking.joints import points_of, without_zeros
from cyclekit_adapters.tracking.length_unit import METRES
from cyclekit_adapters.tracking.markers import (
    choose_people,
    marker_facts,
    marker_warnings,
    marker_words,
    recording_of,
)
from cyclekit_adapters.tracking.person_counts import PersonCounts
from cyclekit_adapters.tracking.trc_header import FIRST, TrcHeader, read_header
from cyclekit_adapters.tracking.vertical_axis import vertical_axis

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import polars as pl
    from numpy.typing import NDArray

_AT_ZERO_M = 0.01
_ROWS = 10
"""Minimum number of rows: a pelvis at zero in all of them is not a position in the room."""


class _Trc:
    def recognises(self, path: Path) -> bool:
        return head_of(path).lstrip('"').startswith(FIRST)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        given = marker_words(options, "TRC").get("up")
        header = read_header(path, options.rate_hz)
        people = choose_people(path, header.names, options, "TRC")
        used = people.used(skeletons=options.skeletons)
        here, names = people.among(used), [header.names[index] for index in used]
        cells = [cell for index in used for cell in header.cells(index)]
        up, why = (given, "from the cell file") if given else _up(header)
        seen, metres = PersonCounts(), METRES[header.unit]

        def make(rows: TextRows) -> Recording:
            t_s = header.clock.seconds(rows.frame)
            points = without_zeros(points_of(rows.frame, cells)) * metres
            part = recording_of(here, names, points, t_s, rows, seen, options=options, up=cast('Literal["y", "z"]', up))
            _require_a_place(path, part.people)
            return part

        def finish(last: Recording) -> Recording:
            messages = [*header.clock.warnings(), *marker_warnings(people, seen, options.flange), *_cut(header, seen)]
            if seen.back:
                messages.append("time does not increase throughout: the rows were edited or joined")
            if not given and why.startswith(_UNCLEAR):
                messages.append(f"up is not in the file: {why}")
            facts = {"rate_hz": header.about.get("DataRate", "not stated"), "unit": f"{header.unit}, from the header"}
            return replace(
                last,
                warnings=tuple(messages),
                facts=facts | {"up": f"{up}, {why}", **marker_facts(people, header.names)},
            )

        blocks = read_blocks(path, header.layout, numbers=[*header.clock.names, *cells], required=header.clock.required)
        yield from in_parts(path, blocks, make, finish)


_UNCLEAR = "heads are not above feet"


def _up(header: TrcHeader) -> tuple[str, str]:
    """Return the vertical axis and the evidence: heads above feet, else the default of OpenSim."""
    found = vertical_axis(header.names, _points(header) * METRES[header.unit])
    if found == "neither":
        return "y", f"{_UNCLEAR} along y or z: y assumed, the default of OpenSim; check `up`"
    return (found, "since heads are above feet") if found else ("y", "the default of OpenSim; not in the file")


def _points(header: TrcHeader) -> NDArray[np.float64]:
    """Return the positions in the first rows, shape (N, M, 3), in the unit of the file; NaN for a garbled cell."""
    width = 2 + 3 * len(header.names)
    rows = [[_number(cell) for cell in row[2:width]] for row in header.rows if len(row) >= width]
    points = np.array(rows, dtype=np.float64).reshape(len(rows), len(header.names), 3)
    return without_zeros(points)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _require_a_place(path: Path, people: pl.DataFrame | None) -> None:
    """Refuse keypoints relative to the person's own hips: MediaPipe's world landmarks, written as TRC."""
    if people is None or people.height < _ROWS:
        return
    places = people.select("x_m", "y_m", "z_m").drop_nulls().to_numpy()
    if len(places) >= _ROWS and (np.abs(places) < _AT_ZERO_M).all():
        cause = "the pelvis is at zero in all rows: positions are relative to the person's hips, not to the room"
        cure = "Write positions in the room: triangulate several cameras, or use a depth camera's skeleton."
        raise LogError(path, cause, cure=cure)


def _cut(header: TrcHeader, seen: PersonCounts) -> list[str]:
    rows = max(seen.rows.values(), default=0)
    missing = header.frames_stated - rows
    return [f"line 3 states {header.frames_stated} frames, {missing} of them are missing"] if missing > 0 else []


ADAPTER: StreamingAdapter = _Trc()
