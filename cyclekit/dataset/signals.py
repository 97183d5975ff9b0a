"""When a signal of a recording changes: an output or the register of a robot log, a named event of any other.

Robot logs are read part by part, since they may be larger than memory; events are few. What is aligned by these times
is the business of `align`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import ConfigError, UnknownName

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cyclekit.dataset.cards import LogCard
    from cyclekit.schema import Bools, Ints, Vector
    from cyclekit.storage.parquet import StoredTable

    Read = Callable[[str, str], pl.DataFrame | None]
    Stored = Callable[[str, Sequence[str]], StoredTable]

OUTPUT, REGISTER = "digital-output ", "register"
_ON = {"1", "1.0", "true", "on", "high"}
_OFF = {"0", "0.0", "false", "off", "low"}
_SAMPLED_S = 0.1
"""A change between rows that lie nearer than this is in the middle of them, else at the later one."""
MOST_CHANGES = 100_000
"""A signal that changes more often in one recording counts or measures, and says nothing of a program's steps."""


def event_times(entry: LogCard, signal: str, read: Read, stored: Stored, where: str = "sync") -> Vector:
    """Return when a signal of a recording changes, its own clock, shape (N,), s; on/off signals when they rise.

    Args:
        entry: The recording.
        signal: `digital-output 3`, `register`, the name of an event; or `register=100` or `name=value` for changes to
            that value alone.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
        where: What of the cell file asks for it.

    Raises:
        ConfigError: There is no such signal in it.
    """
    name, _, value = signal.partition("=")
    if "robot" in entry.tables and name.startswith(OUTPUT):
        return _of_robot(stored(entry.id, ["t_s"]), "digital_out_bits", bit=_bit(where, name))
    if "robot" in entry.tables and name == REGISTER:
        return _of_robot(stored(entry.id, ["t_s"]), REGISTER, wanted=_whole(where, value) if value else None)
    events = read(entry.id, "events")
    if events is None:
        cure = "Put sync at the log that holds the events, and same_clock_as at this one."
        raise ConfigError(f"{where}: {signal!r} is an event, and {entry.id} holds none", cure=cure)
    if name not in (known := events["signal"].unique().to_list()):
        raise UnknownName(where, "signal", name, [*known, f"{OUTPUT}0", REGISTER])
    mine = events.filter((pl.col("signal") == name) & pl.col("value").is_not_null()).sort("t_s")
    return _of_events(mine["t_s"].to_numpy(), mine["value"], value or None)


def every_change(entry: LogCard, read: Read, stored: Stored) -> dict[str, Vector]:
    """Return when each signal of a recording changes, either way, its own clock, shape (N,), ascending, s.

    Those are its digital outputs, each bit by itself, its register and its events; not those that never change or
    more than MOST_CHANGES times.

    Args:
        entry: The recording.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
    """
    found: dict[str, Vector] = {}
    for column in ("digital_out_bits", REGISTER) if entry.rows.get("robot") else ():
        table = stored(entry.id, ["t_s", column])
        if table.unknown(column) == table.rows or (changes := _few(table, column)) is None:
            continue
        at, differ = _between(*changes[:2]), changes[2] ^ changes[3]
        if column == REGISTER:
            found[REGISTER] = at
        else:
            bits = ((bit, (differ >> bit) & 1 == 1) for bit in range(63))
            found |= {f"{OUTPUT}{bit}": at[flips] for bit, flips in bits if flips.any()}
    events = read(entry.id, "events") if "events" in entry.tables else None
    for (name,), mine in () if events is None else events.sort("t_s").group_by("signal", maintain_order=True):
        changed = (mine["value"] != mine["value"].shift(1)).fill_null(value=True)
        found[str(name)] = mine["t_s"].filter(changed).to_numpy()
    return {name: times for name, times in found.items() if 0 < len(times) <= MOST_CHANGES}


