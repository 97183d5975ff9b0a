"""Vicon CSV: markers (section Trajectories), else segments (Objects, Segments), of an ASCII export.

A file holds one or more sections separated by a blank line. Each has a title, its rate in Hz, names above the first of
their columns, `Frame, Sub Frame, X, Y, Z, ...` or `..., RX, RY, RZ, TX, TY, TZ, ...`, and a row of units. A file with
only devices or model outputs is refused. A person's position is the centre of the visible pelvis markers, by subject
(`Subject:Marker`), or the origin of the pelvis segment. An object of one segment repeats its name (`hip:hip`): if one
of the objects is a pelvis, all are segments of one person; otherwise each is a separate body. The clock is the trial's,
(frame - 1) / rate; the file holds no time of day and no vertical axis. Z is up unless the cell file gives `up = "y"`.
Skeletons, if requested, hold the subject's markers or segments.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, cast

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.text.numbers import given
from cyclekit_adapters.text.delimited import TextRows, delimiter_of, fields_of, row_blocks
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import head_lines, head_of
from cyclekit_adapters.tracking.frame_clock import FRAME, MAX_HZ, FrameClock, positive
from cyclekit_adapters.tracking.joints import points_of
from cyclekit_adapters.tracking.markers import (
    People,
    choose_people,
    is_pelvis,
    marker_facts,
    marker_warnings,
    marker_words,
    recording_of,
)
from cyclekit_adapters.tracking.person_counts import PersonCounts
from cyclekit_adapters.tracking.vicon_sections import METRES, TITLES, TRAJECTORIES, WITH_PLACES, open_section

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from cyclekit_adapters.tracking.vicon_sections import Sections


class _ViconCsv:
    def recognises(self, path: Path) -> bool:
        if not head_of(path).lstrip('"').startswith(TITLES):
            return False
        lines = head_lines(path, 4)
        if len(lines) < 4:
            return False
        delimiter = delimiter_of(lines[2] + lines[3], ",;\t")
        title, rate, names, axes = (fields_of(line, delimiter)[0].strip() for line in lines)
        return (
            title in TITLES
            and positive(rate, below=MAX_HZ) is not None
            and (axes == FRAME or (title, names) == _EVENTS)
        )

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        words = marker_words(options, "Vicon", {"section": WITH_PLACES})
        up = words.get("up")
        log, section, lines = open_section(path, words.get("section"))
        known = tuple(section.places if log.title == TRAJECTORIES else map(_segment, section.places))
        people = _people(path, log.title, known, options)
        used = people.used(skeletons=options.skeletons)
        here, names = people.among(used), [known[index] for index in used]
        places = list(section.places.values())
        cells = [cell for index in used for cell in places[index]]
        clock, seen = FrameClock((FRAME,), section.rate_hz, 1), PersonCounts()

        def make(rows: TextRows) -> Recording:
            t_s = clock.seconds(rows.frame)
            points = points_of(rows.frame, cells) * section.metres
            which = cast('Literal["y", "z"]', up or "z")
            return recording_of(here, names, points, t_s, rows, seen, options=options, up=which)

        def finish(last: Recording) -> Recording:
            messages = marker_warnings(people, seen, options.flange)
            if seen.back:
                messages.append("frames do not increase throughout: the rows were edited or joined")
            messages += _not_read(log)
            facts = {
                "rate_hz": given(section.rate_hz),
                "unit": next(name for name, metres in METRES.items() if metres == section.metres),
                "up": f"{up}, from the cell file" if up else "z, the default of Vicon; not in the file",
                "section": log.title,
                "sections": ", ".join(log.titles),
                **marker_facts(people, known),
            }
            return replace(last, warnings=tuple(messages), facts=facts)

        blocks = row_blocks(lines, section.layout, numbers=[FRAME, *cells], required=[FRAME], first_line=log.first)
        yield from in_parts(path, blocks, make, finish)


def _segment(name: str) -> str:
    """Return the name of a segment, without the object if both have the same name (`hip:hip`)."""
    subject, _, segment = name.rpartition(":")
    return segment if subject == segment else name


def _people(path: Path, section: str, names: Sequence[str], options: ReadOptions) -> People:
    """Find the people by subject and pelvis; without a pelvis, each object is one."""
    people = choose_people(path, names, options, "Vicon")
    if section == TRAJECTORIES or "markers" in options.map:
        return people
    if any(is_pelvis(name) or ":" in name for name in names):
        return replace(people, point="origin of the pelvis") if "pelvis" in people.point else people
    tracks = {
        name: [index] for index, name in enumerate(names) if options.body in (None, name) or name == options.flange
    }
    return People(tracks, "origin of the object")


def _not_read(log: Sections) -> list[str]:
    """Return warnings with the other sections that hold positions."""
    messages = []
    if log.titles.count(log.title) > 1:
        messages.append(f"a second section {log.title} is not read: split the file before it to read it too")
    others = [title for title in WITH_PLACES if title in log.titles and title != log.title]
    if others:
        messages.append(
            f'section {log.title} is read, {", ".join(others)} is not: section = "{others[0]}" in [sources.map]'
        )
    return messages


_EVENTS = ("Events", "Subject")  # this section has names where others have axes

ADAPTER: StreamingAdapter = _ViconCsv()
