"""Columns of a safety system's log: time, override, distance, its standard deviation, and execution.

Such a log has no other columns. A table that also holds positions or joints is a robot log, which needs a map in the
cell file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, LogError, UnknownName, nearest
from cyclekit_adapters.tasks.event_table import TIME_NAMES, stem_of
from cyclekit_adapters.tasks.task_columns import NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

WHERE = "[sources.map] of a safety log"
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_OVERRIDE = re.compile(r"ovr|override")
_DISTANCE = re.compile(r"dist(?:ance|_|$|[cm]?m$|mean|min|\d)|separation")
_DEVIATION = re.compile(r"(?:std|sd|stddev|deviation|sigma)$")
_INDEX = {"index", "idx", "row", "seq", "unnamed0"}
_LENGTH = re.compile(r"[ _.\[(](m|cm|mm)[\])]?$")
_KEYS = ("time", "override", "distance", "deviation", "execution")


@dataclass(frozen=True)
class SafetyColumns:
    """Column names of a safety system's log.

    Attributes:
        time: Time.
        overrides: Columns whose product is the override.
        distance: Distance between robot and person; `deviation`: its standard deviation.
        metres: Unit of length, m.
        execution: Name of the execution.
    """

    time: str
    overrides: tuple[str, ...] = ()
    distance: str | None = None
    deviation: str | None = None
    metres: float = 1.0
    execution: str | None = None


def is_safety_log(file: str, names: Sequence[str]) -> bool:
    """Return whether a table with these columns is a safety system's log."""
    return safety_columns(file, names) is not None


def safety_columns(file: str, names: Sequence[str]) -> SafetyColumns | None:
    """Return the columns of a safety system's log; None if the table is something else.

    Args:
        file: File name; for a table of `Mean` and `Std`, only this shows that they refer to a distance.
        names: Column names.
    """
    stems = {name: _stem(name) for name in names}
    times = [name for name, stem in stems.items() if stem in TIME_NAMES]
    rest = {name: stem for name, stem in stems.items() if name not in times and not _is_index(name, stem)}
    deviations = [name for name, stem in rest.items() if _DEVIATION.search(stem)]
    executions = [name for name, stem in rest.items() if stem in NAMES["execution"]]
    values = {name: stem for name, stem in rest.items() if name not in (*deviations, *executions)}
    overrides = [name for name, stem in values.items() if _OVERRIDE.search(stem)]
    distances = [name for name, stem in values.items() if _DISTANCE.search(stem) and name not in overrides]
    if not distances and set(values.values()) - {values[name] for name in overrides} == {"mean"}:
        distances = [name for name, stem in values.items() if stem == "mean"] if _DISTANCE.search(file.lower()) else []
    known = len(overrides) + len(distances)
    if len(times) != 1 or not known or known != len(values) or len(distances) > 1 or len(executions) > 1:
        return None
    if len(deviations) > len(distances):
        return None
    return SafetyColumns(
        times[0],
        tuple(overrides),
        next(iter(distances), None),
        next(iter(deviations), None),
        _metres(distances),
        next(iter(executions), None),
    )


def _is_index(name: str, stem: str) -> bool:
    return stem in _INDEX or name.startswith("#")  # a column without a name


def _stem(name: str) -> str:
    return stem_of(name, TIME_NAMES)


def _metres(distances: Sequence[str]) -> float:
    found = next((match[1] for name in distances if (match := _LENGTH.search(name.lower()))), "m")
    return LENGTHS[found]


def mapped_columns(path: Path, names: Sequence[str], entries: Mapping[str, object]) -> SafetyColumns:
    """Return the columns from the cell file, and the others from their names.

    Raises:
        ConfigError: A key is unknown, or is not a text.
        LogError: A column is missing, or there is neither an override nor a distance.
    """
    for key, value in entries.items():
        if key not in (*_KEYS, "length_unit"):
            raise UnknownName(WHERE, "key", key, [*_KEYS, "length_unit", "override_max", "time_unit", "time_zone"])
        if not isinstance(value, str):
            raise ConfigError(f"{WHERE}: {key} = {value!r} is not a text", cure=f'{key} = "NAME"')
        if key in _KEYS and value not in names:
            cause = f"no column {value!r}, which [sources.map] names for {key}"
            raise LogError(path, cause, nearest=nearest(value, names), cure=f"It has: {', '.join(names[:40])}.")
    unit = str(entries.get("length_unit", "m"))
    if unit not in LENGTHS:
        raise UnknownName(WHERE, "length_unit", unit, LENGTHS)
    found = safety_columns(path.name, names)
    given = {key: str(entries[key]) for key in _KEYS if key in entries}
    time = given.get("time") or (found.time if found else _time_in(names))
    if time is None or (found is None and not {"override", "distance"} & given.keys()):
        cause = f"no columns for a time and for an override or a distance among {', '.join(names[:40])}"
        raise LogError(path, cause, cure='Name them in [sources.map]: time = "COLUMN", override = "COLUMN"')
    if found is None or {"override", "distance"} & given.keys():
        overrides = (given["override"],) if "override" in given else ()
        distance = given.get("distance")
        found = SafetyColumns(time, overrides, distance, metres=_metres([distance] if distance else []))
    metres = LENGTHS[unit] if "length_unit" in entries else found.metres
    deviation, execution = given.get("deviation", found.deviation), given.get("execution", found.execution)
    return replace(found, time=time, deviation=deviation, execution=execution, metres=metres)


def _time_in(names: Sequence[str]) -> str | None:
    return next((name for name in names if _stem(name) in TIME_NAMES), None)