def switches(entry: LogCard, read: Read) -> dict[str, tuple[Vector, Bools]]:
    """Return the events of a recording that have two states: when each is told, its own clock, s, and whether it is on.

    Args:
        entry: The recording.
        read: Returns a native table of a recording (id, table), None if it has none.
    """
    events = read(entry.id, "events") if "events" in entry.tables else None
    found = {}
    for (name,), mine in () if events is None else events.sort("t_s").group_by("signal", maintain_order=True):
        values = mine["value"].str.to_lowercase()
        if values.null_count() == 0 and set(values.unique().to_list()) <= _ON | _OFF:
            found[str(name)] = mine["t_s"].to_numpy(), values.is_in(list(_ON)).to_numpy()
    return found


def _few(table: StoredTable, column: str) -> tuple[Vector, Vector, Ints, Ints] | None:
    """Return the changes of a column, None if there are more than MOST_CHANGES."""
    kept, many = [], 0
    for changes in _changes(table, column):
        many += len(changes[0])
        if many > MOST_CHANGES:
            return None
        kept.append(changes)
    before, at, old, new = zip(*kept, strict=True)
    return np.concatenate(before), np.concatenate(at), np.concatenate(old), np.concatenate(new)


def _bit(where: str, signal: str) -> int:
    bit = signal.removeprefix(OUTPUT)
    if not bit.isdigit() or int(bit) > 62:
        raise ConfigError(f"{where}: {signal!r} is no output", cure=f'Write "{OUTPUT}0" to "{OUTPUT}62".')
    return int(bit)


def _whole(where: str, value: str) -> int:
    if not value.removeprefix("-").isdigit():
        raise ConfigError(f"{where}: {REGISTER} holds whole numbers, not {value!r}", cure=f'Write "{REGISTER}=100".')
    return int(value)


def _of_robot(table: StoredTable, column: str, *, bit: int | None = None, wanted: int | None = None) -> Vector:
    """Return when whole numbers of a robot log change, or one bit of them; where they are 0 and 1, when they rise.

    With `wanted`, when they change to that.
    """
    befores, ats, values = [np.empty(0)], [np.empty(0)], [np.empty(0, np.int64)]
    seen = set[int]()
    for before, at, old, new in _changes(table, column, bit):
        befores.append(before)
        ats.append(at)
        values.append(new)
        seen.update(old.tolist(), new.tolist())
    before, at, value = np.concatenate(befores), np.concatenate(ats), np.concatenate(values)
    if wanted is not None or seen <= {0, 1}:
        to = value == (1 if wanted is None else wanted)
        before, at = before[to], at[to]
    return _between(before, at)


def _changes(table: StoredTable, column: str, bit: int | None = None) -> Iterator[tuple[Vector, Vector, Ints, Ints]]:
    """Yield, part by part, the changes of whole numbers: times of the rows before and after, values before and after.

    Args:
        table: With its times.
        column: Of whole numbers; rows in which it is unknown are passed over.
        bit: Look at this bit alone.
    """
    last_t, last = np.empty(0), np.empty(0, np.int64)
    for number, (begin, end) in enumerate(table.groups):
        values, known = table.whole_numbers(number, column)
        values = np.concatenate([last, (values if bit is None else (values >> bit) & 1)[known]])
        times = np.concatenate([last_t, table.column("t_s", begin, end)[known]])
        rows = np.flatnonzero(values[1:] != values[:-1]) + 1
        yield times[rows - 1], times[rows], values[rows - 1], values[rows]
        last_t, last = times[-1:], values[-1:]


def _between(before: Vector, at: Vector) -> Vector:
    """Return when a signal changed that was still the old one at `before` and the new one at `at`."""
    step = at - before
    return np.asarray(np.where(step <= _SAMPLED_S, at - step / 2, at))


def _of_events(times: Vector, values: pl.Series, wanted: str | None) -> Vector:
    """Return when the values of an event change, its first one too; of an on/off signal, when it rises."""
    if len(values) == 0:
        return np.empty(0)
    changed = (values != values.shift(1)).fill_null(value=True)
    if wanted is not None:
        changed &= values == wanted
    elif set(values.str.to_lowercase().unique().to_list()) <= _ON | _OFF:
        changed &= values.str.to_lowercase().is_in(list(_ON))
    return np.asarray(times[changed.to_numpy()])
