"""Columns of states in a table without positions: what a PLC logs, bits, step numbers and words.

Which of them are tasks of whom is decided where logs are read, as it shows over a whole log only.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit_adapters.mapped.draft_names import Name
    from cyclekit_adapters.mapped.draft_table import DraftTable

_MOST_STATES = 100
"""A size: more different values in the first rows are no states. Half or twice of it moves no draft in the tests."""
_AGAIN = 3
"""Statistical: states come again; how often each has, on average, in the first rows. 2 and 6 move no draft."""
_FIELDS = 2
"""A size: that many bits may be the fields of a scanner. 1 moves no draft of the tests, 4 that of a column of words."""
_STATES = {
    "step",
    "schritt",
    "schrittnr",
    "schrittnummer",
    "state",
    "zustand",
    "status",
    "phase",
    "station",
    "position",
}
_PERCENT = {"override", "ovr", "percent", "prozent", "speed", "geschwindigkeit", "scaling"}


def state_columns(table: DraftTable, names: Mapping[str, Name], rest: Sequence[str]) -> list[str]:
    """Return the columns that hold states, and those of an override; none where they cannot tell who is where.

    A bit or two beside an override are fields that slow a robot; more, or three states of one column, may be stations.

    Args:
        table: The table.
        names: Its parsed column names.
        rest: Columns that are no time.
    """
    found = [name for name in rest if _holds_states(table.cells[name]) or names[name].says(_PERCENT)]
    again = [name for name in found if not names[name].says(_PERCENT) and _comes_again(table.cells[name], names[name])]
    bits = [name for name in again if len({cell.strip() for cell in table.cells[name]} - {""}) == 2]
    return found if len(bits) > _FIELDS or len(again) > len(bits) else []


def is_trace(table: DraftTable) -> bool:
    """Return whether a table has a column for each signal: more of two states than an export of events has."""
    states = [{cell.strip().lower() for cell in cells} - {""} for cells in table.cells.values()]
    return sum(some in ({"0", "1"}, {"true", "false"}) for some in states) > _FIELDS


def _holds_states(cells: Sequence[str]) -> bool:
    """Return whether cells are few words or whole numbers."""
    states = {cell.strip() for cell in cells} - {""}
    return 0 < len(states) <= _MOST_STATES and not any(re.search(r"\d[.,]\d*[1-9]", state) for state in states)


def _comes_again(cells: Sequence[str], name: Name) -> bool:
    known = [cell.strip() for cell in cells if cell.strip()]
    changes = sum(one != other for one, other in pairwise(known))
    count = len(set(known))
    return count > 1 and (changes >= _AGAIN * count or name.says(_STATES) or (count == 2 and changes > 1))
