"""The text of a cell file -> a `Cell`, every value checked, every slip named with file, key and cure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from datetime import datetime
from typing import TYPE_CHECKING, Any, get_args

from cyclekit.config.arms import MODELS
from cyclekit.config.cells import (
    CLOCK_KEYS,
    Begin,
    Cell,
    Executions,
    Frame,
    Furniture,
    Matrix,
    NamedPlace,
    Point,
    Robot,
    Role,
    Source,
    Sync,
)
from cyclekit.config.toml_file import list_at, read_toml
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.storage.files import resolved

if TYPE_CHECKING:
    from pathlib import Path

_LARGEST = 1e15
"""No number of a cell is larger; NaN and infinity are not either."""
_FASTEST_HZ = 1e6


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
        name=_text(where, raw, "name") or resolved(path).parent.name,
        sources=sources,
        ignore=tuple(map(str, list_at(where, raw, "ignore"))),
        reference=tuple(map(str, list_at(where, raw, "reference"))),
        places=_places(f"{where} [places]", raw.get("places", {})),
        all_places_named=_all_named(where, raw),
        human_places=_places(f"{where} [human_places]", raw.get("human_places", {})),
        furniture=_furniture(f"{where} [furniture]", raw.get("furniture", {})),
        executions=_executions(f"{where} [executions]", raw.get("executions", {})),
        rate_hz=_rate(where, raw),
        bridge_s=_number(where, raw, "bridge_s", 0.3),
        levels=_levels(where, raw),
        robot=_robot(f"{where} [robot]", raw["robot"]) if "robot" in raw else None,
    )


def _all_named(where: str, raw: Mapping[str, Any]) -> bool:
    told = raw.get("all_places_named", False)
    if not isinstance(told, bool):
        raise ConfigError(f"{where}: all_places_named = {told!r} must be true or false", cure="all_places_named = true")
    if told and not raw.get("places"):
        raise ConfigError(f"{where}: all_places_named, and no place is named", cure="Name them: [places.NAME]")
    return told


def _robot(where: str, raw: Mapping[str, Any]) -> Robot:
    _only(where, raw, Robot)
    model, dh = _text(where, raw, "model"), list_at(where, raw, "dh")
    if (model is None) == (not dh):
        raise ConfigError(f"{where}: needs one of model and dh", cure='model = "UR5e"')
    if model is not None and model not in MODELS:
        raise UnknownName(where, "model", model, list(MODELS))
    if not all(isinstance(row, list) and len(row) == 4 and all(map(_is_number, row)) for row in dh):
        cure = "Give d (m), a (m), alpha (deg), theta (deg) of each joint: dh = [[0.34, 0, -90, 0], …]"
        raise ConfigError(f"{where}: dh = {dh!r} are no Denavit-Hartenberg parameters", cure=cure)
    tool = list_at(where, raw, "tool_m") or [0.0, 0.0, 0.0]
    if len(tool) != 3 or not all(map(_is_number, tool)):
        raise ConfigError(f"{where}: tool_m = {tool!r} must be three numbers", cure="tool_m = [0.0, 0.0, 0.15]")
    x, y, z = map(float, tool)
    return Robot(model, tuple((float(d), float(a), float(al), float(th)) for d, a, al, th in dh), (x, y, z))


def _levels(where: str, raw: Mapping[str, Any]) -> tuple[float, ...]:
    levels = list_at(where, raw, "levels")
    rising = all(_is_number(x) and 0 <= x <= 1 for x in levels) and sorted(set(levels)) == levels
    if not rising or len(levels) == 1:
        cure = "Give two or more ascending fractions of full speed: levels = [0.0, 0.5, 1.0]"
        raise ConfigError(f"{where}: levels = {levels!r} are no levels of a speed scaling", cure=cure)
    return tuple(float(x) for x in levels)


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
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST


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


def _rate(where: str, raw: Mapping[str, Any]) -> float:
    rate_hz = _positive(where, raw, "rate_hz", 10.0)
    if rate_hz > _FASTEST_HZ:
        raise ConfigError(f"{where}: rate_hz = {rate_hz:g} is no rate of samples", cure="rate_hz = 10")
    return rate_hz


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
    begin, signal = raw.get("begin", "auto"), _text(where, raw, "signal")
    if (begin == "signal") != (signal is not None):
        raise ConfigError(f'{where}: begin = "signal" and signal = "…" go together', cure='signal = "cycle_start=1"')
    return Executions(begin, _positive(where, raw, "gap_s", 2.0), _text(where, raw, "home"), bit, signal)


def _source(where: str, entry: Mapping[str, Any]) -> Source:
    _only(where, entry, Source)
    role = entry.get("role")
    if role not in (None, *get_args(Role)):
        raise UnknownName(where, "role", str(role), get_args(Role))
    if entry.get("sees") not in (None, "tcp"):
        raise UnknownName(where, "value of sees", str(entry["sees"]), ["tcp"])
    if entry.get("silence") not in (None, "absent", "unknown"):
        raise UnknownName(where, "value of silence", str(entry["silence"]), ["absent", "unknown"])
    _one_clock(where, entry)
    return Source(
        path=_text(where, entry, "path") or "",
        adapter=_text(where, entry, "adapter"),
        role=role,
        clock_offset_s=_number(where, entry, "clock_offset_s", 0.0) if "clock_offset_s" in entry else None,
        clock_rate=_positive(where, entry, "clock_rate", 1.0),
        sync=_sync(f"{where} sync", entry["sync"]) if "sync" in entry else None,
        sync_events=_pairs(where, entry),
        sees=entry.get("sees"),
        sees_as=_text(where, entry, "sees_as"),
        same_clock_as=_text(where, entry, "same_clock_as"),
        start=_start(where, entry),
        frame=_frame(f"{where} frame", entry["frame"]) if "frame" in entry else None,
        body=_text(where, entry, "body"),
        silence=entry.get("silence"),
        rate_hz=_positive(where, entry, "rate_hz", 100.0) if "rate_hz" in entry else None,
        map=_map(f"{where} map", entry.get("map", {})),
    )


def _map(where: str, raw: object) -> dict[str, object]:
    """Return what adapters are told; all of it can be kept as JSON."""
    found = dict(_table(where, raw))
    waiting: list[tuple[str, object]] = list(found.items())
    while waiting:
        key, value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [(f"{key}.{name}", inner) for name, inner in value.items()]
        elif isinstance(value, list):
            waiting += [(key, inner) for inner in value]
        elif not isinstance(value, str | bool) and not _is_number(value):
            cure = f'Put it into quotes: {key} = "{value}"'
            raise ConfigError(f"{where}: {key} = {value} is neither a text nor a finite number", cure=cure)
    return found


def _one_clock(where: str, entry: Mapping[str, Any]) -> None:
    said = [key for key in CLOCK_KEYS if key in entry and entry[key] != []]
    if len(said) > 1:
        raise ConfigError(f"{where}: both {said[0]} and {said[1]} say how its clock runs", cure="Keep one of them.")
    if "clock_rate" in entry and said and "clock_offset_s" not in entry:
        raise ConfigError(f"{where}: clock_rate beside {said[0]}, which finds it", cure="Remove clock_rate.")
    if "sees_as" in entry and "sees" not in entry:
        raise ConfigError(f"{where}: sees_as without sees", cure='Add sees = "tcp".')


def _sync(where: str, raw: object) -> Sync:
    raw = _table(where, raw)
    _only(where, raw, Sync)
    robot, other = _text(where, raw, "robot"), _text(where, raw, "other")
    return Sync(robot or "", other or "")


def _pairs(where: str, entry: Mapping[str, Any]) -> tuple[tuple[float, float], ...]:
    pairs = list_at(where, entry, "sync_events")
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or not all(map(_is_number, pair)):
            cure = "Give [this log's time, the robot log's time], seconds."
            raise ConfigError(f"{where}: sync_events has {pair!r}", cure=cure)
    return tuple((float(mine), float(robots)) for mine, robots in pairs)


def _start(where: str, entry: Mapping[str, Any]) -> str | None:
    value = entry.get("start")
    if value is None:
        return None
    try:
        when = value if isinstance(value, datetime) else datetime.fromisoformat(value)
    except (TypeError, ValueError):
        when = None
    if when is None or when.tzinfo is None:
        cure = 'Write it with its time zone: start = "2026-03-02T14:03:11+01:00"'
        raise ConfigError(f"{where}: start = {value!r} is no instant", cure=cure)
    return when.isoformat()


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


def _furniture(where: str, raw: object) -> dict[str, Furniture]:
    found = {}
    for name, entry in _table(where, raw).items():
        here = f"{where[:-1]}.{name}]"
        _only(here, entry, Furniture)
        size = _point(f"{here} size_m", entry["size_m"])
        if min(size) <= 0:
            raise ConfigError(f"{here}: size_m = {list(size)} has no extent", cure="size_m = [length, width, height]")
        found[name] = Furniture(_point(f"{here} xyz_m", entry["xyz_m"]), size, _number(here, entry, "yaw_deg", 0.0))
    return found
