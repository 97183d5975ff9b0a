"""A session: recordings that share a time.

Only the data that pass between `ingest`, `derive` and `activity`; which recordings belong together is decided here,
folder by folder.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclekit.errors import ConfigError
from cyclekit.inside import fitting

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass
class Session:
    """Recordings that share a time; filled step by step.

    Attributes:
        entries: Provenance entries of the recordings, the clock's master first.
        runs: Numbers of its runs in the list of all runs.
        span_s: First and last time of a session without a robot, session seconds.
    """

    name: str
    entries: list[dict[str, Any]]
    reference: bool = False
    runs: list[int] = field(default_factory=list)
    span_s: tuple[float, float] = (0.0, 0.0)


def group_sessions(
    entries: list[dict[str, Any]], is_reference: Callable[[str], bool], *, numbered: bool = False
) -> list[Session]:
    """Group recordings that share a time: all of them if there is one robot log, else folder by folder.

    Args:
        entries: Of the recordings; each gets the name of its session.
        is_reference: Tells by the path of a log whether it was recorded with nobody in the cell.
        numbered: Name sessions by number, not by the folder or log that they come from.
    """
    robots, others = _divided(entries)
    if len(robots) == 1 and len({tuple(entry["tables"]) for entry in others}) == len(others):
        groups = [[robots[0], *others]]
    else:
        folders: dict[str, list[dict[str, Any]]] = {}
        for entry in entries:
            folders.setdefault(_folder(entry), []).append(entry)
        groups = [group for folder, here in folders.items() for group in _in_folder(folder, *_divided(here))]
    sessions: list[Session] = []
    taken: set[str] = set()
    digits = len(str(len(groups)))
    for number, group in enumerate(groups, 1):
        name = f"session_{number:0{digits}d}" if numbered else _session_name(group, taken)
        taken.add(name)
        shown = group[0]["sources"][0]["path"]
        reference = is_reference(shown)
        for entry in group:
            entry["session"] = name
        sessions.append(Session(name, group, reference))
    return sessions


def _divided(entries: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the robots' recordings and the others."""
    robots = [entry for entry in entries if "robot" in entry["tables"]]
    return robots, [entry for entry in entries if "robot" not in entry["tables"]]


def _folder(entry: dict[str, Any]) -> str:
    source = entry["sources"][0]["path"]
    parts = Path(source).parts[:-1]
    return "/".join(parts[:-1] if len(entry["sources"]) > 1 else parts)


def _in_folder(folder: str, robots: list[dict[str, Any]], others: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    if len(robots) == 1:
        return [[robots[0], *others]]
    if robots and others:
        every = [entry["sources"][0]["path"] for entry in robots + others]
        msg = (
            f"{folder or 'the logs'}: {len(robots)} robot logs and {len(others)} others, unclear which belong together"
        )
        raise ConfigError(msg, cure=f"Put each session into a folder of its own ({', '.join(every[:4])}, …).")
    return [[entry] for entry in robots + others]


def _session_name(group: list[dict[str, Any]], taken: set[str]) -> str:
    folder = _folder(group[0]).replace("/", ".")
    name = fitting(folder) if folder and fitting(folder) not in taken else group[0]["id"]
    number = 1
    while name in taken:
        number += 1
        name = f"{group[0]['id']}-{number}"
    return name
