"""Draft of a map for a table that no adapter knows, from its header and first rows.

Uncertain values are also proposed, marked as unsure and grouped with their columns, because a unit left at its default
may be wrong. `draft_names` interprets names; `draft_columns` and `draft_times` interpret values.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.adapter import Draft, Proposal
from cyclekit.text.numbers import given
from cyclekit_adapters.mapped.chosen_rows import columns_of_several
from cyclekit_adapters.mapped.csv_map import METRES, RADIANS
from cyclekit_adapters.mapped.draft_columns import FoundColumns, joints, person_columns, places, scalings, states
from cyclekit_adapters.mapped.draft_names import PERSON, ROBOT, TRACKER, Name, name_of
from cyclekit_adapters.mapped.draft_questions import of_first_time, questions, without_numbers
from cyclekit_adapters.mapped.draft_states import state_columns
from cyclekit_adapters.mapped.draft_times import counts_rows, found_times, rises
from cyclekit_adapters.times.proof import TimeEvidence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit_adapters.mapped.draft_table import DraftTable

QUANTITIES = {"x", "joints", "scaling"}
"""Keys of which a map of a robot or of people needs one."""
_LISTED = 40
_IN_OUT = {"di", "do", "din", "dout", "in", "out", "io", "input", "inputs", "output", "outputs", "digital", "bit"}
_INPUTS, _OUTPUTS = {"di", "din", "in", "input", "inputs"}, {"do", "dout", "out", "output", "outputs"}
_BESIDE = {"digital", "word", "bits"}


@dataclass
class _Lines:
    """Lines of a draft so far, and the columns that they use."""

    source: list[Proposal] = field(default_factory=list)
    map: list[Proposal] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    def add(self, values: dict[str, object], why: str = "", *, sure: bool = True) -> None:
        """Add related keys; the comment `why` goes to the last one."""
        last = list(values)[-1]
        for key, value in values.items():
            self.map.append(Proposal(key, value, why if key == last else "", sure))
            self.used |= {value} if isinstance(value, str) else set(value) if isinstance(value, list) else set()


def draft_of(table: DraftTable, called: str = "") -> Draft:
    """Return a proposed map from the first rows of a table.

    Args:
        table: Its first rows.
        called: Names of its folder and file, which indicate robot or person if the columns do not.
    """
    names = {column: name_of(table.titles.get(column, column), table.units.get(column, "")) for column in table.names}
    names = {column: replace(name, column=column) for column, name in names.items()}
    table, others = of_first_time(table, names)
    names = {column: names[column] for column in table.names}
    lines, found = _Lines(notes=others), _Findings(table, names, set(re.findall("[a-z]+", called.lower())))
    lines.map += [Proposal(key, value) for key, value in table.keys.items()]
    _add_time(lines, table, names, found)
    timed, of_time = list(lines.map), set(lines.used)
    {"people": _add_people, "robot": _add_robot}[found.role](lines, table, names, found)
    keys, role = {line.key for line in lines.map}, Proposal("role", found.role, found.why, found.sure)
    rest = [name for name in table.names if name not in of_time and name not in table.in_lists]
    is_plc = table.headed and found.role == "robot" and keys.isdisjoint({"x", "joints"})
    if is_plc and (tags := state_columns(table, names, rest)):
        lines.map, lines.used = timed, of_time
        lines.add({"tags": tags}, "states: a signal each")
        role = Proposal("role", "events", "states, and neither positions nor joints: a PLC's trace")
    elif "tags" in keys and not found.sure and keys.isdisjoint(QUANTITIES):
        role = Proposal("role", "events", "its columns of two states are signals")
    elif keys.isdisjoint(QUANTITIES):
        lines.add(*questions(table, names, found.role), sure=False)
    lines.source.append(role)
    lines.notes += without_numbers(table, lines.used)
    if not table.headed:
        spans = [f"{name} {given(np.nanmin(told))} to {given(np.nanmax(told))}" for name, told in table.numbers.items()]
        lines.notes.append(f"its columns have no names: {', '.join(spans[:_LISTED])}")
    elif left := [column for column in table.names if column not in lines.used]:
        more = f" and {len(left) - _LISTED} more" if len(left) > _LISTED else ""
        lines.notes.append(f"not used: {', '.join(left[:_LISTED])}{more}")
    return Draft(tuple(lines.source), tuple(lines.map), tuple(lines.notes))


class _Findings:
    """Possible meanings of the columns, and whether they describe the robot or a person."""

    def __init__(self, table: DraftTable, names: dict[str, Name], called: set[str]) -> None:
        self.joints, self.scalings = joints(table, names), scalings(table, names)
        self.people = person_columns(table, names)
        every = places(table, names)
        persons = [place for place in every if place.person]
        robots = [place for place in every if not place.person]
        is_robot = bool(self.scalings) or any(found.robot for found in (*robots, *self.joints))
        is_person = bool(persons or self.people)
        self.sure, self.why = is_robot or is_person, "its columns say so"
        if not self.sure:
            is_robot, is_person = bool(called & ROBOT), bool(called & (PERSON | TRACKER))
            self.sure = is_robot != is_person
            self.why = "its name says so" if self.sure else "robot or people? Its columns do not say"
        self.role = "people" if is_person and not is_robot else "robot"
        self.places = (persons or places(table, names, of_people=True)) if self.role == "people" else robots
        self.others = persons if self.role == "robot" else []
        near = [found[0].columns for found in (self.places, self.joints) if found and self.role == "robot"][:1]
        path = [np.stack([table.numbers[column] for column in columns], axis=1) for columns in near]
        self.robots = [name for one in path for name in columns_of_several(table, one)]

    def evidence(self, table: DraftTable) -> TimeEvidence:
        """Return what these columns say of the unit of a time: a path in m or rad, if its unit is certain."""
        of = "people" if self.role == "people" else "robot"
        for found, units in ((self.places, METRES), (self.joints, RADIANS)):
            if found and found[0].unit_sure:
                path = np.stack([table.numbers[column] for column in found[0].columns], axis=1) * units[found[0].unit]
                return TimeEvidence(path=self._of_one(table, path), of=of, before_s=table.before_s)
        return TimeEvidence(of=of, before_s=table.before_s)

    def _of_one(self, table: DraftTable, path: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a path with the positions of all but the most frequent person or robot unknown."""
        column = (self.people or self.robots)[:1]
        if not column:
            return path
        cells, most = table.cells[column[0]], _most_common(table, column[0])
        return np.where(np.array([cell == most for cell in cells])[:, None], path, np.nan)


