"""Qualisys Track Manager TSV: 3D trajectories of markers, or 6DOF rigid bodies.

Header lines are a key, a tab and values; a row of column names may follow (mandatory for rigid bodies). A person's
position is the centre of the visible pelvis markers, or the origin of a rigid body. Lengths are in mm; Z is up unless
the cell file gives `up = "y"`. An empty cell, `NULL` and exactly 0, 0, 0 mean not seen. The clock is the measurement's,
(frame - 1) / frequency: `TIME_STAMP` counts from the start of the PC, and Qualisys advises against using it. With an
external timebase (`FREQUENCY EXT`) the Time column is the clock. Events set in QTM become events at the time of their
frame. Skeletons, if requested, hold the subject's labelled markers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.schema import EVENTS, conform, empty
from cyclekit.text.numbers import fixed
from cyclekit_adapters.text.delimited import TextRows, read_blocks
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import head_of
from cyclekit_adapters.tracking.joints import points_of, without_zeros
from cyclekit_adapters.tracking.markers import (
    People,
    choose_people,
    marker_facts,
    marker_warnings,
    marker_words,
    recording_of,
)
from cyclekit_adapters.tracking.person_counts import PersonCounts
from cyclekit_adapters.tracking.qualisys_header import BODIES, KEYS, QualisysHeader, read_header

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_MM = 1e-3
_MEASURED = "Measured"


class _QualisysTsv:
    def recognises(self, path: Path) -> bool:
        head = head_of(path)
        if head.partition("\t")[0] not in KEYS:
            return False
        keys = [line.partition("\t")[0] for line in head.split("\n", 12)[:12] if "\t" in line]
        return len(KEYS.intersection(keys)) >= 3

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        up = marker_words(options, "Qualisys").get("up")
        header = read_header(path, options.rate_hz)
        people = _people(path, header, options)
        used = people.used(skeletons=options.skeletons)
        here, names = people.among(used), [header.names[index] for index in used]
        cells = [cell for index in used for cell in header.cells[index]]
        seen, events = PersonCounts(), [_events(header)] if header.events else []

        def make(rows: TextRows) -> Recording:
            t_s = header.clock.seconds(rows.frame)
            points = without_zeros(points_of(rows.frame, cells)) * _MM
            which = cast('Literal["y", "z"]', up or "z")
            part = recording_of(here, names, points, t_s, rows, seen, options=options, up=which)
            return replace(part, events=events.pop() if events else empty(EVENTS)) if header.events else part

        def finish(last: Recording) -> Recording:
            messages = [
                *header.clock.warnings(),
                *marker_warnings(people, seen, options.flange),
                *_filled(header, people),
            ]
            if seen.back:
                messages.append("time does not increase throughout: the rows were edited or joined")
            facts = {
                **header.facts(),
                "unit": "mm, defined by the format",
                "up": f"{up}, from the cell file" if up else "z, the default of QTM; not in the file",
                **marker_facts(people, header.names),
            }
            return replace(last, warnings=tuple(messages), facts=facts)

        numbers = [*header.clock.names, *cells]
        blocks = read_blocks(path, header.layout, numbers=numbers, required=header.clock.required)
        yield from in_parts(path, blocks, make, finish)


def _people(path: Path, header: QualisysHeader, options: ReadOptions) -> People:
    if header.kind != BODIES or "markers" in options.map:
        return choose_people(path, header.names, options, "Qualisys")
    tracks = {name: [index] for index, name in enumerate(header.names)}
    if options.body is not None:
        if options.body not in tracks:
            return choose_people(path, header.names, options, "Qualisys")  # raises with the list of names
        tracks = {name: at for name, at in tracks.items() if name in (options.body, options.flange)}
    return People(tracks, "origin of the rigid body")


def _events(header: QualisysHeader) -> pl.DataFrame:
    """Return table EVENTS: one row per event, with the frame as its value."""
    rows = [
        (time if (at := header.clock.at(frame)) is None else at, name, f"frame {fixed(frame, 0)}", line)
        for line, name, frame, time in header.events
    ]
    kept = [row for row in rows if np.isfinite(row[0])]
    schema = {name: column.dtype for name, column in EVENTS.items()}
    return conform(pl.DataFrame(kept, schema=schema, orient="row").sort("t_s", maintain_order=True), EVENTS)


def _filled(header: QualisysHeader, people: People) -> list[str]:
    """Return a warning with the used markers that were gap-filled or edited instead of measured."""
    kinds = [kind for kind in header.about.get("TRAJECTORY_TYPES", []) if kind]
    used = people.used(skeletons=False)
    made = [header.names[i] for i in used if i < len(kinds) and kinds[i] != _MEASURED]
    return [f"trajectories partly filled or edited, not measured: {', '.join(made[:20])}"] if made else []


ADAPTER: StreamingAdapter = _QualisysTsv()
