"""Candidates for positions, joint angles, speed scaling, states and persons in an unknown table, from names and values.

Each finding holds the evidence for and against it; the user decides the uncertain ones. `draft` turns findings into a
map.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.text.numbers import compact
from cyclekit_adapters.mapped.draft_names import ACTUAL, IDS, JOINT, OTHER_IDS, PERSON, PLACE, POSITION, ROBOT, Name

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit_adapters.mapped.draft_table import DraftTable

_ARM = (("pan", "base"), ("lift", "shoulder"), ("elbow",), ("1", "wrist"), ("2", "wrist"), ("3", "wrist"))
"""Words for the joints of an arm with named joints, as in ROS."""
_LENGTHS_OF_ARMS = (6, 7)
_FLANGE_OF_FRANKA = ("o", "t", "ee", "#")
_VECTORS = POSITION | {"observation", "state", "qpos"}
"""Words for vectors of unspecified content, as in ROS and LeRobot: mostly joint angles."""
_SCALING = (
    *(
        "speedscaling",
        "speedoverride",
        "override",
        "ovpro",
        "ovrob",
        "ovr",
        "speedratio",
        "speedslider",
        "speedfraction",
    ),
    *(
        "speedfactor",
        "scalingfactor",
        "speedpercent",
        "projectspeed",
        "velocityscaling",
        "genoverride",
        "safetyscaling",
    ),
)
_STATES = {
    **dict.fromkeys(("playing", "running", "run", "executing", "started", "program running"), "playing"),
    **dict.fromkeys(("paused", "pause", "pausing", "hold", "held", "suspended", "resuming"), "paused"),
    **dict.fromkeys(("stopped", "stop", "stopping", "idle", "halted", "finished", "aborted", "ready"), "stopped"),
}
_STATE_NAMES = {"state", "status", "mode", "running", "run", "playing"}
_YES_NO = {"true": "playing", "1": "playing", "false": "stopped", "0": "stopped"}
_YES_NO_NAMES = {"running", "run", "playing"}
"""Names of columns that hold whether the program runs."""
_MAX_STATES = 30


@dataclass(frozen=True)
class FoundColumns:
    """Related columns with their unit, and how certain the finding is.

    Attributes:
        columns: In the order of axes or joints.
        unit: Their unit; the most likely one if uncertain.
        unit_why: Evidence for the unit.
        unit_sure: No other unit is possible.
        sure: No other meaning is possible.
        why: Evidence for or against it.
        person: The names refer to a person.
        robot: The names refer to a robot.
    """

    columns: tuple[str, ...]
    unit: str
    unit_why: str
    unit_sure: bool
    sure: bool = True
    why: str = ""
    person: bool = False
    robot: bool = False


def places(table: DraftTable, names: Mapping[str, Name], *, of_people: bool = False) -> list[FoundColumns]:
    """Return triples or pairs of position columns, the best first; `of_people`: the table describes people."""
    groups: dict[tuple[str, ...], list[Name]] = {}
    for name in _numeric(table, names):
        if not name.is_other and (name.axis or (name.number is not None and name.says(PLACE))):
            groups.setdefault((*name.words, "" if name.axis else "#"), []).append(name)
    found = [(group, axes) for group in groups.values() if (axes := _axes(group))]
    ranked = sorted(found, key=lambda pair: -_rank(pair[0][0]))
    best = [axes for group, axes in ranked if _rank(group[0]) == _rank(ranked[0][0][0])]
    return [
        _place(table, group[0], axes, others=len(best) - 1 if axes in best else 0, of_people=of_people)
        for group, axes in ranked
    ]


def _axes(group: Sequence[Name]) -> tuple[Name, ...]:
    """Return the columns of x, y and, if present, z; empty if the group has no or several such sets."""
    if group[0].axis:
        by = {name.axis: name for name in group}
        once = len(by) == len(group)
        return tuple(by[axis] for axis in "xyz" if axis in by) if once and {"x", "y"} <= set(by) else ()
    numbered = _consecutive(group)
    if len(numbered) == 16 and group[0].words == _FLANGE_OF_FRANKA:
        return numbered[12:15]  # a 4x4 matrix, column by column
    return numbered[:3] if len(numbered) in (3, 6, 7) and not group[0].says(JOINT) else ()


def _rank(name: Name) -> float:
    score = 3.0 * name.says(PLACE) + 2.0 * name.says(ACTUAL) + 1.0 * name.says(POSITION) + 1.0 * name.says(ROBOT)
    return score - 8.0 * name.is_set_point - 0.1 * len(name.words)


def _place(table: DraftTable, first: Name, axes: tuple[Name, ...], *, others: int, of_people: bool) -> FoundColumns:
    columns = tuple(name.column for name in axes)
    values = np.concatenate([table.numbers[column] for column in columns])
    person = first.says(PERSON) or of_people
    unit, why, sure = length_unit(values, {name.unit for name in axes}, person=person)
    against = (
        "a set point, not a measurement"
        if first.is_set_point
        else f"{others} other columns are possible"
        if others
        else ""
    )
    known = bool(np.isfinite(values).any()) and not against
    return FoundColumns(columns, unit, why, sure, known, against, person, first.says(ROBOT))


def length_unit(values: np.ndarray, units: set[str | None], *, person: bool) -> tuple[str, str, bool]:
    """Return the unit of lengths, the evidence for it, and whether no other unit is possible.

    No arm reaches 3 m (so 300 means mm or cm) or stays within 5 mm; no cell is 30 m wide (3000 cm).
    """
    named = units & {"m", "mm", "cm", "in"}
    if len(named) == 1:
        return str(named.pop()), "its name says so", True
    known = values[np.isfinite(values)]
    far = float(np.abs(known).max()) if len(known) else 0.0
    span = f"{compact(known.min())} to {compact(known.max())}" if len(known) else "no values"
    metres, millimetres = (30.0, 3000.0) if person else (5.0, 300.0)
    if 0.0 < far <= metres and (known % 1 != 0).any():
        return "m", f"values {span}", True
    if far >= millimetres:
        return "mm", f"values {span}", True
    return ("m" if far < metres else "mm"), f"values {span}: m, cm, mm and in are possible", False


def joints(table: DraftTable, names: Mapping[str, Name]) -> list[FoundColumns]:
    """Return the joint angles of arms, the best first."""
    groups: dict[tuple[str, ...], list[Name]] = {}
    for name in _numeric(table, names):
        is_joint = name.says(JOINT) or (name.says(_VECTORS) and not name.says(PLACE | PERSON))
        if not name.is_other and name.number is not None and is_joint:
            groups.setdefault(name.words, []).append(name)
    found = [numbered for group in groups.values() if len(numbered := _consecutive(group)) in _LENGTHS_OF_ARMS]
    found += [named] if (named := _named_joints(_numeric(table, names))) else []
    ranked = sorted(
        found, key=lambda group: 8 * group[0].is_set_point - 2 * group[0].says(ACTUAL) - _says_joints(group)
    )
    return [_joints(table, group, others=len(ranked) - 1) for group in ranked]


def _joints(table: DraftTable, group: tuple[Name, ...], others: int) -> FoundColumns:
    columns = tuple(name.column for name in group)
    values = np.concatenate([table.numbers[column] for column in columns])
    unit, why, sure = angle_unit(values, {name.unit for name in group})
    against = "a set point, not a measurement" if group[0].is_set_point else ""
    if others and not group[0].says(ACTUAL) and not against:
        against = f"{others} other columns are possible"
    elif not _says_joints(group):
        against = "joint angles, or a pose?"
    turned = bool(np.isfinite(values).any()) and float(np.nanmax(np.abs(values))) < 800.0
    against = against or ("" if turned else "its values are not angles")
    return FoundColumns(columns, unit, why, sure, not against, against, robot=_says_joints(group))


def _says_joints(group: Sequence[Name]) -> bool:
    return group[0].says(JOINT) or group[0].number is None or "wrist" in group[-1].words


def angle_unit(values: np.ndarray, units: set[str | None]) -> tuple[str, str, bool]:
    """Return the unit of joint angles, its evidence, and whether no other is possible: no joint turns twice or more."""
    named = units & {"rad", "deg"}
    if len(named) == 1:
        return str(named.pop()), "its name says so", True
    known = values[np.isfinite(values)]
    most = float(np.abs(known).max()) if len(known) else 0.0
    span = f"values {compact(known.min())} to {compact(known.max())}" if len(known) else "no values"
    if most > 12.6:
        return "deg", span, True
    if 0.5 < most <= 6.4 and (known % 1 != 0).any():
        return "rad", span, True
    return ("rad" if most < 6.4 else "deg"), f"{span}: rad and deg are possible", False


def _named_joints(numeric: Sequence[Name]) -> tuple[Name, ...]:
    """Return the columns of an arm with named joints, from the base outwards."""
    found = []
    for wanted in _ARM:
        fits = [
            name
            for name in numeric
            if not name.is_other
            and not name.axis
            and not name.is_set_point
            and (
                "wrist" in name.words and str(name.number) == wanted[0] if "wrist" in wanted else name.says(wanted[:1])
            )
        ]
        fits = fits or [name for name in numeric if not name.is_other and not name.axis and name.says(wanted[1:2])]
        if len(fits) != 1 or fits[0] in found or fits[0].says(PERSON):
            return ()
        found += fits
    return tuple(found)


def _consecutive(group: Sequence[Name]) -> tuple[Name, ...]:
    """Return the columns ordered by number, if the numbers are unique and consecutive from 0 or 1."""
    by = {name.number: name for name in group if name.number is not None}
    order = sorted(number for number in by if number is not None)
    begun = order and order[0] in (0, 1) and order == list(range(order[0], order[0] + len(order)))
    return tuple(by[number] for number in order) if begun and len(by) == len(group) else ()


def scalings(table: DraftTable, names: Mapping[str, Name]) -> list[FoundColumns]:
    """Return columns of speed scaling; the unit is "1" or "100", the value at full speed."""
    found = []
    for name in _numeric(table, names):
        plain = "".join(name.words)
        if not any(part in plain for part in _SCALING) or (name.is_set_point and "fraction" not in plain):
            continue
        top, why, sure = _full_speed(table.numbers[name.column], name.unit)
        found.append(FoundColumns((name.column,), top, why, sure))
    return found


def _full_speed(values: np.ndarray, unit: str | None) -> tuple[str, str, bool]:
    known = values[np.isfinite(values)]
    most = float(known.max()) if len(known) else 0.0
    span = f"values {compact(known.min())} to {compact(most)}" if len(known) else "no values"
    within = len(known) > 0 and known.min() >= 0.0
    if unit == "%":
        return "100", "its name says percent", within and most <= 100.1
    if within and 1.5 < most <= 100.1:
        return "100", f"{span}: percent", True
    if within and most <= 1.001 and (known % 1 != 0).any():
        return "1", f"{span}: a fraction", True
    return ("1" if most <= 1.5 else "100"), f"{span}: a fraction and percent are possible", False


def states(table: DraftTable, names: Mapping[str, Name]) -> list[tuple[str, dict[str, str], list[str]]]:
    """Return columns of a program's state, each with its words of known meaning and those of unknown meaning."""
    found = []
    for name in names.values():
        if not name.says(_STATE_NAMES) or name.says(("safety", "joint", "gripper", "human")):
            continue
        cells = Counter(cell.strip() for cell in table.cells[name.column] if cell.strip())
        if not cells or len(cells) > _MAX_STATES:
            continue
        words = _STATES | (_YES_NO if name.says(_YES_NO_NAMES) else {})
        known = {word: state for word in cells if (state := words.get(word.lower().replace("_", " ")))}
        found.append((name.column, known, sorted(set(cells) - set(known))))
    return sorted(found, key=lambda entry: -len(entry[1]))


def person_columns(table: DraftTable, names: Mapping[str, Name]) -> list[str]:
    """Return columns that identify a person: few distinct values, each in many rows."""
    found = []
    for name in names.values():
        known = [cell for cell in table.cells[name.column] if cell.strip()]
        named = name.says(IDS) and not name.says(OTHER_IDS) and not name.axis and name.number is None
        if named and known and len(set(known)) <= max(1, len(known) // 2):
            found.append(name.column)
    return found


def _numeric(table: DraftTable, names: Mapping[str, Name]) -> list[Name]:
    return [name for column, name in names.items() if column in table.numbers]
