"""Change times of a recording's signals: outputs and the register of a robot log, named events of other logs.

Robot logs are read in parts, since they may be larger than memory; events are few. `alignment` uses these times.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.errors import ConfigError, UnknownName

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards import LogCard
    from cyclekit.schema import Bools, Ints, Vector
    from cyclekit.storage.parquet import StoredTable

    Read = Callable[[str, str], pl.DataFrame | None]
    Stored = Callable[[str, Sequence[str]], StoredTable]

INPUT, OUTPUT, REGISTER = "digital-input ", "digital-output ", "register"
_BITS = {"digital_in_bits": INPUT, "digital_out_bits": OUTPUT}
_ON = {"1", "1.0", "true", "on", "high", "ein"}
_OFF = {"0", "0.0", "false", "off", "low", "aus"}
_SAMPLED_S = 0.1
"""Maximum time between two rows, s, for which a change counts at their middle; else at the later row."""
MAX_CHANGES = 100_000
"""Maximum number of changes of a signal per recording; more frequent ones are counters or measurements."""


class SignalChanges(NamedTuple):
    """Change times of a signal, s, ascending, and the value from each on; shape (M,) each."""

    t_s: Vector
    value: NDArray[np.str_]

    def at(self, t_s: Vector) -> NDArray[np.str_]:
        """Return the values at some times, shape (N,); empty before the first change."""
        return np.append("", self.value)[np.searchsorted(self.t_s, t_s, side="right")]

    def to(self, value: str) -> Vector:
        """Return the times of changes to a value, shape (K,), s; the initial value is not a change."""
        return np.asarray(self.t_s[1:][(self.value[1:] == value) & (self.value[:-1] != value)])


def state_of(value: str) -> str:
    """Return 1 or 0 for words of on and off, as digital inputs have them; any other value unchanged."""
    word = value.lower()
    return "1" if word in _ON else "0" if word in _OFF else value


MAX_VALUES = 8
"""Maximum number of values of an event; signals with more are measurements or names."""


def event_times(entry: LogCard, signal: str, read: Read, stored: Stored, where: str = "sync") -> Vector:
    """Return the change times of a signal, clock of the log, shape (N,), s; for on/off signals, the rising edges.

    Args:
        entry: The recording.
        signal: `digital-output 3`, `register`, the name of an event; or `register=100` or `name=value` for changes to
            that value only.
        read: Returns a native table of a recording (id, table), None if there is none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
        where: Part of the cell file that names the signal, for messages.

    Raises:
        ConfigError: The recording has no such signal.
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
    """Return the change times of each signal of a recording, both edges, clock of the log, shape (N,), ascending, s.

    Signals are its digital outputs (bit by bit), its register and its events; those that never change, or more than
    MAX_CHANGES times, are left out.

    Args:
        entry: The recording.
        read: Returns a native table of a recording (id, table), None if there is none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
    """
    found: dict[str, Vector] = {}
    for column, changes in _columns(entry, ("digital_out_bits", REGISTER), stored):
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
    return {name: times for name, times in found.items() if 0 < len(times) <= MAX_CHANGES}


def values_of(entry: LogCard, read: Read, stored: Stored) -> dict[str, SignalChanges]:
    """Return the values over time of inputs, outputs and events of a recording, clock of the log.

    Args:
        entry: The recording.
        read: Returns a native table of a recording (id, table), None if there is none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.

    Returns:
        By name: each bit that changes, the register, and events with at most MAX_VALUES values, with words of on and
        off as 1 and 0. Signals that change more than MAX_CHANGES times are left out.
    """
    found = logged_bits(entry, stored, (*_BITS, REGISTER))
    events = read(entry.id, "events") if "events" in entry.tables else None
    known = pl.DataFrame() if events is None else events.drop_nulls(["t_s", "value"]).sort("t_s")
    for (name,), mine in known.group_by("signal", maintain_order=True) if known.height else ():
        if mine["value"].n_unique() <= MAX_VALUES and mine.height <= MAX_CHANGES:
            words = {value: state_of(value) for value in mine["value"].unique().to_list()}
            values = mine["value"].replace_strict(words, return_dtype=pl.String).to_numpy().astype(str)
            found[str(name)] = SignalChanges(mine["t_s"].to_numpy(), values)
    return found


def logged_bits(entry: LogCard, stored: Stored, columns: Sequence[str] = tuple(_BITS)) -> dict[str, SignalChanges]:
    """Return the values over time of inputs and outputs, and of the register if requested; see `values_of`."""
    found: dict[str, SignalChanges] = {}
    first_s = stored(entry.id, ["t_s"]).column("t_s", 0, 1) if entry.rows.get("robot") else np.empty(0)
    for column, (_, later, old, new) in _columns(entry, columns, stored):
        at = np.maximum.accumulate(later)  # a clock may have been set back by a fraction of a second
        if column == REGISTER:
            found[REGISTER] = SignalChanges(np.append(first_s, at), np.append(old[:1], new).astype(str))
            continue
        for bit in range(63):
            flips = ((old ^ new) >> bit) & 1 == 1
            if flips.any():
                values = np.append(old[flips][:1], new[flips])
                told = ((values >> bit) & 1).astype(str)
                found[f"{_BITS[column]}{bit}"] = SignalChanges(np.append(first_s, at[flips]), told)
    return found


