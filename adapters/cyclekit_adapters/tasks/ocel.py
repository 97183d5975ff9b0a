"""Object-centric event logs in JSON (OCEL 2.0, and 1.0): their events as the records of a task list.

An event has a type, a time, attributes, and objects of several types in place of one case and one resource. An object
whose type names an agent, a person or a robot is the agent; where there is one other type, its object is the execution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.adapter import is_person
from cyclekit_adapters.tasks.task_columns import NAMES
from cyclekit_adapters.text.json_parts import json_pieces, parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_ROBOTS = ("robot", "cobot", "machine")


def is_ocel(head: str) -> bool:
    """Return whether these are the first characters of an object-centric event log."""
    return '"ocel:' in head or ('"objectTypes"' in head and '"eventTypes"' in head)


def ocel_events(path: Path) -> Iterator[dict[str, object]]:
    """Yield each event as key -> value: `activity`, `timestamp`, its attributes, and its objects by their types.

    Raises:
        BrokenJson: The document is cut or garbled.
        LogError: It cannot be read.
    """
    kinds = {str(about.get("id")): str(about.get("type")) for about in _members(path, "objects")}
    agents = {kind for kind in kinds.values() if _is_agent(kind)}
    others = set(kinds.values()) - agents
    case = next(iter(others)) if len(others) == 1 else None
    for event in _members(path, "events"):
        record = {"activity": event.get("type", event.get("activity"))}
        record["timestamp"] = event.get("time", event.get("timestamp"))
        values, related = event.get("attributes", event.get("vmap")), event.get("relationships", event.get("omap"))
        for one in values if isinstance(values, list) else []:
            record |= {str(one.get("name")): one.get("value")} if isinstance(one, dict) else {}
        record |= values if isinstance(values, dict) else {}
        for one in related if isinstance(related, list) else []:
            name = str(one.get("objectId")) if isinstance(one, dict) else str(one)
            kind = kinds.get(name, "")
            if kind in agents and is_person(kind) and not is_person(name):
                name = f"{kind} {name}"
            record.setdefault("agent" if kind in agents else "case" if kind == case else kind, name)
        yield record


def _members(path: Path, key: str) -> Iterator[dict[str, object]]:
    """Yield the objects or events of a log, of version 1.0 without its prefix and with their names as `id`."""
    for prefix in ("", "ocel:"):
        for name, value in parts(json_pieces(path), inside=prefix + key):
            if name != prefix + key or not isinstance(value, dict):
                continue
            for identity, about in value.items() if prefix else [(None, value)]:
                plain = {str(k).removeprefix("ocel:"): v for k, v in about.items()} if isinstance(about, dict) else {}
                yield plain if identity is None else {"id": identity, **plain}


def _is_agent(kind: str) -> bool:
    plain = kind.lower().replace("_", "").replace(" ", "")
    return plain in NAMES["agent"] or is_person(kind) or any(word in plain for word in _ROBOTS)