def _add_time(lines: _Lines, table: DraftTable, names: dict[str, Name], found: _Findings) -> None:
    times = found_times(table, names, found.evidence(table))
    if not times:
        counter = counts_rows(table, names)
        if counter is not None:
            lines.add({"time": counter, "time_unit": "frame"}, "it counts rows")
        rising = next((name for name, values in table.numbers.items() if rises(values)), None)
        why = (
            "the table has no time" if rising is None else f"{rising!r} rises in every row, but is no time by its name"
        )
        why = f"{counter!r} counts rows" if counter is not None else why
        lines.source.append(Proposal("rate_hz", 100.0, f"{why}: rows a second, as logged", sure=False))
        return
    keys, sure, notes = times[0].keys()
    lines.add(keys, times[0].comment, sure=sure)
    lines.notes += notes
    others = dict.fromkeys(name for other in times[1:] for name in other.columns if name not in times[0].columns)
    if others:
        lines.notes.append(f"also a time: {', '.join(others)}")


def _add_place(lines: _Lines, found: _Findings) -> None:
    if not found.places:
        return
    place = found.places[0]
    sure = place.sure and place.unit_sure
    why = "; ".join(part for part in (place.unit_why, place.why) if part)
    lines.add({**dict(zip("xyz", place.columns, strict=False)), "length_unit": place.unit}, why, sure=sure)


