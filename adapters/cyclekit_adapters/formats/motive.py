"""OptiTrack Motive: CSV export of a take, versions 1.21 to 1.25.

A person is, in order of preference, the hip of a skeleton, a rigid body, or the centre of the visible markers of a
marker set (of the pelvis markers, if present). Each is a separate track, and the cell file can select one. Line 1 gives
the length unit. Y is up unless the exporter was configured otherwise, which the file does not show: then the cell file
needs `up = "z"`. Rotation precedes position. The clock is the take's: frame number / export rate. An empty cell is a
body that no camera saw, and stays unknown. The orientation of the capture volume in the cell is not in the file.
Skeletons, if requested, hold the bones under Motive's names.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, cast

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.text.delimited import TextLayout, TextRows, delimiter_of, fields_of, read_blocks
from cyclekit_adapters.text.header_line import has_decimal_comma
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import file_encoding, head_of
from cyclekit_adapters.tracking.frame_clock import FRAME, TIME, FrameClock
from cyclekit_adapters.tracking.joints import all_joints, joint_rows, points_of
from cyclekit_adapters.tracking.markers import is_pelvis
from cyclekit_adapters.tracking.person_counts import PersonCounts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_MARKS = ",;\t"  # Motive writes commas; a spreadsheet may change them
_LOOKED_AT = 20  # rows
_HEADER_BYTES = 4 << 20  # header rows of a take with many markers reach megabytes
_METRES = {"meters": 1.0, "millimeters": 1e-3, "centimeters": 1e-2}
_BODY, _BONE, _MARKER, _EXPECTED = "Rigid Body", "Bone", "Marker", "Rigid Body Marker"
_SOLVED = {_EXPECTED, "Bone Marker"}  # expected marker positions: never empty, even if no camera saw the marker
_HIPS = {"hip", "hips", "pelvis"}
_KEYS = {
    *("Format Version", "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate", "Capture Start Time"),
    *("Capture Start Frame", "Total Frames in Take", "Total Exported Frames", "Rotation Type", "Length Units"),
    *("Coordinate Space",),
}
_EXPORT = "Export the take again from Motive as CSV"

_Points = list[tuple[str, str, str]]


@dataclass(frozen=True)
class _Header:
    """Lines above the data.

    Attributes:
        about: Line 1, by key.
        layout: Layout of the rows.
        points: (type, name) -> x, y, z columns.
        clock: Frame clock.
    """

    about: dict[str, str]
    layout: TextLayout
    points: dict[tuple[str, str], tuple[str, str, str]]
    clock: FrameClock


class _MotiveCsv:
    def recognises(self, path: Path) -> bool:
        line = head_of(path).partition("\n")[0]
        return line.startswith(tuple(f"Format Version{mark}" for mark in _MARKS)) and "Take Name" in line

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        up = cast('Literal["y", "z"]', words(options, "Motive", {"up": ("y", "z")}).get("up", "y"))
        header = _header(path)
        metres = _metres(path, header)
        people = _people_of(path, header, options.body)
        if options.flange is not None and any(name == options.flange for _, name in header.points):
            people = people | _people_of(path, header, options.flange)
        bones = _bones(header, options.body) if options.skeletons else {}
        clock, seen = header.clock, PersonCounts()

        def make(rows: TextRows) -> Recording:
            t_s = clock.seconds(rows.frame)
            frame = rows.frame.with_columns(t_s)
            table = pl.concat([_track(frame, name, points, metres) for name, points in people.items()])
            table = conform(table.sort("source_row", "person", maintain_order=True), PEOPLE)
            seen.add(table)
            seen.clock(t_s)
            return Recording(
                people=table,
                skeletons=_skeletons(frame, bones, metres) if bones else None,
                clock="relative",
                up=up,
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {key: value for key, value in header.about.items() if value}
            facts |= {"tracked": ", ".join(people), "names_in_file": ", ".join(name for _, name in header.points)}
            messages = (*clock.warnings(), *_warnings(header, people, seen, options))
            return replace(last, warnings=messages, facts=facts)

        points = [*people.values(), *(list(joints.values()) for joints in bones.values())]
        cells = dict.fromkeys(name for track in points for point in track for name in point)
        numbers = [*clock.names, *cells]
        blocks = read_blocks(path, header.layout, numbers=numbers, required=list(dict.fromkeys([FRAME, *clock.names])))
        yield from in_parts(path, blocks, make, finish)


def _header(path: Path) -> _Header:
    lines = head_of(path, _HEADER_BYTES).split("\n")
    mark = delimiter_of(lines[0], _MARKS)
    about = _about(fields_of(lines[0], mark), mark)
    at = next((i for i, line in enumerate(lines[:60]) if line.startswith((f"Frame{mark}", f'"Frame"{mark}'))), None)
    if at is None or "Length Units" not in about:
        cause = "no header" if at is None and "Length Units" not in about else "the header is incomplete"
        cure = f"{_EXPORT}, with header information switched on."
        raise DamagedLog(path, f"{cause}: bodies and length units are unknown", cure=cure)
    axes = [cell.strip() for cell in fields_of(lines[at], mark)]
    above = [[cell.strip() for cell in fields_of(line, mark)] for line in lines[1:at] if line.strip(f" {mark}\r")]
    width = max(i for i, cell in enumerate(axes) if cell) + 1
    time = TIME if len(axes) > 1 and axes[1].startswith(TIME) else "#1"
    names = (FRAME, time, *(f"#{index}" for index in range(2, _width(above, width))))
    rows = lines[at + 1 :]
    comma = has_decimal_comma(rows[:_LOOKED_AT], mark)
    layout = TextLayout(names, mark, at + 1, decimal_comma=comma, encoding=file_encoding(path) or "utf-8")
    clock = _clock(path, about, names)
    clock.decide(rows, mark, decimal_comma=comma)
    return _Header(about, layout, _points(path, above, axes, names), clock)


def _about(cells: list[str], mark: str) -> dict[str, str]:
    """Return line 1 as pairs; a take name or note may hold unquoted delimiters and then continues in the next cells."""
    about: dict[str, str] = {}
    key, at = "", 0
    while at < len(cells):
        cell = cells[at].strip()
        if cell in _KEYS or not key.startswith("Take"):
            key = cell
            about[key] = cells[at + 1].strip() if at + 1 < len(cells) else ""
            at += 2
        else:
            about[key] += f"{mark} {cell}" if cell else ""
            at += 1
    return about


def _clock(path: Path, about: dict[str, str], names: tuple[str, ...]) -> FrameClock:
    try:
        rate_hz = float(about.get("Export Frame Rate", "").replace(",", "."))
    except ValueError:
        rate_hz = 0.0
    clock = FrameClock(tuple(name for name in names if name in (FRAME, TIME)), rate_hz if rate_hz > 0.0 else None, 0)
    if not clock.known:
        raise DamagedLog(path, "neither an export frame rate nor a Time column", cure=f"{_EXPORT}, with its header.")
    return clock


def _width(above: list[list[str]], width: int) -> int:
    """Return the number of columns with an axis or, as quality columns have, only a component."""
    component = above[-1] if above else []
    named = [index for index, cell in enumerate(component) if cell]
    return max([width, *(index + 1 for index in named)])


def _points(
    path: Path, above: list[list[str]], axes: list[str], names: tuple[str, ...]
) -> dict[tuple[str, str], tuple[str, str, str]]:
    """Find the column triples of positions, upwards from the axis row, because header rows differ between versions."""
    labels = {row[1]: row for row in above if len(row) > 1 and row[1] in ("Type", "Name")}
    plain = [row for row in above[:-1] if len(row) > 1 and not row[1]]
    types = labels.get("Type") or (plain[0] if plain else [])
    titles = labels.get("Name") or (plain[1] if len(plain) > 1 else [])
    found: dict[tuple[str, str], dict[str, str]] = {}
    columns = zip(types, titles, above[-1] if above else [], axes, names, strict=False)
    for kind, title, component, axis, name in columns:
        if component == "Position" and axis in ("X", "Y", "Z"):
            found.setdefault((kind, title), {}).setdefault(axis, name)
    points = {key: (xyz["X"], xyz["Y"], xyz["Z"]) for key, xyz in found.items() if len(xyz) == 3}
    if not points:
        cure = f"{_EXPORT}, with rigid bodies, bones or markers switched on."
        raise DamagedLog(path, "no positions: no column triple X, Y, Z under 'Position'", cure=cure)
    return points


def _metres(path: Path, header: _Header) -> float:
    if header.about.get("Coordinate Space", "Global") != "Global":
        cause = f"coordinate space is {header.about['Coordinate Space']!r}: positions are relative to a parent"
        raise DamagedLog(path, cause, cure=f"{_EXPORT}, with coordinate space Global.")
    unit = header.about["Length Units"]
    if unit.lower() not in _METRES:
        known = [name.capitalize() for name in _METRES]
        cure = f"Known: {', '.join(known)}. {_EXPORT} in one of them."
        raise DamagedLog(path, f"unknown length unit {unit!r}", nearest=nearest(unit, known), cure=cure)
    return _METRES[unit.lower()]


def _people_of(path: Path, header: _Header, body: str | None) -> dict[str, _Points]:
    """Return the tracks of this take and the points of each."""
    tracks = _tracks(header.points)
    if body is None:
        return next(group for group in tracks if group)
    for group in tracks:
        if body in group:
            return {body: group[body]}
    for kind in (_BODY, _BONE, _MARKER, _EXPECTED):
        if (kind, body) in header.points:
            return {body: [header.points[kind, body]]}
    known = sorted({*(name for group in tracks for name in group), *(name for _, name in header.points)})
    raise LogError(path, f"no body {body!r}", nearest=nearest(body, known), cure=f"In the file: {', '.join(known)}.")


def _tracks(points: dict[tuple[str, str], tuple[str, str, str]]) -> list[dict[str, _Points]]:
    """Return groups of tracks, best first: skeletons by their hip, rigid bodies, marker sets, others."""
    bodies = {name: [xyz] for (kind, name), xyz in points.items() if kind == _BODY}
    skeletons: dict[str, _Points] = {}
    sets: dict[str, dict[str, tuple[str, str, str]]] = {}
    for (kind, name), xyz in points.items():
        owner, _, part = name.partition(":")
        if kind == _BONE and (part.lower() in _HIPS or owner not in skeletons):
            skeletons[owner] = [xyz]  # the first bone is the root; one called hip replaces it
        if kind == _MARKER and part and not owner.startswith("Unlabeled"):
            sets.setdefault(owner, {})[name] = xyz
    worn = {owner: [xyz for name, xyz in markers.items() if is_pelvis(name)] for owner, markers in sets.items()}
    rest = {name: [xyz] for (_, name), xyz in points.items()}
    return [skeletons, bodies, {owner: worn[owner] or list(sets[owner].values()) for owner in sets}, rest]


def _bones(header: _Header, body: str | None) -> dict[str, dict[str, tuple[str, str, str]]]:
    """Return the bones of each skeleton, or of `body` only: person -> joint -> columns."""
    found: dict[str, dict[str, tuple[str, str, str]]] = {}
    for (kind, name), xyz in header.points.items():
        owner, _, part = name.partition(":")
        if kind == _BONE and body in (None, owner):
            name = "hip" if part in ("", owner) else part.lower()  # the root bone is named after the skeleton
            found.setdefault(owner, {})[name] = xyz
    return found


def _skeletons(frame: pl.DataFrame, bones: dict[str, dict[str, tuple[str, str, str]]], metres: float) -> pl.DataFrame:
    tables = []
    for person, joints in bones.items():
        points = points_of(frame, [name for point in joints.values() for name in point]) * metres
        tables.append(joint_rows(frame["t_s"], person, list(joints), points, frame["source_row"]))
    return all_joints(tables)


def _track(frame: pl.DataFrame, name: str, points: _Points, metres: float) -> pl.DataFrame:
    """Return one person's rows: the mean of the visible points, null if none is visible."""
    whole = [pl.all_horizontal(pl.col(point).is_not_null()) for point in points]
    axes = {
        f"{axis}_m": pl.mean_horizontal(
            [pl.when(seen).then(pl.col(point[i])) for seen, point in zip(whole, points, strict=True)]
        )
        * metres
        for i, axis in enumerate("xyz")
    }
    return frame.select("t_s", pl.lit(name).alias("person"), "source_row", **axes)


