"""Kinect v2 skeletons as headerless CSV: 100 ns ticks, then 25 joints of x, y, z and tracking state.

The person's position is joint 0, the base of the spine. Positions are in m in the camera's frame: x to the sensor's
left, y up (tilted with the sensor), z away from it, which is right-handed. State 0 is "not tracked" and means unknown,
1 is inferred by the sensor and used, 2 is tracked. The clock is the sensor's. The file has no ids: until two rows share
a time there is one person; from then on bodies are linked by motion. Skeletons, if requested, hold the SDK's JointType
joints, in its order.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import DamagedLog
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.text.delimited import TextLayout, TextRows, delimiter_of, fields_of, read_blocks
from cyclekit_adapters.text.header_line import has_decimal_comma
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import file_encoding, head_of
from cyclekit_adapters.tracking.joints import joint_rows, points_of
from cyclekit_adapters.tracking.linking import Linker
from cyclekit_adapters.tracking.person_counts import PersonCounts, only

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_SDK = (
    *("SpineBase", "SpineMid", "Neck", "Head", "ShoulderLeft", "ElbowLeft", "WristLeft", "HandLeft", "ShoulderRight"),
    *("ElbowRight", "WristRight", "HandRight", "HipLeft", "KneeLeft", "AnkleLeft", "FootLeft", "HipRight", "KneeRight"),
    *("AnkleRight", "FootRight", "SpineShoulder", "HandTipLeft", "ThumbLeft", "HandTipRight", "ThumbRight"),
)
_JOINTS = [name.lower() for name in _SDK]
_FIELDS = 1 + 4 * len(_JOINTS)
_TICK_S = 1e-7
MOST_BODIES = 6
"""Number of bodies that the sensor tracks at once (`BodyFrameSource.BodyCount` of its SDK)."""
_NAMES = ("ticks", *(f"{part}{joint}" for joint in range(len(_JOINTS)) for part in ("x", "y", "z", "state")))


class _Kinect2Csv:
    def recognises(self, path: Path) -> bool:
        lines = [line for line in head_of(path).split("\n", 20)[:20] if line.strip()]
        return bool(lines) and _is_row(lines[0])

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        words(options, "Kinect v2", {})
        layout = _layout(path)
        bodies, seen = _Bodies(), PersonCounts()
        last = pl.DataFrame()

        def tables(named: pl.DataFrame) -> dict[str, pl.DataFrame]:
            nonlocal last
            last = named
            seen.add(named)
            seen.clock(named["t_s"], repeats=bodies.several)
            named = only(named, options.body)
            people = conform(named.select("t_s", "person", "x_m", "y_m", "z_m", "source_row"), PEOPLE)
            return {"people": people} | ({"skeletons": _skeletons(named)} if options.skeletons else {})

        def make(rows: TextRows) -> Recording:
            named = bodies.named(path, _placed(rows.frame, len(_JOINTS) if options.skeletons else 1))
            return Recording(
                **tables(named),  # type: ignore[arg-type]  # the names are those of the fields
                clock="uptime",
                up="y",
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(part: Recording) -> Recording:
            rest = tables(bodies.rest(last))
            seen.require(path, options.body)
            facts = {
                "point": "joint 0, base of the spine",
                "unit": "m, defined by the SDK",
                "axes": "camera: x to the sensor's left, y up, z away from the sensor; right-handed",
            }
            together = {name: pl.concat([table, rest[name]]) for name, table in part.tables().items()}
            return replace(part, **together, warnings=tuple(_warnings(bodies, seen)), facts=facts)  # type: ignore[arg-type]

        numbers = [name for name in _NAMES if options.skeletons or name in _NAMES[:5]]
        yield from in_parts(path, read_blocks(path, layout, numbers=numbers, required=["ticks"]), make, finish)


def _layout(path: Path) -> TextLayout:
    head = head_of(path)
    first = next((line for line in head.splitlines() if line.strip()), "")
    if not any(_is_row(line) for line in head.splitlines()[:20]):
        cause = "none of its first rows holds ticks and 25 joints with x, y, z and state"
        raise DamagedLog(path, cause, cure="Check how the file was written or copied.")
    delimiter = delimiter_of(first, ";\t,")
    comma = has_decimal_comma([first], delimiter)
    return TextLayout(_NAMES, delimiter, 0, decimal_comma=comma, encoding=file_encoding(path) or "utf-8")


def _is_row(line: str) -> bool:
    """Return whether a line holds ticks and 25 joints whose fourth number is a tracking state."""
    delimiter = delimiter_of(line, ";\t,")
    if line.count(delimiter) not in (_FIELDS - 1, _FIELDS):
        return False
    cells = [cell.strip() for cell in fields_of(line, delimiter)]
    if len(cells) == _FIELDS + 1 and not cells[-1]:
        cells.pop()
    if len(cells) != _FIELDS or not cells[0].isascii() or not cells[0].isdigit():
        return False
    if not {_state(cell) for cell in cells[4::4]} <= {0.0, 1.0, 2.0}:
        return False
    return all(_state(cell) is not None for cell in cells)


def _state(cell: str) -> float | None:
    try:
        return float(cell.replace(",", ".", 1))
    except ValueError:
        return None


def _placed(frame: pl.DataFrame, joints: int) -> pl.DataFrame:
    """Return the rows with `t_s` and the base of the spine; null if it was not tracked."""
    known = []
    for joint in range(joints):
        cells = [f"{axis}{joint}" for axis in "xyz"]
        seen = pl.col(f"state{joint}").is_in([1.0, 2.0]) & pl.all_horizontal(pl.col(cells).is_not_null())
        known += [pl.when(seen).then(pl.col(name)).alias(name) for name in cells]
    frame = frame.with_columns((pl.col("ticks") * _TICK_S).alias("t_s"), *known)
    return frame.with_columns(pl.col(f"{axis}0").alias(f"{axis}_m") for axis in "xyz")


def _skeletons(frame: pl.DataFrame) -> pl.DataFrame:
    points = points_of(frame, [f"{axis}{joint}" for joint in range(len(_JOINTS)) for axis in "xyz"])
    return joint_rows(frame["t_s"], frame["person"], _JOINTS, points, frame["source_row"])


@dataclass
class _Bodies:
    """Assigns rows to persons, block after block.

    Attributes:
        several: Two rows have had the same time.
        rows: Number of rows so far.
        inferred: Number of rows with an inferred base of the spine.
        unseen: Number of rows with an untracked base of the spine.
    """

    several: bool = False
    rows: int = 0
    inferred: int = 0
    unseen: int = 0
    _linker: Linker = field(default_factory=Linker)
    _held: pl.DataFrame | None = None

    def named(self, path: Path, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the rows of complete frames with `person`; the last frame waits, as the next block may continue it.

        Raises:
            DamagedLog: More rows have one time than the sensor tracks bodies.
        """
        frame = frame if self._held is None else pl.concat([self._held, frame])
        run = frame["ticks"].rle_id()
        if (crowded := run == run.shift(MOST_BODIES)).any():
            line = frame["source_row"][int(crowded.arg_max() or 0)]
            cause = f"line {line}: more than {MOST_BODIES} rows in a row have one time, and the sensor tracks no more"
            raise DamagedLog(path, cause, cure="Check whether a program rounded the ticks, and export them whole.")
        again = (frame["t_s"] == frame["t_s"][-1]).reverse() if frame.height else pl.Series([], dtype=pl.Boolean())
        waiting = frame.height if again.all() else int(again.arg_min() or 0)
        self._held = frame.tail(waiting)
        return self._named(frame.head(frame.height - waiting))

    def rest(self, last: pl.DataFrame) -> pl.DataFrame:
        """Return the rows of the waiting frame; `last` has their columns."""
        return self._named(last.clear().drop("person") if self._held is None else self._held)

    def _named(self, frame: pl.DataFrame) -> pl.DataFrame:
        self.rows += frame.height
        self.inferred += int((frame["state0"] == 1).sum())
        self.unseen += frame["x_m"].null_count()
        times = frame["t_s"]
        shared = (times == times.shift(-1)).fill_null(value=False)
        alone = 0 if self.several else int(shared.arg_max() or 0) if shared.any() else frame.height
        first, others = frame.head(alone), frame.slice(alone)
        if (placed := first.drop_nulls("x_m")).height:
            t_s, *place = placed.tail(1).select("t_s", "x_m", "y_m", "z_m").row(0)
            self._linker.alone(t_s, (place[0], place[1], place[2]))
        self.several = self.several or others.height > 0
        return pl.concat([first.with_columns(person=pl.lit("1")), self._linked(others.drop_nulls("x_m"))])

    def _linked(self, frame: pl.DataFrame) -> pl.DataFrame:
        run = pl.col("t_s").rle_id().alias("run")  # not the time itself: it may repeat later
        runs = frame.group_by(run, maintain_order=True).agg(pl.col("t_s").first(), pl.concat_list("x_m", "y_m", "z_m"))
        names: list[str] = []
        for _, t_s, places in runs.iter_rows():
            names += self._linker.frame(t_s, [(x, y, z) for x, y, z in places])
        return frame.with_columns(pl.Series("person", names, dtype=pl.String()))


def _warnings(bodies: _Bodies, seen: PersonCounts) -> list[str]:
    messages = []
    if bodies.several:
        messages.append("several bodies have the same time and no id: they are linked by motion")
    if bodies.inferred:
        messages.append(f"the base of the spine is inferred, not seen, in {bodies.inferred} of {bodies.rows} rows")
    if bodies.unseen:
        messages.append(f"the base of the spine is not tracked in {bodies.unseen} of {bodies.rows} rows")
    if seen.back:
        messages.append("time does not increase throughout: the rows were edited or joined")
    return messages


ADAPTER: StreamingAdapter = _Kinect2Csv()
