"""The cell file (cell.toml): read, checked, and kept as frozen dataclasses.

A cell file tells what the logs cannot: which file plays which role, where the tracker stands, how the clocks relate,
what the places are called. Every key has a default that works; an unknown key is refused with the nearest known one.
What the settings do is the business of the rooms that get them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal, get_args

from cyclekit.errors import ConfigError, UnknownName
from cyclekit.toml_file import list_at, read_toml

if TYPE_CHECKING:
    from pathlib import Path

Begin = Literal["auto", "file", "gap", "home", "register", "digital-output"]
Point = tuple[float, float, float]
Matrix = tuple[Point, Point, Point]
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Frame:
    """Where a log's frame stands in the robot base frame: p_base = rotation @ p + xyz_m, after turning up to z.

    Attributes:
        xyz_m: Origin of the log's frame, base frame, metres.
        rotation: Row-major rotation matrix; from `yaw_deg` (about base z) where the file gives that.
    """

    xyz_m: Point = (0.0, 0.0, 0.0)
    rotation: Matrix = IDENTITY


@dataclass(frozen=True)
class Source:
    """One kind of log in the folder.

    Attributes:
        path: File, folder or glob, relative to the folder of logs.
        adapter: Adapter to use; None = found by content.
        role: robot, people or events; None = all that the log holds.
        clock_offset_s: Added to this log's time to get the robot log's time; None = not known.
        clock_rate: Seconds of the robot log per second of this log.
        frame: Where the log's frame stands; None = not known (taken as the base frame, with a warning).
        body: Which rigid body, marker or topic is the operator.
        rate_hz: Rate of a log that has no clock.
        map: Columns, units or topics, as the adapter understands them.
    """

    path: str
    adapter: str | None = None
    role: Literal["robot", "people", "events"] | None = None
    clock_offset_s: float | None = None
    clock_rate: float = 1.0
    frame: Frame | None = None
    body: str | None = None
    rate_hz: float | None = None
    map: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class NamedPlace:
    """A place that the integrator named: positions within `radius_m` of `xyz_m` (base frame) are there."""

    xyz_m: Point
    radius_m: float = 0.05


@dataclass(frozen=True)
class Executions:
    """How executions of the process begin.

    Attributes:
        begin: `auto` splits at gaps and, where the log stays continuous, at departures from home.
        gap_s: A silence of the robot log longer than this separates executions.
        home: Place that an execution starts from; None = where the recording starts, if it returns there.
        bit: Digital output whose rising edge begins an execution (begin = "digital-output").
    """

    begin: Begin = "auto"
    gap_s: float = 2.0
    home: str | None = None
    bit: int = 0


@dataclass(frozen=True)
class Cell:
    """A cell: its sources, places and conventions.

    Attributes:
        ignore: Globs of files that are no logs.
        reference: Globs of robot logs recorded with nobody in the cell.
        rate_hz: Rate of the samples.
        bridge_s: A gap in the operator's track up to this long is bridged linearly; longer ones stay unknown.
    """

    name: str = "cell"
    sources: tuple[Source, ...] = ()
    ignore: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()
    places: Mapping[str, NamedPlace] = field(default_factory=dict)
    human_places: Mapping[str, NamedPlace] = field(default_factory=dict)
    executions: Executions = field(default_factory=Executions)
    rate_hz: float = 10.0
    bridge_s: float = 0.3


def load_cell(path: Path) -> Cell:
    """Read a cell file.

    Raises:
        ConfigError: The file cannot be read, or a value is of the wrong kind.
        UnknownName: A key is not known.
    """
    raw = read_toml(path)
    where = str(path)
    _only(where, raw, Cell)
    sources = tuple(_source(f"{where} sources[{i}]", entry) for i, entry in enumerate(list_at(where, raw, "sources")))
    return Cell(
        name=_text(where, raw, "name") or path.resolve().parent.name,
        sources=sources,
        ignore=tuple(map(str, list_at(where, raw, "ignore"))),
        reference=tuple(map(str, list_at(where, raw, "reference"))),
        places=_places(f"{where} [places]", raw.get("places", {})),
        human_places=_places(f"{where} [human_places]", raw.get("human_places", {})),
        executions=_executions(f"{where} [executions]", raw.get("executions", {})),
        rate_hz=_positive(where, raw, "rate_hz", 10.0),
        bridge_s=_number(where, raw, "bridge_s", 0.3),
    )


def _only(where: str, raw: object, shape: type) -> None:
    if not isinstance(raw, Mapping):
        raise ConfigError(f"{where}: must be a table", cure="See docs/commands.md for the cell file.")
    known = [f.name for f in fields(shape)]
    for key in raw:
        if key not in known:
            raise UnknownName(where, "key", str(key), known)
    for needed in fields(shape):
        if needed.default is MISSING and needed.default_factory is MISSING and needed.name not in raw:
            raise ConfigError(f"{where}: no {needed.name!r}", cure=f"Add {needed.name} = …")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _number(where: str, raw: Mapping[str, Any], key: str, default: float) -> float:
    value = raw.get(key, default)
    if not _is_number(value):
        raise ConfigError(f"{where}: {key} = {value!r} must be a number", cure=f"{key} = {default:g}")
    return float(value)


def _positive(where: str, raw: Mapping[str, Any], key: str, default: float) -> float:
    value = _number(where, raw, key, default)
    if value <= 0:
        raise ConfigError(f"{where}: {key} = {value!r} must be a positive number", cure=f"{key} = {default:g}")
    return value


def _text(where: str, raw: Mapping[str, Any], key: str) -> str | None:
    value = raw.get(key)
    if value is not None and not isinstance(value, str):
        raise ConfigError(f"{where}: {key} = {value!r} must be a text", cure=f'{key} = "{value}"')
    return value


def _table(where: str, value: object) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where}: {value!r} must be a table", cure="See docs/commands.md for the cell file.")
    return value


def _executions(where: str, raw: Mapping[str, Any]) -> Executions:
    _only(where, raw, Executions)
    if raw.get("begin", "auto") not in get_args(Begin):
        raise UnknownName(where, "value of begin", str(raw["begin"]), get_args(Begin))
    bit = raw.get("bit", 0)
    if not isinstance(bit, int) or isinstance(bit, bool) or not 0 <= bit < 63:
        raise ConfigError(f"{where}: bit = {bit!r} must be a number from 0 to 62", cure="bit = 0")
    return Executions(raw.get("begin", "auto"), _positive(where, raw, "gap_s", 2.0), _text(where, raw, "home"), bit)


def _source(where: str, entry: Mapping[str, Any]) -> Source:
    _only(where, entry, Source)
    role = entry.get("role")
    if role not in (None, "robot", "people", "events"):
        raise UnknownName(where, "role", str(role), ["robot", "people", "events"])
    return Source(
        path=_text(where, entry, "path") or "",
        adapter=_text(where, entry, "adapter"),
        role=role,
        clock_offset_s=_number(where, entry, "clock_offset_s", 0.0) if "clock_offset_s" in entry else None,
        clock_rate=_positive(where, entry, "clock_rate", 1.0),
        frame=_frame(f"{where} frame", entry["frame"]) if "frame" in entry else None,
        body=_text(where, entry, "body"),
        rate_hz=_positive(where, entry, "rate_hz", 100.0) if "rate_hz" in entry else None,
        map=dict(_table(f"{where} map", entry.get("map", {}))),
    )


def _frame(where: str, raw: object) -> Frame:
    raw = _table(where, raw)
    known = ["xyz_m", "yaw_deg", "rotation"]
    for key in raw:
        if key not in known:
            raise UnknownName(where, "key", key, known)
    if "yaw_deg" in raw and "rotation" in raw:
        raise ConfigError(f"{where}: both yaw_deg and rotation", cure="Keep one of them.")
    if "rotation" in raw:
        rows = tuple(_point(f"{where} rotation", row) for row in list_at(where, raw, "rotation"))
        if len(rows) != 3 or not _orthonormal(rows):
            raise ConfigError(f"{where}: rotation is no rotation matrix", cure="Give three orthonormal rows, det +1.")
        rotation: Matrix = (rows[0], rows[1], rows[2])
    else:
        yaw = math.radians(_number(where, raw, "yaw_deg", 0.0))
        c, s = math.cos(yaw), math.sin(yaw)
        rotation = ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))
    return Frame(_point(f"{where} xyz_m", raw.get("xyz_m", [0.0, 0.0, 0.0])), rotation)


def _orthonormal(rows: tuple[Point, ...]) -> bool:
    a, b, c = rows
    dots = [sum(x * y for x, y in zip(p, q, strict=True)) for p in rows for q in rows]
    wanted = [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]
    cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    right_handed = sum(x * y for x, y in zip(cross, c, strict=True)) > 0
    return right_handed and all(abs(x - y) < 1e-3 for x, y in zip(dots, wanted, strict=True))


def _point(where: str, value: object) -> Point:
    if not isinstance(value, list | tuple) or len(value) != 3 or not all(map(_is_number, value)):
        raise ConfigError(f"{where}: {value!r} is no point", cure="Give three numbers in metres: [x, y, z].")
    return float(value[0]), float(value[1]), float(value[2])


def _places(where: str, raw: object) -> dict[str, NamedPlace]:
    found = {}
    for name, entry in _table(where, raw).items():
        _only(f"{where[:-1]}.{name}]", entry, NamedPlace)
        radius = _positive(f"{where[:-1]}.{name}]", entry, "radius_m", 0.05)
        found[name] = NamedPlace(_point(f"{where} {name} xyz_m", entry["xyz_m"]), radius)
    return found


def cell_to_toml(cell: Cell) -> str:
    """Return the cell file that would give this cell; comments say what a person may want to fill in."""
    lines = [f"name = {_toml(cell.name)}"]
    lines += [f"ignore = {_toml(list(cell.ignore))}"] if cell.ignore else []
    lines += [f"reference = {_toml(list(cell.reference))}  # logs with nobody in the cell"] if cell.reference else []
    lines += [f"rate_hz = {_toml(cell.rate_hz)}"] if cell.rate_hz != Cell.rate_hz else []
    lines += [f"bridge_s = {_toml(cell.bridge_s)}"] if cell.bridge_s != Cell.bridge_s else []
    for source in cell.sources:
        lines += ["", "[[sources]]"]
        for key, value in vars(source).items():
            if value is not None and value != {} and (key, value) != ("clock_rate", 1.0):
                lines.append(f"{key} = {_toml(value)}")
        if source.role == "people" and source.frame is None:
            lines.append("# frame = { xyz_m = [0.0, 0.0, 0.0], yaw_deg = 0.0 }  # where the tracker stands")
        if source.role in {"people", "events"} and source.clock_offset_s is None:
            lines.append("# clock_offset_s = 0.0  # add to this log's time to get the robot log's time")
    for title, places in (("places", cell.places), ("human_places", cell.human_places)):
        for name, place in places.items():
            xyz, radius = _toml(list(place.xyz_m)), _toml(place.radius_m)
            lines += ["", f"[{title}.{_key(name)}]", f"xyz_m = {xyz}", f"radius_m = {radius}"]
    begin = cell.executions
    lines += [
        "",
        "[executions]",
        f'begin = "{begin.begin}"  # {", ".join(get_args(Begin))}',
        f"gap_s = {_toml(begin.gap_s)}",
    ]
    lines += [f"home = {_toml(begin.home)}"] if begin.home else []
    lines += [f"bit = {begin.bit}"] if begin.bit else []
    return "\n".join(lines) + "\n"


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() and name.isascii() else _toml(name)


def _toml(value: object) -> str:
    if isinstance(value, Frame):
        rotation = [list(row) for row in value.rotation]
        return f"{{ xyz_m = {_toml(list(value.xyz_m))}, rotation = {_toml(rotation)} }}"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(str(k))} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML's escapes are those of JSON
    return repr(value)