def _warnings(header: _Header, tracked: dict[str, _Points], seen: PersonCounts, options: ReadOptions) -> list[str]:
    messages, body = [], options.body
    people = {name: points for name, points in tracked.items() if name != options.flange}
    kinds = {kind for kind, _ in header.points}
    if body is None and len(people) > 1:
        messages.append(f"{len(people)} bodies tracked ({', '.join(people)}): name the operator with `body`")
    if body is None and not kinds & {_BODY, _BONE} and any(name.startswith("Unlabeled") for name in people):
        messages.append("only unlabelled markers: one marker may be split over several tracks")
    things = [name for kind, name in header.points if kind == _BODY and name != options.flange]
    if body is None and things and _BONE in kinds:
        messages.append(
            f"the skeleton is the person: rigid bodies ({', '.join(things)}) are left out; name one with `body`"
        )
    solved = {name for kind, name in header.points if kind in _SOLVED} - {n for k, n in header.points if k == _MARKER}
    if solved.intersection(people):
        messages.append("some positions are computed, because no camera saw the marker there: export measured markers")
    if any(len(points) > 1 for points in people.values()):
        messages.append("the person's position is the middle of the visible markers; it jumps when one is hidden")
    messages += seen.unseen_messages(options.flange)
    if seen.back:
        messages.append("time does not increase throughout: the rows were edited or joined")
    return messages


ADAPTER: StreamingAdapter = _MotiveCsv()
