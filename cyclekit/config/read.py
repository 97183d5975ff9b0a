"""Read a cell file into a `Cell`; every value is checked, and every error names file, key and cure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

from cyclekit.config.arms import MODELS
from cyclekit.config.cells import CLOCK_KEYS, Cell, Executions, Frame, Matrix, Number, Point, Robot, Wait
from cyclekit.config.toml_file import read_toml, refuse_twice, require_list, require_table, to_dataclass
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.storage.files import resolved

if TYPE_CHECKING:
    from pathlib import Path

_LARGEST = 1e15


@dataclass(frozen=True)
class _Frame:
    """A frame as written in the file."""

    xyz_m: Point = (0.0, 0.0, 0.0)
    yaw_deg: Number | None = None
    rotation: Matrix | None = None


def load_cell(path: Path) -> Cell:
    """Read a cell file.

    Raises:
        ConfigError: The file cannot be read, or a value is of the wrong type.
        UnknownName: A key is unknown.
    """
    raw, where = read_toml(path), str(path)
    entries = require_list(where, raw, "sources")
    sources = [_source(f"{where} sources[{i}]", entry) for i, entry in enumerate(entries)]
    told = [_operator_signal(entry) for entry in require_list(where, raw, "operator_signals")]
    cell = to_dataclass(where, {**raw, "sources": sources, "operator_signals": told}, Cell)
    refuse_twice(where, "operator signal", [one.name for one in cell.operator_signals])
    if cell.all_places_named and not cell.places:
        raise ConfigError(f"{where}: all_places_named = true, but no place is named", cure="Name them: [places.NAME]")
    _check_levels(where, cell)
    _check_executions(f"{where} executions", cell.executions)
    for number, wait in enumerate(cell.waits):
        _check_wait(f"{where} waits[{number}]", wait)
    if cell.robot is not None:
        _check_robot(f"{where} robot", cell.robot)
    return cell if raw.get("name") else replace(cell, name=resolved(path).parent.name)


def _check_levels(where: str, cell: Cell) -> None:
    if len(cell.levels) == 1 or list(cell.levels) != sorted(set(cell.levels)):
        cure = "Give two or more ascending fractions of full speed: levels = [0.0, 0.5, 1.0]"
        raise ConfigError(f"{where}: levels = {list(cell.levels)} are not levels of a speed scaling", cure=cure)


def _check_executions(where: str, executions: Executions) -> None:
    if (executions.begin == "signal") != (executions.signal is not None):
        raise ConfigError(f'{where}: begin = "signal" and signal = "…" go together', cure='signal = "cycle_start=1"')


def _check_wait(where: str, wait: Wait) -> None:
    what = [key for key in ("before", "leaving", "spot", "task") if getattr(wait, key) is not None]
    if len(what) != 1:
        raise ConfigError(f"{where}: needs one of before, leaving, spot and task", cure='before = "fixture"')
    if what[0] in ("spot", "task"):
        if not wait.never or wait.back is not None:
            msg = f"{where}: {what[0]} tells only that nobody waits there, or for that, in any passage"
            raise ConfigError(msg, cure="Add never = true and leave out back.")
        if wait.spot is not None and (wait.agent != "operator" or wait.until is not None):
            cure = 'Leave out until, and write agent = "operator".'
            raise ConfigError(f"{where}: spot = {wait.spot!r} tells that the operator works there", cure=cure)
        return
    if wait.until is None and not wait.never:
        raise ConfigError(f"{where}: no until: what does it wait for?", cure='until = "operator leaves fixture"')
    if wait.event is not None and not wait.event[0]:
        cure = 'Write "operator leaves PLACE", "robot arrives PLACE", "SIGNAL set" or "SIGNAL cleared".'
        raise ConfigError(f"{where}: until = {wait.until!r} is not an event", cure=cure)
    if wait.event is not None and wait.event[0] == wait.agent:
        raise ConfigError(f"{where}: {wait.agent} waits for itself", cure="Name what the other agent or a signal does.")


def _check_robot(where: str, robot: Robot) -> None:
    if (robot.model is None) == (not robot.dh):
        raise ConfigError(f"{where}: needs one of model and dh", cure='model = "UR5e"')
    if robot.model is not None and robot.model not in MODELS:
        raise UnknownName(where, "model", robot.model, list(MODELS))


def _source(where: str, entry: object) -> dict[str, object]:
    """Return a source's keys, with start and frame converted for `Source`."""
    found = dict(require_table(where, entry))
    _one_clock(where, found)
    if "start" in found:
        found["start"] = _start(where, found["start"])
    if "frame" in found:
        found["frame"] = _frame(f"{where} frame", found["frame"])
    if "map" in found:
        found["map"] = _map(f"{where} map", found["map"])
    if "activities" in found:
        found["activities"] = [_activity(entry) for entry in require_list(where, found, "activities")]
    return found