def _add_people(lines: _Lines, _: DraftTable, names: dict[str, Name], found: _Findings) -> None:
    _add_place(lines, found)
    if found.people:
        more = found.people[1:]
        lines.add({"person": found.people[0]}, f"or {', '.join(more)}?" if more else "", sure=not more)
    for name in names.values():
        if name.says({"confidence", "conf"}):
            lines.add({"confidence": name.column}, "0 = no person detected", sure=False)
            break


def _most_common(table: DraftTable, column: str) -> str:
    """Return the most frequent text of a column."""
    return Counter(table.cells[column]).most_common(1)[0][0]


def _add_robot(lines: _Lines, table: DraftTable, names: dict[str, Name], found: _Findings) -> None:
    _add_place(lines, found)
    for column in found.robots[:1]:
        several = ", ".join(dict.fromkeys(table.cells[column]))
        only: dict[str, object] = {column: _most_common(table, column)}
        lines.add({"only": only}, f"rows of several robots ({several}): choose one, a dataset of each", sure=False)
        lines.used.add(column)
    if found.joints:
        arm = found.joints[0]
        why = "; ".join(part for part in (arm.unit_why, arm.why) if part)
        lines.add({"joints": list(arm.columns), "joint_unit": arm.unit}, why, sure=arm.sure and arm.unit_sure)
    _add_scaling(lines, names, found.scalings)
    for column, known, unknown in states(table, names)[:1]:
        sure = "playing" in known.values()
        meaning: dict[str, str] = known or dict.fromkeys(unknown[:1], "playing")
        lines.add({"state": column, "states": meaning}, "" if sure else f"values: {', '.join(unknown[:12])}", sure=sure)
        if sure and unknown:
            lines.notes.append(f"unknown states: {', '.join(unknown[:12])}; map them in states")
    rest = [name for name in table.names if name not in lines.used and name not in table.in_lists]
    if table.headed and (bits := [name for name in rest if _is_bit(table.cells[name], names[name])]):
        lines.add({"tags": bits}, "two states: inputs and outputs, a signal each")
    words = [name for name in rest if name in table.numbers and _is_word(table.numbers[name])]
    for key, said in (("digital_in", _INPUTS), ("digital_out", _OUTPUTS)):
        mine = [name for name in words if names[name].says(said) and set(names[name].words) <= said | _BESIDE]
        if len(mine) == 1:
            lines.add({key: mine[0]}, "whole numbers under that name: its bits are signals")
    if found.others:
        shown = ", ".join(found.others[0].columns)
        lines.notes.append(f"a person: {shown}; to read it too, copy the file and add a source for the copy")


def _is_word(told: NDArray[np.float64]) -> bool:
    """Return whether numbers may be the bits of inputs or outputs: whole, not negative, and not 0 and 1 alone."""
    known = told[np.isfinite(told)]
    return bool(len(known) and (known >= 0).all() and (known == np.floor(known)).all() and known.max() > 1)


def _is_bit(cells: Sequence[str], name: Name) -> bool:
    """Return whether a column holds two states, or one of them and is named as an input or output.

    Zeros with decimals are a measured value, such as a force.
    """
    states = {cell.strip().lower() for cell in cells} - {""}
    either = states <= {"0", "1"} or states <= {"true", "false"}
    return either and (len(states) == 2 or (len(states) == 1 and name.says(_IN_OUT)))


def _add_scaling(lines: _Lines, names: dict[str, Name], found: list[FoundColumns]) -> None:
    tops = {scaling.unit for scaling in found}
    sliders = [scaling for scaling in found if names[scaling.columns[0]].says({"slider"})]
    others = [scaling for scaling in found if scaling not in sliders]
    sure = all(scaling.unit_sure for scaling in found) and len(tops) == 1 and len(others) < 2
    if not found:
        return
    columns = [scaling.columns[0] for scaling in others] or [sliders[0].columns[0]]
    keys: dict[str, object] = {"scaling": columns[0] if len(columns) == 1 else columns}
    keys |= {"slider": sliders[0].columns[0]} if others and sliders else {}
    why = found[0].unit_why if len(others) < 2 else f"{found[0].unit_why}; do they multiply?"
    lines.add({**keys, "scaling_max": int(found[0].unit)}, why, sure=sure)
