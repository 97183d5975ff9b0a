"""Tables of pedestrians: `frame id x y`, with or without a header (PeTrack, JuPedSim, PedPy, trajectory benchmarks).

The person's position is the tracked point of the file, usually head or feet, by `id`. A header of column names, or a
last comment line of them (`# id frame x/m y/m z/m`), gives order and unit. Without one, the four columns are frame, id,
x, y in m, unless `columns` and `unit` in the cell file give others. If unnamed columns give much smaller steps in the
other order, the log is refused until `columns` gives the order. The clock is frame / rate; the rate comes from a
comment `# framerate: 25` or from `rate_hz` in the cell file and is never guessed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import LogError
from cyclekit.schema import PEOPLE, conform
from cyclekit.text.numbers import fixed, given
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.text.delimited import TextLayout, TextRows, row_blocks
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import blocks_of, file_encoding, head_of
from cyclekit_adapters.tracking.landmark_tables import landmarks_in
from cyclekit_adapters.tracking.pedestrian_header import (
    CORRUPT,
    METRES,
    check_metres,
    header_of,
    looks_like_frames,
    read_header,
)
from cyclekit_adapters.tracking.person_counts import PersonCounts, only

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit_adapters.tracking.pedestrian_header import PedestrianHeader

_ORDERS = ("frame id x y", "id frame x y", "frame id x y z", "id frame x y z")
_SPREAD_M = 500.0


class _Pedestrians:
    def recognises(self, path: Path) -> bool:
        header = header_of(head_of(path))
        if header is None or landmarks_in(head_of(path)):  # `frame, id, x, y` may also be body points in an image
            return False
        return header.titled or looks_like_frames(head_of(path), header)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        chosen = words(options, "pedestrian", {"columns": _ORDERS, "unit": tuple(METRES)})
        header = read_header(path, chosen.get("columns"))
        rate_hz = header.rate_hz or options.rate_hz
        if not rate_hz or rate_hz <= 0.0:
            cause = "it counts frames and states no rate: times are unknown"
            raise LogError(path, cause, cure="Give rate_hz (frames per second) in the source of the cell file.")
        unit = chosen.get("unit") or header.unit or check_metres(path, header, rate_hz)
        seen, reach = PersonCounts(), _Reach()

        def make(rows: TextRows) -> Recording:
            people = _table(rows.frame, rate_hz, METRES[unit])
            twice = people.select("t_s", "person").is_duplicated()
            if not header.titled and twice.sum() > CORRUPT * people.height:
                cause = "an id occurs twice in a frame: the unnamed columns have another order, or a row was duplicated"
                raise LogError(path, cause, cure='Give the order in [sources.map]: columns = "id frame x y".')
            seen.add(people)
            reach.add(people)
            return Recording(
                people=conform(only(people, options.body), PEOPLE),
                clock="relative",
                up="z",
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            seen.require(path, options.body)
            stated = (
                "from the cell file" if "unit" in chosen else "from the header" if header.unit else "not in the file"
            )
            facts = {
                "point": "defined by the tracker: usually the head or the feet",
                "columns": " ".join(header.names),
                "unit": f"{unit}, {stated}",
                "rate_hz": f"{given(rate_hz)}, {'from the header' if header.rate_hz else 'from the cell file'}",
            }
            return replace(last, warnings=tuple(_warnings(header, reach.most_m, rate_hz, options)), facts=facts)

        layout = TextLayout(header.names, "\\s+" if header.delimiter == " " else header.delimiter, 0, quotes=True)
        numbers = ["frame", *(axis for axis in "xyz" if axis in header.names)]
        lines = _lines(path, header)
        required = ["frame", "id"]
        blocks = row_blocks(
            lines, layout, numbers=numbers, texts=["id"], required=required, first_line=header.lines + 1
        )
        yield from in_parts(path, blocks, make, finish)


@dataclass
class _Reach:
    """Maximum absolute coordinate of the positions so far."""

    most_m: float = 0.0

    def add(self, people: pl.DataFrame) -> None:
        self.most_m = max(self.most_m, *(float(str(people[name].abs().max() or 0.0)) for name in ("x_m", "y_m")))


def _lines(path: Path, header: PedestrianHeader) -> Iterator[bytes]:
    """Yield the lines below the header, with comments as blank lines and runs of blanks as one delimiter."""
    delimiter = "\\s+" if header.delimiter == " " else header.delimiter
    for block in blocks_of(path, file_encoding(path) or "utf-8", skip_lines=header.lines, delimiter=delimiter):
        yield re.sub(rb"(?m)^[ \t\x1f]*#[^\r\n]*", b"", block) if b"#" in block else block


def _table(frame: pl.DataFrame, rate_hz: float, metres: float) -> pl.DataFrame:
    number = pl.col("id").cast(pl.Float64, strict=False)
    counted = number.is_not_null() & (number == number.round()) & (number.abs() < 1e15)
    person = pl.when(counted).then(number.cast(pl.Int64, strict=False).cast(pl.String)).otherwise(pl.col("id"))
    places = {f"{axis}_m": pl.col(axis) * metres for axis in "xyz" if axis in frame.columns}
    t_s = pl.Series("t_s", frame["frame"].to_numpy() / rate_hz)
    return frame.select(t_s, person.alias("person"), "source_row", **places)


def _warnings(header: PedestrianHeader, reach_m: float, rate_hz: float, options: ReadOptions) -> list[str]:
    found = []
    if header.rate_hz and options.rate_hz and abs(header.rate_hz - options.rate_hz) > 1e-9 * rate_hz:
        found.append(
            f"the header's rate ({given(header.rate_hz)} Hz) is used, not the cell file's ({given(options.rate_hz)} Hz)"
        )
    if not header.titled and "columns" not in options.map:
        found.append("the columns have no names: frame, id, x, y assumed")
    if header.unit is None and "unit" not in options.map:
        found.append("no unit is stated: metres assumed for x and y; check `unit`")
    if reach_m > _SPREAD_M:
        found.append(
            f"positions reach {fixed(reach_m, 0)} m: they may be in centimetres, millimetres or pixels; check `unit`"
        )
    return found


ADAPTER: StreamingAdapter = _Pedestrians()
