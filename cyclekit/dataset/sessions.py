"""A session: recordings that share a time.

Only the data that pass between `ingest`, `derive` and `activity`; which recordings belong together is decided here,
folder by folder.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclekit.errors import ConfigError
from cyclekit.storage.inside import fitting

if TYPE_CHECKING:
    from collections.abc import Callable

    _Key = tuple[str, int, tuple[str, ...]]

WITHOUT_PLACES = {"task_list", "safety"}
"""Tables that hold no positions."""
LISTED = "task list: "
"""How a warning of a recording begins that was found when its tasks were put beside the robot's."""


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

    Of folders that hold robot logs alone and folders that hold others alone (`robot/a.csv`, `tracker/a.csv`), logs of
    the same name are grouped, where only one robot log can be meant.

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
        groups = _by_name([group for folder, here in folders.items() for group in _in_folder(folder, *_divided(here))])
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


def unpaired(sessions: list[Session]) -> list[str]:
    """Return what to say where robot logs without people lie beside logs without a robot; nothing if all is well."""
    tables = [(session, {table for entry in session.entries for table in entry["tables"]}) for session in sessions]
    robots = [
        session for session, kinds in tables if "robot" in kinds and "people" not in kinds and not session.reference
    ]
    others = [session for session, kinds in tables if "robot" not in kinds]
    if not robots or not others:
        return []
    names = [group[0].entries[0]["sources"][0]["path"] for group in (robots, others)]
    return [
        f"{len(robots)} robot logs ({names[0]}, …) are without people, {len(others)} logs ({names[1]}, …) without a "
        "robot: unclear which belong together. Put each session into a folder of its own, or give its logs the "
        "same name in their folders (robot/a.csv, tracker/a.csv)"
    ]


def _by_name(groups: list[list[dict[str, Any]]]) -> list[list[dict[str, Any]]]:
    """Put logs that are alone to the one robot log of the same name in a folder that differs by one part."""
    robots: dict[_Key, list[int]] = {}
    for number, group in enumerate(groups):
        if all("robot" in entry["tables"] for entry in group):
            for key in _keys(group[0]):
                robots.setdefault(key, []).append(number)
    joined = [list(group) for group in groups]
    for number, group in enumerate(groups):
        if any("robot" in entry["tables"] for entry in group):
            continue
        meant = {robot for key in _keys(group[0]) for robot in robots.get(key, [])}
        if len(meant) == 1:
            joined[meant.pop()] += group
            joined[number] = []
    return [group for group in joined if group]


def _keys(entry: dict[str, Any]) -> list[_Key]:
    """Return the name of a log with its folders, each in turn left out."""
    sources = entry["sources"]
    folders = tuple(_folder(entry).split("/"))
    path = Path(sources[0]["path"])
    name = path.parent.name if len(sources) > 1 else path.stem
    return [(name, at, folders[:at] + folders[at + 1 :]) for at in range(len(folders))]


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
    return [[entry] for entry in robots] + _at_one_time(others)


def _at_one_time(entries: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Put task lists and safety logs in epoch time together that were recorded at the same time; others stay alone."""
    groups: list[list[dict[str, Any]]] = []
    until_s = float("-inf")
    for entry in sorted(filter(_has_own_time, entries), key=lambda entry: float(entry["first_s"])):
        if not groups or entry["first_s"] > until_s:
            groups.append([])
        groups[-1].append(entry)
        until_s = max(until_s, entry["last_s"])
    return groups + [[entry] for entry in entries if not _has_own_time(entry)]


def _has_own_time(entry: dict[str, Any]) -> bool:
    return set(entry["tables"]) <= WITHOUT_PLACES and entry["clock"]["kind"] == "epoch"


def _session_name(group: list[dict[str, Any]], taken: set[str]) -> str:
    folder = _folder(group[0]).replace("/", ".")
    folder = fitting(folder) if folder else ""
    name = folder if folder and folder not in taken else group[0]["id"]
    number = 1
    while name in taken:
        number += 1
        name = f"{group[0]['id']}-{number}"
    return name
