"""Any table in a text file whose columns the cell file maps (`adapter = "csv"` and `[sources.map]`).

Many controllers and trackers have no public format, or let everyone write their own columns. Here a person says which
column is what and in which unit, and nothing is guessed: no column is found by its name, no unit by the size of its
values. Because such a table looks like any other, this adapter recognises nothing by itself and must be named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Literal, cast

import polars as pl

from cyclekit.adapter import Adapter, ClockKind, ReadOptions, Recording, Role
from cyclekit.errors import ConfigError, DamagedLog, MissingColumns, UnknownName
from cyclekit.schema import EVENTS, PEOPLE, ROBOT, conform
from cyclekit_adapters.delimited import (
    HEAD_BYTES,
    Layout,
    Rows,
    delimiter_of,
    encoding_of,
    header_names,
    read_rows,
)

if TYPE_CHECKING:
    from pathlib import Path

_WHERE = "[sources.map] of a CSV"
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
_RADIANS = {"rad": 1.0, "deg": 0.017453292519943295}
_CLOCKS = ("epoch", "uptime", "relative")
_STATES = ("playing", "paused", "stopped")
_DELIMITERS = {"tab": "\t", "space": " ", "comma": ",", "semicolon": ";"}
_SLACK = 1e-3


@dataclass(frozen=True)
class _Map:
    """The keys of `[sources.map]`; a column key names a column of the header line."""

    delimiter: str | None = None
    decimal: str = "."
    encoding: str | None = None
    skip_rows: int = 0
    time: str | None = None
    time_unit: str = "s"
    clock: str = "relative"
    x: str | None = None
    y: str | None = None
    z: str | None = None
    length_unit: str = "m"
    person: str | None = None
    scaling: str | None = None
    scaling_max: float = 1.0
    speed: str | None = None
    state: str | None = None
    states: Mapping[str, str] = field(default_factory=dict)
    signal: str | None = None
    value: str | None = None
    joints: tuple[str, ...] = ()
    joint_unit: str = "rad"

    def places(self) -> dict[str, str]:
        """Return axis -> column."""
        return {axis: column for axis, column in zip("xyz", (self.x, self.y, self.z), strict=True) if column}


class _MappedCsv:
    def recognises(self, path: Path) -> bool:
        return False

    def read(self, path: Path, options: ReadOptions) -> Recording:
        mapping = _mapping(options.map)
        role = options.role or _role(mapping)
        layout = _layout(path, mapping)
        numbers, texts, required = _columns(mapping, role)
        if both := set(numbers).intersection(texts):
            raise ConfigError(f"{_WHERE}: column {min(both)!r} is mapped to a number and to a text")
        if missing := {*numbers, *texts}.difference(layout.names):
            raise MissingColumns(path, missing, layout.names, f"Columns of the file: {', '.join(layout.names)}.")
        if mapping.time is None and not options.rate_hz:
            cure = 'Map it in cell.toml (time = "..."), or give rate_hz = ... if the rows have a fixed rate.'
            raise MissingColumns(path, ["time"], layout.names, cure)
        rows = read_rows(path, layout, numbers=numbers, texts=texts, required=required).or_refuse(path)
        rows = _timed(rows, mapping, options.rate_hz)
        if role == "robot":
            rows = _once(rows)
        make = {"robot": _robot, "people": _people, "events": _events}[role]
        return Recording(
            **{role: make(rows.frame, mapping)},  # type: ignore[arg-type]  # the three roles are three fields
            clock=cast("ClockKind", mapping.clock),
            joint_names=mapping.joints if role == "robot" else (),
            rows_read=rows.rows_read,
            set_aside=rows.set_aside,
            warnings=tuple(_warnings(rows.frame, mapping, role)),
            facts={
                "columns": ", ".join(layout.names),
                "delimiter": repr(layout.delimiter),
                "encoding": layout.encoding,
            },
        )


def _mapping(raw: Mapping[str, object]) -> _Map:
    known = {item.name: item for item in fields(_Map)}
    for key in raw:
        if key not in known:
            raise UnknownName(_WHERE, "key", key, known)
    values = dict(raw)
    for key, value in values.items():
        _check_type(key, value)
    if "joints" in values:
        values["joints"] = tuple(map(str, cast("Sequence[str]", values["joints"])))
    mapping = _Map(**values)  # type: ignore[arg-type]  # types were checked key by key
    _one_of("time_unit", mapping.time_unit, _SECONDS)
    _one_of("length_unit", mapping.length_unit, _METRES)
    _one_of("joint_unit", mapping.joint_unit, _RADIANS)
    _one_of("clock", mapping.clock, _CLOCKS)
    _one_of("decimal", mapping.decimal, (".", ","))
    if mapping.scaling_max not in (1, 100):
        raise ConfigError(
            f"{_WHERE}: scaling_max = {mapping.scaling_max!r}", cure="It is 1 (fraction) or 100 (percent)."
        )
    for state in mapping.states.values():
        _one_of("states", state, _STATES)
    return mapping


def _check_type(key: str, value: object) -> None:
    if key == "states":
        right, wanted = (
            isinstance(value, Mapping) and all(isinstance(v, str) for v in value.values()),
            "a table of texts",
        )
    elif key == "joints":
        right = isinstance(value, Sequence) and not isinstance(value, str) and all(isinstance(v, str) for v in value)
        wanted = "a list of column names"
    elif key == "skip_rows":
        right, wanted = isinstance(value, int) and not isinstance(value, bool) and value >= 0, "a whole number"
    elif key == "scaling_max":
        right, wanted = isinstance(value, int | float) and not isinstance(value, bool), "1 or 100"
    else:
        right, wanted = isinstance(value, str), "a text"
    if not right:
        raise ConfigError(f"{_WHERE}: {key} = {value!r} is not {wanted}")


def _one_of(key: str, value: str, known: Mapping[str, float] | Sequence[str]) -> None:
    if value not in known:
        raise UnknownName(_WHERE, key, value, known)


def _role(mapping: _Map) -> Role:
    """Return what the mapped columns can only be; x, y, z alone could be the robot or a person."""
    if mapping.signal:
        return "events"
    if mapping.person:
        return "people"
    if mapping.joints or mapping.scaling or mapping.speed or mapping.state:
        return "robot"
    raise ConfigError(
        f"{_WHERE}: it does not say whose rows these are", cure='Give role = "robot", "people" or "events".'
    )


def _columns(mapping: _Map, role: Role) -> tuple[list[str], list[str], list[str]]:
    """Return the number columns, text columns and required columns of a role."""
    time = [mapping.time] if mapping.time else []
    places = mapping.places()
    if role == "events":
        if not mapping.signal or not mapping.value:
            raise ConfigError(f"{_WHERE}: events need the keys signal and value", cure="Name both columns.")
        return time, list(dict.fromkeys([mapping.signal, mapping.value])), [*time, mapping.signal]
    if places and not {"x", "y"}.issubset(places):
        raise ConfigError(f"{_WHERE}: a place needs at least x and y", cure="Name the columns of both.")
    if role == "people":
        if not places:
            raise ConfigError(f"{_WHERE}: people need the keys x and y", cure="Name the columns of both.")
        person = [mapping.person] if mapping.person else []
        return list(dict.fromkeys([*time, *places.values()])), person, [*time, *person]
    others = [column for column in (mapping.scaling, mapping.speed) if column]
    numbers = [*time, *places.values(), *others, *mapping.joints]
    if len(numbers) == len(time):
        raise ConfigError(f"{_WHERE}: nothing of the robot is mapped", cure="Map x, y, z or joints, scaling or speed.")
    return list(dict.fromkeys(numbers)), [mapping.state] if mapping.state else [], time


def _layout(path: Path, mapping: _Map) -> Layout:
    try:
        with path.open("rb") as log:
            first = log.read(HEAD_BYTES)
    except OSError as error:
        raise DamagedLog(path, f"cannot be read: {error.strerror}", cure="Check the path and its rights.") from error
    encoding = mapping.encoding or encoding_of(first)
    if encoding is None:
        raise DamagedLog(path, "not a text file: it begins with NUL bytes", cure="Export the log as text again.")
    try:
        lines = first.decode(encoding, "replace").removeprefix("\ufeff").split("\n")
    except LookupError as error:
        raise ConfigError(f"{_WHERE}: unknown encoding {encoding!r}", cure="For example utf-8 or latin-1.") from error
    if len(lines) <= mapping.skip_rows or not lines[mapping.skip_rows].strip():
        cause = f"no header in line {mapping.skip_rows + 1}"
        raise DamagedLog(path, cause, cure="The header line comes after skip_rows lines.")
    line = lines[mapping.skip_rows]
    delimiter = _delimiter(mapping, line)
    names = header_names(line, delimiter)
    comma = mapping.decimal == ","
    return Layout(names, delimiter, mapping.skip_rows + 1, decimal_comma=comma, encoding=encoding, quotes=True)


def _delimiter(mapping: _Map, header: str) -> str:
    if mapping.delimiter is None:
        return delimiter_of(header, ";\t " if mapping.decimal == "," else ",;\t ")
    delimiter = _DELIMITERS.get(mapping.delimiter, mapping.delimiter)
    if len(delimiter.encode()) != 1 or delimiter in '"\r\n' or delimiter == mapping.decimal:
        raise ConfigError(f"{_WHERE}: delimiter = {mapping.delimiter!r} is not one character, or is the decimal mark")
    return delimiter


def _timed(rows: Rows, mapping: _Map, rate_hz: float | None) -> Rows:
    if mapping.time is not None:
        t_s = pl.col(mapping.time) * _SECONDS[mapping.time_unit]
    else:
        t_s = pl.col("source_row") / cast("float", rate_hz)
    return Rows(rows.frame.with_columns(t_s.alias(_T)), rows.rows_read, rows.set_aside)


_T = "\x1ft_s"  # a name that no column of a file can have


def _once(rows: Rows) -> Rows:
    again = rows.frame[_T].eq(rows.frame[_T].shift()).fill_null(value=False)
    reason = pl.lit("repeats the time of the row before it").alias("reason")
    aside = pl.concat([rows.set_aside, rows.frame.filter(again).select("source_row", reason)]).sort("source_row")
    return Rows(rows.frame.filter(~again), rows.rows_read, aside)


def _robot(frame: pl.DataFrame, mapping: _Map) -> pl.DataFrame:
    metres, radians = _METRES[mapping.length_unit], _RADIANS[mapping.joint_unit]
    columns = [pl.col(_T).alias("t_s"), pl.col("source_row")]
    columns += [(pl.col(column) * metres).alias(f"tcp_{axis}_m") for axis, column in mapping.places().items()]
    columns += [(pl.col(column) * radians).alias(f"q{i}_rad") for i, column in enumerate(mapping.joints)]
    if mapping.speed:
        columns.append((pl.col(mapping.speed).abs() * metres).alias("tcp_speed_m_s"))
    if mapping.scaling:
        columns.append(_fraction(mapping).alias("scaling"))
    if mapping.state:
        words = dict(zip(_STATES, _STATES, strict=True)) | dict(mapping.states)
        state = pl.col(mapping.state).replace_strict(words, default=None, return_dtype=pl.String)
        columns.append(state.alias("state"))
    return conform(frame.select(columns), ROBOT)


def _fraction(mapping: _Map) -> pl.Expr:
    value = pl.col(str(mapping.scaling)) / mapping.scaling_max
    return pl.when(value.is_between(0.0, 1.0 + _SLACK)).then(value.clip(0.0, 1.0))


def _people(frame: pl.DataFrame, mapping: _Map) -> pl.DataFrame:
    metres = _METRES[mapping.length_unit]
    places = [(pl.col(column) * metres).alias(f"{axis}_m") for axis, column in mapping.places().items()]
    person = pl.col(mapping.person) if mapping.person else pl.lit("0")
    return conform(frame.select(pl.col(_T).alias("t_s"), person.alias("person"), "source_row", *places), PEOPLE)


def _events(frame: pl.DataFrame, mapping: _Map) -> pl.DataFrame:
    signal, value = pl.col(str(mapping.signal)).alias("signal"), pl.col(str(mapping.value)).alias("value")
    return conform(frame.select(pl.col(_T).alias("t_s"), signal, value, "source_row"), EVENTS)


def _warnings(frame: pl.DataFrame, mapping: _Map, role: Literal["robot", "people", "events"]) -> list[str]:
    said = []
    back = int((frame[_T].diff() < 0).sum())
    if back and role == "robot":
        said.append(f"time steps back {back} time(s): each part is a run of its own")
    if mapping.scaling and role == "robot":
        value = frame[mapping.scaling]
        beyond = int(((value < 0.0) | (value > mapping.scaling_max * (1.0 + _SLACK))).sum())
        if beyond:
            said.append(
                f"scaling is outside 0..{mapping.scaling_max:g} in {beyond} rows and unknown there; see scaling_max"
            )
    if mapping.state and role == "robot":
        words = frame[mapping.state].drop_nulls().unique().to_list()
        if other := sorted(set(words) - set(_STATES) - set(mapping.states)):
            said.append(f"states {', '.join(map(repr, other[:5]))} have no meaning here; map them in `states`")
    return said


ADAPTER: Adapter = _MappedCsv()
