"""Any delimited table whose columns the cell file maps: logs without a public format.

This is how exports of FANUC, ABB, Yaskawa, Doosan, Techman and xArm, PLC logs and laser scanner tracks come in. The
cell file says which column is what and in which unit, and nothing is guessed: no column is found by its name, no unit
by the size of its values. Because such a table looks like any other, this adapter recognises nothing by itself and must
be named.
"""

from __future__ import annotations

import codecs
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, Role, StreamingAdapter, whole
from cyclekit.errors import ConfigError, DamagedLog, MissingColumns
from cyclekit.schema import EVENTS, PEOPLE, ROBOT, conform
from cyclekit_adapters.controller_time import Back, Once, Spread
from cyclekit_adapters.csv_map import METRES, RADIANS, STATES, WHERE, CsvMap, csv_map
from cyclekit_adapters.delimited import Layout, Rows, delimiter_of, header_names, read_blocks, unique
from cyclekit_adapters.header_line import names_in
from cyclekit_adapters.in_parts import in_parts
from cyclekit_adapters.mapped_time import T_S, name_their_zone, require_epoch, timed
from cyclekit_adapters.text_blocks import file_encoding, head_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from cyclekit.adapter import ClockKind

_SLACK = 1e-3
_LINES_SEARCHED = 50  # for the header, where it is not in the line that it should be in