def constant_bits(entry: LogCard, stored: Stored, names: Collection[str]) -> dict[str, SignalChanges]:
    """Return those of the named inputs and outputs that are logged but never change, with their value.

    `logged_bits` leaves them out: most bits of a controller never change, and only a comparison of recordings shows
    that a bit changes in another one.
    """
    found: dict[str, SignalChanges] = {}
    columns = [column for column, prefix in _BITS.items() if any(name.startswith(prefix) for name in names)]
    for column, (_, _, old, new) in _columns(entry, columns, stored):
        table = stored(entry.id, ["t_s", column])
        first, changed = _first(table, column), int(np.bitwise_or.reduce(old ^ new, initial=0))
        first_s = table.column("t_s", 0, 1)
        for bit in range(63):
            if (name := f"{_BITS[column]}{bit}") in names and not changed >> bit & 1:
                found[name] = SignalChanges(first_s, np.array([str(first >> bit & 1)]))
    return found


def _first(table: StoredTable, column: str) -> int:
    """Return the first known value of a column of whole numbers with at least one known value."""
    of_each = (table.whole_numbers(number, column) for number in range(len(table.groups)))
    return next(int(values[known][0]) for values, known in of_each if known.any())


def _columns(
    entry: LogCard, columns: Sequence[str], stored: Stored
) -> Iterator[tuple[str, tuple[Vector, Vector, Ints, Ints]]]:
    """Yield the changes of those columns of a robot log that are known and change at most MAX_CHANGES times."""
    if not entry.rows.get("robot"):
        return
    known = stored(entry.id, ["t_s"]).names
    for column in (column for column in columns if column in known):
        table = stored(entry.id, ["t_s", column])
        if table.unknown(column) < table.rows and (changes := _few(table, column)) is not None:
            yield column, changes


def switches(entry: LogCard, read: Read) -> dict[str, tuple[Vector, Bools]]:
    """Return the two-valued events of a recording: time of each entry, clock of the log, s, and whether it is on.

    Args:
        entry: The recording.
        read: Returns a native table of a recording (id, table), None if there is none.
    """
    events = read(entry.id, "events") if "events" in entry.tables else None
    found = {}
    for (name,), mine in () if events is None else events.sort("t_s").group_by("signal", maintain_order=True):
        values = mine["value"].str.to_lowercase()
        if values.null_count() == 0 and set(values.unique().to_list()) <= _ON | _OFF:
            found[str(name)] = mine["t_s"].to_numpy(), values.is_in(list(_ON)).to_numpy()
    return found


def _few(table: StoredTable, column: str) -> tuple[Vector, Vector, Ints, Ints] | None:
    """Return the changes of a column; None if there are more than MAX_CHANGES."""
    kept, many = [], 0
    for changes in _changes(table, column):
        many += len(changes[0])
        if many > MAX_CHANGES:
            return None
        kept.append(changes)
    before, at, old, new = zip(*kept, strict=True)
    return np.concatenate(before), np.concatenate(at), np.concatenate(old), np.concatenate(new)


def _bit(where: str, signal: str) -> int:
    bit = signal.removeprefix(OUTPUT)
    if not bit.isdigit() or int(bit) > 62:
        raise ConfigError(f"{where}: {signal!r} is not an output", cure=f'Write "{OUTPUT}0" to "{OUTPUT}62".')
    return int(bit)


def _whole(where: str, value: str) -> int:
    if not value.removeprefix("-").isdigit():
        raise ConfigError(f"{where}: {REGISTER} holds whole numbers, not {value!r}", cure=f'Write "{REGISTER}=100".')
    return int(value)


def _of_robot(table: StoredTable, column: str, *, bit: int | None = None, wanted: int | None = None) -> Vector:
    """Return the change times of whole numbers in a robot log, or of one bit of them; of 0 and 1, the rising edges.

    With `wanted`, only changes to that value.
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
        table: A table that includes the times.
        column: Column of whole numbers; rows in which it is unknown are skipped.
        bit: Use only this bit; None = the whole number.
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
    """Return the time of a change between the last row with the old value and the first one with the new value."""
    step = at - before
    return np.asarray(np.where(step <= _SAMPLED_S, at - step / 2, at))


def _of_events(times: Vector, values: pl.Series, wanted: str | None) -> Vector:
    """Return the change times of an event, including its first value; for an on/off event, the rising edges."""
    if len(values) == 0:
        return np.empty(0)
    changed = (values != values.shift(1)).fill_null(value=True)
    if wanted is not None:
        changed &= values == wanted
    elif set(values.str.to_lowercase().unique().to_list()) <= _ON | _OFF:
        changed &= values.str.to_lowercase().is_in(list(_ON))
    return np.asarray(times[changed.to_numpy()])
