"""Keys of `[sources.map]` for a CSV: meaning and unit of each column, checked.

`mapped_csv` reads the table with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, cast

from cyclekit.errors import ConfigError, UnknownName
from cyclekit_adapters.times.units import FRAME, checked_unit, unit_named
from cyclekit_adapters.times.written_time import checked_zone

if TYPE_CHECKING:
    from cyclekit.adapter import ReadOptions, Role

WHERE = "[sources.map] of a CSV"
METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
RADIANS = {"rad": 1.0, "deg": 0.017453292519943295}
STATES = ("playing", "paused", "stopped")
_CLOCKS = ("epoch", "uptime", "relative")
_DELIMITERS = {"tab": "\t", "space": " ", "comma": ",", "semicolon": ";", "whitespace": "\\s+"}
_NUMBERS = {"scaling_max": (1, 100)}
_LISTS = ("time", "time_unit", "scaling", "joints", "columns", "signal", "tags", "good")
SIGNAL_JOIN = " / "
"""Between the parts of a signal's name that several columns hold, such as device and event."""


@dataclass(frozen=True)
class CsvMap:
    """Keys of the map; keys of several columns are tuples. `map_columns` resolves column entries.

    Attributes:
        sheet: Sheet of an Excel workbook; None = the first one that holds a table.
        transposed: Each line is a series, its name first.
        columns: Column names of a table without a header line.
        time: Column of the time, or of date and time of day, or of its parts (seconds and nanoseconds).
        time_unit: Unit of a numeric time, or of each of its parts, the largest first (`times.units`), or `frame`; empty
            = not given.
        time_format: Format of a time in text: "iso", or a pattern such as "%d.%m.%Y %H:%M:%S%.f".
        time_zone: Time zone of such a time, for example "Europe/Rome"; without it the clock counts as relative.
        confidence: Column of the tracker's confidence in a person's position; 0 = it repeats an old one.
        missing: Numbers that mean not seen or not measured.
        scaling: Columns whose product is the speed scaling.
        signal: Column of the signal's name, or its parts: device and event of a safety controller's export.
        tags: Columns that are one signal each, such as those of a PLC trace.
        names: Tag or column -> signal name.
        only: Column -> its values in the rows to read, such as those of one robot of several; the others are no loss.
        quality: Column of a value's quality; rows with a quality not in `good` are set aside.
    """

    sheet: str | None = None
    delimiter: str | None = None
    decimal: str = "."
    encoding: str | None = None
    skip_rows: int = 0
    transposed: bool = False
    columns: tuple[str, ...] = ()
    time: tuple[str, ...] = ()
    time_unit: tuple[str, ...] = ()
    time_format: str | None = None
    time_zone: str | None = None
    clock: str | None = None
    x: str | None = None
    y: str | None = None
    z: str | None = None
    length_unit: str = "m"
    person: str | None = None
    confidence: str | None = None
    missing: tuple[float, ...] = ()
    scaling: tuple[str, ...] = ()
    scaling_max: float = 1.0
    slider: str | None = None
    speed: str | None = None
    state: str | None = None
    states: Mapping[str, str] = field(default_factory=dict)
    digital_in: str | None = None
    digital_out: str | None = None
    register: str | None = None
    signal: tuple[str, ...] = ()
    value: str | None = None
    tags: tuple[str, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    only: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    quality: str | None = None
    good: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    joint_unit: str = "rad"

    def places(self) -> dict[str, str]:
        """Return axis -> column of the position."""
        return {axis: column for axis, column in zip("xyz", (self.x, self.y, self.z), strict=True) if column}

    def separator(self) -> str | None:
        """Return the field delimiter; None = determine it from the header."""
        return None if self.delimiter is None else _DELIMITERS.get(self.delimiter, self.delimiter)

    def role(self) -> Role:
        """Return the role implied by the mapped columns; x, y, z alone fit both robot and person.

        Raises:
            ConfigError: Several roles are possible.
        """
        if self.signal or self.tags:
            return "events"
        if self.person or self.confidence:
            return "people"
        if self.joints or self.scaling or self.speed or self.state or self.slider:
            return "robot"
        seen = f"{WHERE}: no role is given"
        raise ConfigError(seen, cure='Give role = "robot", "people" or "events" in [[sources]], above [sources.map].')


def csv_map(options: ReadOptions) -> CsvMap:
    """Return the checked keys of a source of the cell file.

    Raises:
        UnknownName: A key, unit or word is unknown.
        ConfigError: A value has the wrong type, or two values contradict each other.
    """
    known = {item.name: item for item in fields(CsvMap)}
    values = dict(options.map)
    for key, value in values.items():
        if key not in known:
            raise UnknownName(WHERE, "key", key, known)
        values[key] = _checked(key, value)
    mapping = CsvMap(**values)  # type: ignore[arg-type]  # types were checked key by key
    for unit in mapping.time_unit:
        checked_unit(unit, WHERE, (FRAME,))
    _one_of("length_unit", mapping.length_unit, METRES)
    _one_of("joint_unit", mapping.joint_unit, RADIANS)
    _one_of("clock", mapping.clock or "relative", _CLOCKS)
    _one_of("decimal", mapping.decimal, (".", ","))
    for state in mapping.states.values():
        _one_of("states", state, STATES)
    _agree(mapping, options.rate_hz)
    return mapping


def _agree(mapping: CsvMap, rate_hz: float | None) -> None:
    """Refuse keys that contradict each other."""
    separator = mapping.separator()
    if separator is not None and (
        not separator or set(separator) & set('"\r\n') or separator == mapping.decimal == "."
    ):
        raise ConfigError(f"{WHERE}: delimiter = {mapping.delimiter!r} cannot separate fields")
    local = any(unit is not None and unit.local for unit in map(unit_named, mapping.time_unit))
    if mapping.time_zone is not None and mapping.time_format is None and not local:
        raise ConfigError(f"{WHERE}: time_zone without time_format", cure='Add time_format = "iso" or a pattern.')
    if mapping.tags and mapping.signal:
        cure = "Name the columns in tags where each column is a signal, else signal and value."
        raise ConfigError(f"{WHERE}: both tags and signal", cure=cure)
    if (mapping.quality is None) != (not mapping.good):
        cure = 'Add both: quality = "Quality", good = ["GOOD", "192"].'
        raise ConfigError(f"{WHERE}: quality and good go together", cure=cure)
    _agree_on_time(mapping, rate_hz)
    checked_zone(mapping.time_zone, WHERE)


def _agree_on_time(mapping: CsvMap, rate_hz: float | None) -> None:
    units, parts = mapping.time_unit, mapping.time
    if FRAME in units and (not rate_hz or len(units) > 1):
        raise ConfigError(
            f"{WHERE}: time counts frames, and no rate is given", cure="Give rate_hz = ... in the source."
        )
    if mapping.time_format is not None:
        return
    known = [unit for text in units if (unit := unit_named(text))]
    if len(units) > 1 and any(unit.zero_s is not None for unit in known):
        raise ConfigError(f"{WHERE}: time_unit = {list(units)}", cure="A count of dates is one column alone.")
    if len(units) > 1 and (len(units) != len(parts) or sorted(known, key=lambda unit: -unit.seconds) != known):
        seen = f"{WHERE}: {len(parts)} columns of time and time_unit = {list(units)}"
        raise ConfigError(seen, cure='Give a unit for each, the largest first: time_unit = ["s", "ns"].')
    if len(parts) > 1 and len(units) < 2:
        cure = 'Add time_format, for example "%d.%m.%Y %H:%M:%S", or the unit of each: time_unit = ["s", "ns"].'
        raise ConfigError(f"{WHERE}: several columns of time without format and units", cure=cure)


def _checked(key: str, value: object) -> object:
    if key in ("states", "names"):
        right = isinstance(value, Mapping) and all(isinstance(v, str) for v in value.values())
        wanted = "a table of texts"
    elif key == "only":
        listed = {name: [one] if isinstance(one, str) else one for name, one in _items(value)}
        right = bool(listed) and all(_is_texts(some) for some in listed.values())
        wanted = 'a table of texts, such as { robot_id = "R1" }'
        value = {name: tuple(map(str, some)) for name, some in listed.items()} if right else value
    elif key in _LISTS:
        if isinstance(value, str) and key != "columns":
            return (value,)
        right = isinstance(value, Sequence) and not isinstance(value, str) and all(isinstance(v, str) for v in value)
        wanted, value = "a list of column names", tuple(map(str, cast("Sequence[str]", value))) if right else value
    elif key == "missing":
        right = isinstance(value, Sequence) and not isinstance(value, str) and all(map(_is_number, value))
        wanted, value = "a list of numbers", tuple(map(float, cast("Sequence[float]", value))) if right else value
    elif key == "skip_rows":
        right, wanted = isinstance(value, int) and not isinstance(value, bool) and value >= 0, "a whole number"
    elif key == "transposed":
        right, wanted = isinstance(value, bool), "true or false"
    elif key == "scaling_max":
        right, wanted = not isinstance(value, bool) and value in _NUMBERS[key], "1 (fraction) or 100 (percent)"
    else:
        right, wanted = isinstance(value, str), "a text"
    if not right:
        raise ConfigError(f"{WHERE}: {key} = {value!r} is not {wanted}")
    return value


def _items(value: object) -> list[tuple[str, Any]]:
    return list(value.items()) if isinstance(value, Mapping) else []


def _is_texts(value: object) -> bool:
    return isinstance(value, Sequence) and len(value) > 0 and all(isinstance(one, str) for one in value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _one_of(key: str, value: str, known: Mapping[str, float] | Sequence[str]) -> None:
    if value not in known:
        raise UnknownName(WHERE, key, value, known)