class _MappedCsv:
    def recognises(self, path: Path) -> bool:
        return False

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return whole(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        mapping = csv_map(options)
        role = options.role or mapping.role()
        if role == "tasks":
            cure = 'Give adapter = "task-list" in its place, with the columns in [sources.map].'
            raise ConfigError(f"{path}: a mapped table cannot be read as tasks", cure=cure)
        numbers, texts, required = _columns(mapping, role)
        layout = _layout(path, mapping, {*numbers, *texts})
        if both := set(numbers).intersection(texts):
            raise ConfigError(f"{WHERE}: column {min(both)!r} is mapped to a number and to a text")
        if missing := {*numbers, *texts}.difference(layout.names):
            raise MissingColumns(path, missing, layout.names, _cure(path, layout, {*numbers, *texts}, mapping))
        if not mapping.time and not options.rate_hz:
            cure = 'Map it in cell.toml (time = "..."), or give rate_hz = ... if the rows have a fixed rate.'
            raise MissingColumns(path, ["time"], layout.names, cure)
        zoned = name_their_zone(path, layout, mapping)
        clock = mapping.clock_kind(zoned=zoned)
        once, seen, back = Once(T_S), _Seen(mapping, role), Back(T_S, mapping.person)
        table: Callable[[pl.DataFrame, CsvMap], pl.DataFrame] = {"robot": _robot, "people": _people, "events": _events}[
            role
        ]

        def make(rows: Rows) -> Recording:
            rows = timed(rows, mapping, options.rate_hz, zoned=zoned)
            if clock == "epoch":
                require_epoch(path, rows.frame, mapping)
            if role == "robot":
                rows = once.rows(rows, "repeats the time of the row before it")
            else:
                back.add(rows.frame)
            rows = replace(rows, frame=seen.without_missing(rows.frame))
            seen.add(rows.frame)
            return Recording(
                **{role: table(rows.frame, mapping)},  # type: ignore[arg-type]  # the three roles are three fields
                clock=clock,
                joint_names=mapping.joints if role == "robot" else (),
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {
                "columns": ", ".join(name[:80] for name in layout.names[:60]),
                "delimiter": repr(layout.delimiter),
                "encoding": layout.encoding,
            }
            return replace(last, warnings=(*seen.warnings(once.back, clock), *back.warnings()), facts=facts)

        some = [*numbers, *texts] if role == "robot" else []
        some = [name for name in some if name not in mapping.time]
        blocks = read_blocks(path, layout, numbers=numbers, texts=texts, required=required, any_of=some)
        yield from in_parts(path, blocks, make, finish)


def _columns(mapping: CsvMap, role: Role) -> tuple[list[str], list[str], list[str]]:
    """Return the number columns, text columns and required columns of a role."""
    time = list(mapping.time)
    number_time, text_time = ([], time) if mapping.time_format else (time, [])
    places = mapping.places()
    if role == "events":
        if not mapping.signal or not mapping.value:
            raise ConfigError(f"{WHERE}: events need the keys signal and value", cure="Name both columns.")
        texts = list(dict.fromkeys([*text_time, mapping.signal, mapping.value]))
        return number_time, texts, [*time, mapping.signal]
    if places and not {"x", "y"}.issubset(places):
        raise ConfigError(f"{WHERE}: a place needs at least x and y", cure="Name the columns of both.")
    if role == "people":
        if not places:
            raise ConfigError(f"{WHERE}: people need the keys x and y", cure="Name the columns of both.")
        person = [mapping.person] if mapping.person else []
        numbers = [*number_time, *places.values(), *([mapping.confidence] if mapping.confidence else [])]
        return list(dict.fromkeys(numbers)), [*text_time, *person], [*time, *person]
    whole_numbers = (mapping.digital_out, mapping.register)
    others = [column for column in (*mapping.scaling, mapping.slider, mapping.speed, *whole_numbers) if column]
    numbers = [*places.values(), *others, *mapping.joints]
    if not numbers:
        raise ConfigError(f"{WHERE}: nothing of the robot is mapped", cure="Map x, y, z or joints, scaling or speed.")
    state = [mapping.state] if mapping.state else []
    return list(dict.fromkeys([*number_time, *numbers])), [*text_time, *state], time


def _cure(path: Path, layout: Layout, wanted: set[str], mapping: CsvMap) -> str:
    """Say what to do where a mapped column is not in the header."""
    if any("\ufffd" in name for name in layout.names):
        return f'The header is not written in {layout.encoding}: give encoding, for example "latin-1".'
    for number, line in enumerate(head_lines(path, _LINES_SEARCHED, layout.encoding)):
        for mark in dict.fromkeys((layout.delimiter, ",", ";", "\t", "|", " ")):
            if wanted.issubset(header_names(line, mark)) and not mapping.columns:
                return f"They stand in line {number + 1}: give skip_rows = {number}, delimiter = {mark!r}."
    return f"Columns of line {mapping.skip_rows + 1}: {', '.join(name[:40] for name in layout.names[:60])}."


def _layout(path: Path, mapping: CsvMap, wanted: set[str]) -> Layout:
    try:
        encoding = mapping.encoding or file_encoding(path)
        codecs.getincrementaldecoder(encoding or "utf-8")("replace").decode("".encode(encoding or "utf-8"))
    except (LookupError, UnicodeError) as error:
        raise ConfigError(
            f"{WHERE}: unknown encoding {mapping.encoding!r}", cure="For example utf-8 or latin-1."
        ) from error
    if encoding is None:
        raise DamagedLog(path, "not a text file: it begins with NUL bytes", cure="Export the log as text again.")
    lines = head_lines(path, mapping.skip_rows + 1, encoding)
    if len(lines) <= mapping.skip_rows or not lines[mapping.skip_rows].strip():
        cause = f"no header in line {mapping.skip_rows + 1}"
        raise DamagedLog(path, cause, cure="The header line comes after skip_rows lines.")
    line = lines[mapping.skip_rows]
    delimiter = mapping.separator() or _delimiter(line, mapping, wanted)
    names = unique(mapping.columns) if mapping.columns else names_in(path, line, delimiter)
    skipped = mapping.skip_rows + (not mapping.columns)
    return Layout(names, delimiter, skipped, decimal_comma=mapping.decimal == ",", encoding=encoding, quotes=True)


def _delimiter(line: str, mapping: CsvMap, wanted: set[str]) -> str:
    """Return the delimiter under which the mapped columns are there, else the likeliest."""
    candidates = ";\t " if mapping.decimal == "," else ",;\t "

    def fits(mark: str) -> bool:
        if mapping.columns:
            return line.rstrip(mark).count(mark) == len(mapping.columns) - 1
        return wanted.issubset(header_names(line, mark))

    return next((mark for mark in candidates if fits(mark)), delimiter_of(line, candidates))


def _robot(frame: pl.DataFrame, mapping: CsvMap) -> pl.DataFrame:
    metres, radians = METRES[mapping.length_unit], RADIANS[mapping.joint_unit]
    columns = [pl.col(T_S).alias("t_s"), pl.col("source_row")]
    columns += [(pl.col(column) * metres).alias(f"tcp_{axis}_m") for axis, column in mapping.places().items()]
    columns += [(pl.col(column) * radians).alias(f"q{i}_rad") for i, column in enumerate(mapping.joints)]
    if mapping.speed:
        columns.append((pl.col(mapping.speed).abs() * metres).alias("tcp_speed_m_s"))
    if mapping.scaling:
        product = _fraction(mapping.scaling[0], mapping)
        for column in mapping.scaling[1:]:
            product = product * _fraction(column, mapping)
        columns.append(product.alias("scaling"))
    if mapping.slider:
        columns.append(_fraction(mapping.slider, mapping).alias("slider"))
    if mapping.state:
        words = dict(zip(STATES, STATES, strict=True)) | dict(mapping.states)
        state = pl.col(mapping.state).replace_strict(words, default=None, return_dtype=pl.String)
        columns.append(state.alias("state"))
    bits = {mapping.digital_out: "digital_out_bits", mapping.register: "register"}
    columns += [pl.col(n).cast(pl.Int64, strict=False).alias(name) for n, name in bits.items() if n]
    return conform(frame.select(columns), ROBOT)


def _fraction(column: str, mapping: CsvMap) -> pl.Expr:
    value = pl.col(column) / mapping.scaling_max
    return pl.when(value.is_between(0.0, 1.0 + _SLACK)).then(value.clip(0.0, 1.0))


def _people(frame: pl.DataFrame, mapping: CsvMap) -> pl.DataFrame:
    metres = METRES[mapping.length_unit]
    places = [(pl.col(column) * metres).alias(f"{axis}_m") for axis, column in mapping.places().items()]
    person = pl.col(mapping.person) if mapping.person else pl.lit("0")
    return conform(frame.select(pl.col(T_S).alias("t_s"), person.alias("person"), "source_row", *places), PEOPLE)


def _events(frame: pl.DataFrame, mapping: CsvMap) -> pl.DataFrame:
    signal, value = pl.col(str(mapping.signal)).alias("signal"), pl.col(str(mapping.value)).alias("value")
    return conform(frame.select(pl.col(T_S).alias("t_s"), signal, value, "source_row"), EVENTS)


@dataclass
class _Seen:
    """What was seen so far that a person must know."""

    mapping: CsvMap
    role: Role
    states: set[str] = field(default_factory=set)
    beyond: int = 0
    rows: int = 0
    missing: int = 0
    unsure: int = 0

    def __post_init__(self) -> None:
        self.spread = Spread((*self.mapping.scaling, *([self.mapping.slider] if self.mapping.slider else [])))

    def without_missing(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return rows with null for what was not seen: a place all of whose numbers, any other number that is missing.

        What is not sure at all is a place that was seen before.
        """
        mapping, places = self.mapping, list(self.mapping.places().values())
        self.rows += frame.height
        nowhere = pl.lit(value=False)
        if mapping.missing and places:
            nowhere = pl.all_horizontal(pl.col(name).is_in(mapping.missing) for name in places).fill_null(value=False)
            self.missing += int(frame.select(nowhere.sum()).item())
        if mapping.confidence and self.role == "people":
            unsure = (pl.col(mapping.confidence) <= 0.0).fill_null(value=False)
            self.unsure += int(frame.select(unsure.sum()).item())
            nowhere = nowhere | unsure
        known = [pl.when(~nowhere).then(pl.col(name)).alias(name) for name in places]
        others = [*mapping.scaling, *mapping.joints, *filter(None, (mapping.slider, mapping.speed))]
        known += [pl.when(~pl.col(name).is_in(mapping.missing)).then(pl.col(name)).alias(name) for name in others]
        return frame.with_columns(known) if mapping.missing or mapping.confidence else frame

    def add(self, frame: pl.DataFrame) -> None:
        if self.role != "robot":
            return
        self.spread.add(frame)
        top = self.mapping.scaling_max * (1.0 + _SLACK)
        wrong = [(frame[column] < 0.0) | (frame[column] > top) for column in self.mapping.scaling]
        self.beyond += sum(int(mask.sum()) for mask in wrong)
        if self.mapping.state:
            self.states |= set(frame[self.mapping.state].drop_nulls().unique().to_list())

    def warnings(self, back: int, clock: ClockKind) -> list[str]:
        mapping, said = self.mapping, []
        if back:
            said.append(f"time steps back {back} time(s): each part is a run of its own")
        if self.missing:
            numbers = ", ".join(f"{number:g}" for number in mapping.missing)
            said.append(f"the place is missing ({numbers}) in {self.missing} of {self.rows} rows: unknown there")
        if self.unsure:
            said.append(f"{mapping.confidence} is 0 in {self.unsure} of {self.rows} rows: nobody is seen there")
        if self.beyond:
            top = f"0..{mapping.scaling_max:g}"
            said.append(f"scaling is outside {top} in {self.beyond} rows and unknown there; see scaling_max")
        said += [
            f"{column} never exceeds 1 percent: is it a fraction? see scaling_max"
            for column in mapping.scaling
            if mapping.scaling_max == 100 and 0 < self.spread.most.get(column, 0) <= 1.0
        ]
        if other := sorted(self.states - set(STATES) - set(mapping.states)):
            said.append(f"states {', '.join(map(repr, other[:5]))} have no meaning here; map them in `states`")
        if mapping.time_format and clock != "epoch":
            said.append("its times of day have no zone, so they cannot be placed among other logs; give time_zone")
        return said


ADAPTER: StreamingAdapter = _MappedCsv()
