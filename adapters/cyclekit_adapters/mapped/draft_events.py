"""Draft of a map for an export of events: a row per change, with time, device, event and state.

Safety controllers and scanners write such exports, each in its own layout. What tells them from other tables is that
each row differs in its state from the one before it of the same signal.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from cyclekit.adapter import Draft, Proposal
from cyclekit.text.numbers import fixed
from cyclekit_adapters.mapped.csv_map import SIGNAL_JOIN
from cyclekit_adapters.mapped.draft_names import name_of
from cyclekit_adapters.mapped.draft_times import found_times
from cyclekit_adapters.times.proof import TimeEvidence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit_adapters.mapped.draft_table import DraftTable

_MIN_ROWS, _MIN_SHARE = 10, 0.7
"""Minimum number of rows; minimum share of rows that differ from the one before."""
_MAX_STATES, _MAX_SIGNALS = 8, 100
_SAME = 0.02
"""A column is part of a signal's name if that share does not fall by more."""
_LISTED = 12
_VALUES = {"state", "status", "value", "val", "new", "zustand", "wert", "neu", "stato", "valore"}


def event_draft(table: DraftTable) -> Draft | None:
    """Return a proposed map for an export of events; None if the table is none."""
    by_blanks = table.keys.get("delimiter") == "whitespace"
    if not table.headed or by_blanks or len(table.names) < 3 or len(table.cells[table.names[0]]) < _MIN_ROWS:
        return None
    times = found_times(table, {name: name_of(name) for name in table.names}, TimeEvidence(before_s=table.before_s))
    if not times:
        return None
    others = [name for name in table.names if name not in times[0].columns and any(table.cells[name])]
    able = [found for value in others if (found := _signals(table, value, others))[0] >= _MIN_SHARE]
    if not able:
        return None
    share, signal, value = max(able, key=lambda found: (name_of(found[2]).says(_VALUES), found[0]))
    lines = [Proposal(key, value) for key, value in table.keys.items()]
    keys, sure, notes = times[0].keys()
    last = list(keys)[-1]
    lines += [Proposal(key, value, times[0].comment if key == last else "", sure) for key, value in keys.items()]
    lines.append(Proposal("signal", signal[0] if len(signal) == 1 else list(signal)))
    why = f"{fixed(100 * share, 0)} % of the rows differ from the one before of the same signal: a row per change"
    lines.append(Proposal("value", value, why))
    states: dict[str, set[str]] = {}
    for name, state in zip(_names(table, signal), table.cells[value], strict=True):
        states.setdefault(name, set()).add(state)
    shown = [f"{name} ({', '.join(sorted(mine))})" for name, mine in states.items()]
    notes.append(f"signals: {'; '.join(shown[:_LISTED])}{'; ...' if len(shown) > _LISTED else ''}")
    return Draft((Proposal("role", "events", "its rows are changes of states"),), tuple(lines), tuple(notes))


def _signals(table: DraftTable, value: str, others: Sequence[str]) -> tuple[float, tuple[str, ...], str]:
    """Return the share of rows that differ in `value` from the one before, and the columns of the signal's name."""
    nothing: tuple[float, tuple[str, ...], str] = (0.0, (), value)
    if not 2 <= len(set(table.cells[value])) <= _MAX_STATES:
        return nothing
    able = [name for name in others if name != value and len(set(table.cells[name])) <= _MAX_SIGNALS]
    share, first = max(((_share(table, value, (name,)), name) for name in able), default=(0.0, ""))
    chosen: tuple[str, ...] = (first,) if first else ()
    for name in able:
        both = tuple(one for one in able if one in (*chosen, name))
        if name in chosen or len(set(_names(table, both))) == len(set(_names(table, chosen))):
            continue
        if (more := _share(table, value, both)) >= share - _SAME:
            share, chosen = more, both
    return (share, chosen, value) if chosen else nothing


def _share(table: DraftTable, value: str, signal: tuple[str, ...]) -> float:
    """Return the share of rows that differ in their state from the one before of the same signal; 0 if few have one."""
    names = _names(table, signal)
    if len(set(names)) > _MAX_SIGNALS or max(Counter(names).values()) < _MIN_ROWS // 2:
        return 0.0
    last: dict[str, str] = {}
    differ = repeated = 0
    for name, state in zip(names, table.cells[value], strict=True):
        repeated += name in last
        differ += name in last and last[name] != state
        last[name] = state
    return differ / repeated if repeated >= 0.5 * len(names) else 0.0


def _names(table: DraftTable, signal: tuple[str, ...]) -> list[str]:
    return [SIGNAL_JOIN.join(cells) for cells in zip(*(table.cells[name] for name in signal), strict=True)]