def _activity(entry: object) -> object:
    """Return its keys with a single column or idle state as a list."""
    if not isinstance(entry, Mapping):
        return entry
    return {**entry, **{key: [entry[key]] for key in ("column", "idle") if isinstance(entry.get(key), str)}}


def _operator_signal(entry: object) -> object:
    """Return its keys with values of signals as text, as a bit may be written as a number or a boolean."""
    if not isinstance(entry, Mapping):
        return entry
    numbers = {key: str(int(entry[key])) for key in ("occupied", "reset_at") if isinstance(entry.get(key), int)}
    return {**entry, **numbers}


def _map(where: str, raw: object) -> dict[str, object]:
    """Return the settings of the adapter; all of them can be stored as JSON."""
    found = dict(require_table(where, raw))
    waiting: list[tuple[str, object]] = list(found.items())
    while waiting:
        key, value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [(f"{key}.{name}", inner) for name, inner in value.items()]
        elif isinstance(value, list):
            waiting += [(key, inner) for inner in value]
        elif not isinstance(value, str | bool) and not _is_finite(value):
            cure = f'Put it into quotes: {key} = "{value}"'
            raise ConfigError(f"{where}: {key} = {value} is neither a text nor a finite number", cure=cure)
    return found


def _one_clock(where: str, entry: Mapping[str, Any]) -> None:
    said = [key for key in CLOCK_KEYS if key in entry and entry[key] != []]
    if len(said) > 1:
        raise ConfigError(f"{where}: both {said[0]} and {said[1]} set how its clock runs", cure="Keep one of them.")
    if "clock_rate" in entry and said and "clock_offset_s" not in entry:
        raise ConfigError(f"{where}: clock_rate with {said[0]}, which sets it", cure="Remove clock_rate.")
    if "sees_as" in entry and "sees" not in entry:
        raise ConfigError(f"{where}: sees_as without sees", cure='Add sees = "tcp".')


def _start(where: str, value: object) -> str:
    try:
        when = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    except ValueError:
        when = None
    if when is None or when.tzinfo is None:
        cure = 'Write it with its time zone: start = "2026-03-02T14:03:11+01:00"'
        raise ConfigError(f"{where}: start = {value!r} is not a timestamp with a time zone", cure=cure)
    return when.isoformat()


def _frame(where: str, raw: object) -> Frame:
    told = to_dataclass(where, raw, _Frame)
    if told.rotation is None:
        yaw = math.radians(told.yaw_deg or 0.0)
        c, s = math.cos(yaw), math.sin(yaw)
        return Frame(told.xyz_m, ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    if told.yaw_deg is not None:
        raise ConfigError(f"{where}: both yaw_deg and rotation", cure="Keep one of them.")
    if not _orthonormal(told.rotation):
        raise ConfigError(f"{where}: rotation is not a rotation matrix", cure="Give three orthonormal rows, det +1.")
    return Frame(told.xyz_m, told.rotation)


def _orthonormal(rows: Matrix) -> bool:
    a, b, c = rows
    dots = [sum(x * y for x, y in zip(p, q, strict=True)) for p in rows for q in rows]
    wanted = [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]
    cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    right_handed = sum(x * y for x, y in zip(cross, c, strict=True)) > 0
    return right_handed and all(abs(x - y) < 1e-3 for x, y in zip(dots, wanted, strict=True))


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= _LARGEST
