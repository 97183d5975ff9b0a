"""Vicon Nexus CSV: the section Trajectories of an ASCII export.

A file is one or more sections with a blank line between them; each has a title, its rate in Hz, names over the first of
their three columns, `Frame, Sub Frame, X, Y, Z, ...`, and a row of units. Only marker trajectories are positions of
people: a file of devices or model outputs alone is refused. A person is the middle of the pelvis markers seen, by
subject (`Subject:Marker`). The clock is the trial's, (frame - 1) / rate: no time is in the file. Which axis is up is
not in it either; Nexus is Z up unless the cell file says `up = "y"`. Where skeletons are asked for, their joints are
the subject's markers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, cast

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, whole
from cyclekit_adapters.delimited import Rows, delimiter_of, fields_of, row_blocks
from cyclekit_adapters.frame_clock import FRAME, FrameClock
from cyclekit_adapters.in_parts import in_parts
from cyclekit_adapters.joints import points_of
from cyclekit_adapters.markers import (
    choose_people,
    marker_facts,
    marker_warnings,
    marker_words,
    recording_of,
)
from cyclekit_adapters.sightings import Sightings
from cyclekit_adapters.text_blocks import head_lines, head_of
from cyclekit_adapters.vicon_sections import METRES, TITLES, Trajectories, rate_of, read_section

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class _ViconCsv:
    def recognises(self, path: Path) -> bool:
        if not head_of(path).lstrip('"').startswith(TITLES):
            return False
        lines = head_lines(path, 4)
        if len(lines) < 4:
            return False
        delimiter = delimiter_of(lines[2] + lines[3], ",;\t")
        title, rate, names, axes = (fields_of(line, delimiter)[0].strip() for line in lines)
        return title in TITLES and rate_of(rate) is not None and (axes == FRAME or (title, names) == _EVENTS)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return whole(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        up = marker_words(options, "Vicon")
        log = Trajectories(path)
        section, lines = read_section(log.lines(), log)
        known = tuple(section.markers)
        people = choose_people(path, known, options, "Vicon")
        used = people.used(skeletons=options.skeletons)
        here, names = people.among(used), [known[index] for index in used]
        cells = [cell for name in names for cell in section.markers[name]]
        clock, seen = FrameClock((FRAME,), section.rate_hz, 1), Sightings()

        def make(rows: Rows) -> Recording:
            t_s = clock.seconds(rows.frame)
            points = points_of(rows.frame, cells) * section.metres
            which = cast('Literal["y", "z"]', up or "z")
            return recording_of(here, names, points, t_s, rows, seen, options=options, up=which)

        def finish(last: Recording) -> Recording:
            said = marker_warnings(people, seen)
            if seen.back:
                said.append("frames do not increase throughout: the rows were edited or joined")
            if log.titles.count("Trajectories") > 1:
                said.append("a second section Trajectories is not read: cut the file before it to read it, too")
            facts = {
                "rate_hz": f"{section.rate_hz:g}",
                "unit": next(name for name, metres in METRES.items() if metres == section.metres),
                "up": f"{up}, by the cell file" if up else "z, as Nexus has it; not in the file",
                "sections": ", ".join(log.titles),
                **marker_facts(people, known),
            }
            return replace(last, warnings=tuple(said), facts=facts)

        blocks = row_blocks(lines, section.layout, numbers=[FRAME, *cells], required=[FRAME], first_line=log.first)
        yield from in_parts(path, blocks, make, finish)


_EVENTS = ("Events", "Subject")  # that section has names where the others have their axes

ADAPTER: StreamingAdapter = _ViconCsv()
