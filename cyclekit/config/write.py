"""Write a `Cell` as the text of a cell file that reads back as the same cell; likewise a sequence."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, get_args

from cyclekit.config.cells import CLOCK_KEYS, Activity, Begin, Cell, Frame, Source, Sync
from cyclekit.text.plain_text import one_line

if TYPE_CHECKING:
    from cyclekit.adapter import Draft, Proposal
    from cyclekit.config.sequences import TaskSequence

_ABOUT_DRAFTS = (
    "# Settings for sources of unknown format, proposed from their header and first rows: check each line.",
    '# A line that begins with "# ?" is uncertain: correct it, and remove "# ?". Keys: docs/adapters.md, csv.',
)
_ABOUT_ACTIVITIES = "# Tasks: states that last, of each agent, and what begins a cycle. Keys: docs/howto/plc-only.md"


def cell_to_toml(cell: Cell, drafts: Mapping[str, Draft] | None = None) -> str:
    """Return the text of a cell file for this cell, with comments on settings to fill in.

    Args:
        cell: The cell.
        drafts: Proposals for sources, by path; uncertain ones are commented out.
    """
    drafts = drafts or {}
    lines = [*(_ABOUT_DRAFTS if drafts else ()), f"name = {toml_value(cell.name)}"]
    lines += [f"ignore = {toml_value(list(cell.ignore))}"] if cell.ignore else []
    lines += [f"reference = {toml_value(list(cell.reference))}  # logs without an operator"] if cell.reference else []
    lines += [f"known_words = {toml_value(list(cell.known_words))}"] if cell.known_words else []
    lines += [f"rate_hz = {toml_value(cell.rate_hz)}"] if cell.rate_hz != Cell.rate_hz else []
    lines += [f"bridge_s = {toml_value(cell.bridge_s)}"] if cell.bridge_s != Cell.bridge_s else []
    lines += ["all_places_named = true"] if cell.all_places_named else []
    lines += [f"levels = {toml_value(list(cell.levels))}"] if cell.levels else []
    lines += [f"goal_signals = {toml_value(list(cell.goal_signals))}"] if cell.goal_signals else []
    lines += ["accept_bad_logs = true"] if cell.accept_bad_logs else []
    lines += [f"align_clocks = {toml_value(cell.align_clocks)}"] if cell.align_clocks else []
    lines += [f"set_override = {toml_value(cell.set_override)}"] if cell.set_override else []
    for source in cell.sources:
        lines += ["", "[[sources]]"]
        for key, value in vars(source).items():
            if (
                key != "activities"
                and value is not None
                and value not in ({}, ())
                and (key, value) != ("clock_rate", 1.0)
            ):
                lines.append(f"{key} = {toml_value(value)}")
        draft = drafts.get(source.path)
        if source.activities:
            lines += [_ABOUT_ACTIVITIES, f"activities = {toml_value(source.activities)}"]
        lines += [_proposed(proposal) for proposal in draft.source] if draft else []
        role = _role(source, draft)
        if role == "people" and source.frame is None:
            lines.append("# frame = { xyz_m = [0.0, 0.0, 0.0], yaw_deg = 0.0 }  # pose of the tracker")
        if role in {"people", "events", "tasks"} and all(getattr(source, key) in (None, ()) for key in CLOCK_KEYS):
            lines.append("# clock_offset_s = 0.0  # add to this log's time to get the robot log's time")
        lines += _drafted_map(draft) if draft else []
    for title, places in (("places", cell.places), ("human_places", cell.human_places)):
        for name, place in places.items():
            xyz, radius = toml_value(list(place.xyz_m)), toml_value(place.radius_m)
            lines += ["", f"[{title}.{_key(name)}]", f"xyz_m = {xyz}", f"radius_m = {radius}"]
            lines += [f"label = {toml_value(place.label)}"] if place.label else []
    for name, thing in cell.furniture.items():
        lines += [
            "",
            f"[furniture.{_key(name)}]",
            *(f"{key} = {toml_value(value)}" for key, value in vars(thing).items()),
        ]
    for told in cell.operator_signals:
        entries = {
            key: value for key, value in vars(told).items() if told.reset is not None or not key.startswith("reset")
        }
        lines += ["", "[[operator_signals]]", *(f"{key} = {toml_value(value)}" for key, value in entries.items())]
    for wait in cell.waits:
        keys = [f"{key} = {toml_value(value)}" for key, value in vars(wait).items() if value not in (None, False)]
        lines += ["", "[[waits]]", *keys]
    if cell.robot is not None:
        arm = ("model", cell.robot.model) if cell.robot.model else ("dh", [list(row) for row in cell.robot.dh])
        lines += ["", "[robot]", f"{arm[0]} = {toml_value(arm[1])}", f"tool_m = {toml_value(list(cell.robot.tool_m))}"]
    begin = cell.executions
    lines += [
        "",
        "[executions]",
        f'begin = "{begin.begin}"  # {", ".join(get_args(Begin))}',
        f"gap_s = {toml_value(begin.gap_s)}",
    ]
    lines += [f"home = {toml_value(begin.home)}"] if begin.home else []
    lines += [f"bit = {begin.bit}"] if begin.bit else []
    lines += [f"signal = {toml_value(begin.signal)}"] if begin.signal else []
    return "\n".join(lines) + "\n"


def sequence_to_toml(sequence: TaskSequence) -> str:
    """Return one `[[sequence]]` that reads back as this sequence."""
    lines = ["[[sequence]]", f"name = {toml_value(sequence.name)}"]
    if not sequence.plan:
        lines.append(f"places = {toml_value(list(sequence.places))}")
    if sequence.allowance != 1.0:
        lines.append(f"allowance = {toml_value(sequence.allowance)}  # chosen among many orders by the same logs")
    for task in sequence.plan:
        lines += ["", "[[sequence.task]]", f"agent = {toml_value(task.agent)}", f"name = {toml_value(task.name)}"]
        lines += [] if task.not_before_s is None else [f"not_before_s = {toml_value(task.not_before_s)}"]
        lines += [f"after = {toml_value(list(task.after))}"] if task.after else []
    return "\n".join(lines) + "\n"


def _role(source: Source, draft: Draft | None) -> object:
    proposed = [proposal.value for proposal in draft.source if proposal.key == "role"] if draft else []
    return source.role or next(iter(proposed), None)


def _drafted_map(draft: Draft) -> list[str]:
    notes = [f"# {one_line(note)}" for note in draft.notes]
    return ["", "[sources.map]", *(_proposed(proposal) for proposal in draft.map), *notes]


def _proposed(proposal: Proposal) -> str:
    """Return the line of a proposed key; an uncertain one is commented out."""
    why = f"  # {one_line(proposal.why)}" if proposal.why else ""
    return f"{'' if proposal.sure else '# ? '}{_key(proposal.key)} = {toml_value(proposal.value)}{why}"


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() and name.isascii() else toml_value(name)


def toml_value(value: object) -> str:
    """Return a value of a cell or project file in TOML syntax."""
    if isinstance(value, Frame):
        rotation = [list(row) for row in value.rotation]
        return f"{{ xyz_m = {toml_value(list(value.xyz_m))}, rotation = {toml_value(rotation)} }}"
    if isinstance(value, Sync):
        value = vars(value)
    if isinstance(value, Activity):
        value = {key: each for key, each in vars(value).items() if each != getattr(Activity, key, None)}
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(str(k))} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML's escapes are those of JSON
    return repr(value)
