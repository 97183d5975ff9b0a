"""What a draft asks about a table in which no name says a quantity of its role, and what it cannot map.

A proposal here is never certain: the columns are alike in number and name, and the user knows what they are.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

from cyclekit_adapters.mapped.draft_names import OTHER, PERSON, TIME_UNITS, Name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit_adapters.mapped.draft_table import DraftTable

_TRANSLATION = {"tx", "ty", "tz"}
"""Torques, or the translation of a pose: a name alone does not tell."""
_LINKS = {"shoulder", "upperarm", "elbow", "forearm", "wrist", "waist", "base", "s", "e", "w", "hip", "knee"}
_SIDES = ("left", "right")
_FEWEST_JOINTS = 4
"""A size: fewer joints are no arm. 2 moves no draft of the tests; 8 loses arms of six joints."""
_AXIS = re.compile(r"(.*?)([xyzXYZ])(.*)")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:['’.,\s]\d{3})+(?:[.,]\d+)?")
_SHOWN = 3


def questions(table: DraftTable, names: Mapping[str, Name], role: str) -> tuple[dict[str, object], str]:
    """Return uncertain keys for a table of which no quantity is known, and why: its position or joints, else a blank.

    Args:
        table: The table.
        names: Its parsed column names.
        role: `robot` or `people`.
    """
    numeric = [name for column, name in names.items() if column in table.numbers and not name.is_set_point]
    if place := _place(numeric):
        return dict(zip("xyz", place, strict=False)), "may be the position: no word in their names says so"
    if role == "robot" and (joints := _joints(numeric)):
        return {"joints": joints}, "may be the joint angles of an arm"
    if role == "robot":
        return {"x": ""}, "no column is known as position, joint angle or speed scaling: name x, y or joints or scaling"
    return {"x": ""}, "no column is known as the position of a person: name x and y"


def _place(numeric: Sequence[Name]) -> list[str]:
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name in numeric:
        if not name.says(OTHER - _TRANSLATION) and (found := _AXIS.fullmatch(name.column)):
            groups.setdefault((found[1], found[3]), {})[found[2].lower()] = name.column
    return next(([axes[axis] for axis in "xyz" if axis in axes] for axes in groups.values() if {*"xy"} <= {*axes}), [])


def _joints(numeric: Sequence[Name]) -> list[str]:
    arms: dict[str, list[str]] = {}
    for name in numeric:
        if name.says(_LINKS) and not name.says(PERSON):
            arms.setdefault(next((side for side in _SIDES if name.says({side})), ""), []).append(name.column)
    return next((columns for columns in arms.values() if len(columns) >= _FEWEST_JOINTS), [])


def without_numbers(table: DraftTable, used: set[str]) -> Iterator[str]:
    """Yield why columns that look like numbers are none, each with its first cell that is none."""
    for name, cells in table.texts.items():
        marked = [cell for cell in cells if _THOUSANDS.fullmatch(cell)]
        if name not in used and 2 * len(marked) > len(cells):
            yield f"{name} holds no numbers that can be read: {marked[0]!r}; export it without marks of thousands"


def of_first_time(table: DraftTable, names: Mapping[str, Name]) -> tuple[DraftTable, list[str]]:
    """Return the columns up to the second time of the same name, if both differ, and a note on those from there on.

    Where each series has its own time, a state of the second would be at a time of the first.
    """
    first: dict[tuple[object, ...], str] = {}
    for at, (column, name) in enumerate(names.items()):
        if not (name.is_time or (name.unit in TIME_UNITS and not name.words)):
            continue
        one = first.setdefault((tuple(word for word in name.words if word != "#"), name.unit), column)
        if table.names.index(one) < at - 1 and table.cells[one] != table.cells[column]:
            kept, rest = table.names[:at], table.names[at + 1 :]
            note = f"of the time {column}: {', '.join(rest)}; to read them, copy the file and add a source for the copy"
            return replace(table, names=kept, cells={key: table.cells[key] for key in kept}), [note] * bool(rest)
    return table, []
