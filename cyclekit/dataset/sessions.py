"""Sessions: groups of recordings on one time axis.

Holds the data passed between `ingest`, `derive` and `activity`, and decides which logs belong together.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.dataset.cards import LogCard, RecordingCard, note
from cyclekit.dataset.log_names import match_names
from cyclekit.errors import ConfigError
from cyclekit.storage.safe_path import valid_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.dataset.cards import Note

    _Key = tuple[str, int, tuple[str, ...]]

WITHOUT_PLACES = {"task_list", "safety"}
"""Tables without positions."""
OVERLAP_S = 1.0
"""Maximum overlap of consecutive logs of one robot, s."""


@dataclass(frozen=True)
class LogGroup:
    """Logs on one time axis, before their clocks are aligned.

    Attributes:
        name: Name of their session.
        logs: The logs; the first has the reference clock.
        reference: Whether it was recorded without an operator in the cell.
        nobody_logged: Whether a tracker log with a header but no rows belongs to it.
    """

    name: str
    logs: tuple[LogCard, ...]
    reference: bool = False
    nobody_logged: bool = False


@dataclass(frozen=True)
class Session:
    """Recordings on one time axis.

    Attributes:
        name: Name of the session.
        recordings: The recordings; the first has the reference clock.
        reference: Whether it was recorded without an operator in the cell.
        runs: Indices of its runs in the list of all runs.
        span_s: First and last time of all recordings, session seconds.
        nobody_logged: Whether a tracker log with a header but no rows belongs to it.
    """

    name: str
    recordings: tuple[RecordingCard, ...]
    reference: bool = False
    runs: tuple[int, ...] = ()
    span_s: tuple[float, float] = (0.0, 0.0)
    nobody_logged: bool = False


def group_sessions(
    logs: Sequence[LogCard],
    is_reference: Callable[[str], bool],
    *,
    numbered: bool = False,
    shares: Callable[[LogCard], bool] = lambda log: False,
) -> list[LogGroup]:
    """Group logs on one time axis: all of them if there is one robot log, else folder by folder.

    If some folders hold only robot logs and others only other logs (`robot/a.csv`, `tracker/a.csv`), logs of the same
    name are grouped if the match is unique; in one folder, logs whose names have the same words besides those that say
    the kind (`shift_1_robot.csv`, `shift_1_take.csv`); else those of the same time, if their clocks count since 1970
    and no two robots run at once. A log shared by several robot logs belongs to the session of each that overlaps it
    in time.

    Args:
        logs: The logs that were read.
        is_reference: Function of a log's path: whether it was recorded without an operator in the cell.
        numbered: Name sessions by number instead of by folder or log.
        shares: Function of a non-robot log: whether several robot logs may share it.
    """
    robots, others = _divided(logs)
    if len(robots) == 1 and len({log.tables for log in others}) == len(others):
        groups = [[robots[0], *others]]
    else:
        folders: dict[str, list[LogCard]] = {}
        for log in logs:
            folders.setdefault(_folder(log), []).append(log)
        alone = [group for folder, here in folders.items() for group in _in_folder(folder, *_divided(here), shares)]
        groups = _by_time(_by_words(_by_name(alone)), shares)
    sessions: list[LogGroup] = []
    taken: set[str] = set()
    digits = len(str(len(groups)))
    for number, group in enumerate(groups, 1):
        name = f"session_{number:0{digits}d}" if numbered else _session_name(group, taken)
        taken.add(name)
        sessions.append(LogGroup(name, tuple(group), is_reference(group[0].shown)))
    return sessions


def with_empty(sessions: Sequence[LogGroup], paths: Sequence[str]) -> list[LogGroup]:
    """Return the sessions, with those marked whose robot log has an empty tracker log.

    Args:
        sessions: All sessions.
        paths: Paths of the empty tracker logs, which are matched by folder and name as they have no times.
    """
    folders = {str(Path(path).parent.as_posix()) for path in paths}
    names = {key for path in paths for key in _keys_of(Path(path).stem, str(Path(path).parent.as_posix()))}
    robots = Counter(_folder(log) for session in sessions for log in _divided(session.logs)[0])

    def beside(session: LogGroup) -> bool:
        (mine, _), tracked = _divided(session.logs), any("people" in log.tables for log in session.logs)
        if tracked or not mine:
            return False
        here = _folder(mine[0])
        return (here in folders and robots[here] == 1) or any(key in names for key in _keys(mine[0]))

    return [replace(session, nobody_logged=beside(session)) for session in sessions]


def unpaired(sessions: Sequence[LogGroup]) -> list[Note]:
    """Return notes if there are both robot logs without people and logs without a robot; else nothing."""
    tables = [(session, {table for log in session.logs for table in log.tables}) for session in sessions]
    robots = [
        session for session, kinds in tables if "robot" in kinds and "people" not in kinds and not session.reference
    ]
    others = [session for session, kinds in tables if "robot" not in kinds]
    if not robots or not others:
        return []
    robot, other = (group[0].logs[0].shown for group in (robots, others))
    return [note("logs-unpaired", robots=len(robots), robot=robot, others=len(others), other=other)]


def _by_name(groups: list[list[LogCard]]) -> list[list[LogCard]]:
    """Add each unmatched log to the only robot log of the same name in a folder whose path differs in one part."""
    robots: dict[_Key, list[int]] = {}
    for number, group in enumerate(groups):
        if all("robot" in log.tables for log in group):
            for key in _keys(group[0]):
                robots.setdefault(key, []).append(number)
    joined = [list(group) for group in groups]
    for number, group in enumerate(groups):
        if any("robot" in log.tables for log in group):
            continue
        meant = {robot for key in _keys(group[0]) for robot in robots.get(key, [])}
        if len(meant) == 1:
            joined[meant.pop()] += group
            joined[number] = []
    return [group for group in joined if group]


def _by_time(groups: list[list[LogCard]], shares: Callable[[LogCard], bool]) -> list[list[LogCard]]:
    """Add unmatched logs in epoch time to robot logs without others that overlap them in time."""
    robots = [group for group in groups if len(group) == 1 and "robot" in group[0].tables]
    masters = [group[0] for group in robots if group[0].clock.kind == "epoch" and "people" not in group[0].tables]
    left = []
    for group in groups:
        log = group[0]
        met = [robot for robot in masters if _meet(robot, log)]
        lone = len(group) == 1 and "robot" not in log.tables and log.clock.kind == "epoch" and shares(log)
        if lone and met and _clear(met, [log]):
            for robot in robots:
                if robot[0] in met:
                    robot.append(log)
        else:
            left.append(group)
    return left


def _clear(robots: Sequence[LogCard], others: Sequence[LogCard]) -> bool:
    """Return whether time alone assigns the people of some logs to a robot: no two robots run at once."""
    if not any("people" in log.tables for log in others):
        return True
    if any(robot.clock.kind != "epoch" for robot in robots):
        return False
    spans = sorted((robot.first_s, robot.last_s) for robot in robots)
    return all(later[0] >= earlier[1] - OVERLAP_S for earlier, later in pairwise(spans))


def _keys(log: LogCard) -> list[_Key]:
    """Return keys of a log: its name and folders, with each folder omitted in turn."""
    return _keys_of(_name(log), _folder(log))


def _keys_of(name: str, folder: str) -> list[_Key]:
    folders = tuple(folder.split("/"))
    return [(name, at, folders[:at] + folders[at + 1 :]) for at in range(len(folders))]


def _divided(logs: Sequence[LogCard]) -> tuple[list[LogCard], list[LogCard]]:
    """Return the robot logs and the other logs."""
    robots = [log for log in logs if "robot" in log.tables]
    return robots, [log for log in logs if "robot" not in log.tables]


def _folder(log: LogCard) -> str:
    parts = Path(log.shown).parts[:-1]
    return "/".join(parts[:-1] if len(log.sources) > 1 else parts)


def _in_folder(
    folder: str, robots: list[LogCard], others: list[LogCard], shares: Callable[[LogCard], bool]
) -> list[list[LogCard]]:
    if len(robots) == 1:
        return [[robots[0], *others]]
    if robots and others and all(map(shares, others)) and _clear(robots, others):
        beside = [[log for log in others if _meet(robot, log)] for robot in robots]
        alone = [log for log in others if not any(log in logs for logs in beside)]
        return [[robot, *logs] for robot, logs in zip(robots, beside, strict=True)] + _at_one_time(alone)
    if robots and others and (named := _with_words(robots, others)):
        return named
    if robots and others:
        every = [log.shown for log in robots + others]
        msg = (
            f"{folder or 'the logs'}: {len(robots)} robot logs and {len(others)} others, unclear which belong together"
        )
        cure = (
            f"Put each session into its own folder ({', '.join(every[:4])}, …), or name its logs alike "
            "(shift_1_robot.csv, shift_1_tracker.csv). Logs whose times count since 1970 "
            "are matched by time, if no two robots run at once; dates without a time zone need time_zone in the map of "
            "their source in the cell file. A log of events is also matched by sync in its source. If robots work "
            "at once beside one tracker, make a dataset of each: cyclekit ingest "
            f"{robots[0].shown} {others[0].shown} --out DATASET, with frame of the tracker in this robot's base."
        )
        raise ConfigError(msg, cure=cure)
    return [[log] for log in robots] + _at_one_time(others)


def _by_words(groups: list[list[LogCard]]) -> list[list[LogCard]]:
    """Add unmatched logs of people to the robot logs whose paths have the same words, if all of them match."""
    lone = [group[0] for group in groups if len(group) == 1]
    robots, others = _divided(lone)
    people = [log for log in others if "people" in log.tables]
    named = _with_words([log for log in robots if "people" not in log.tables], people)
    met = {log.id for group in named for log in group}
    return named + [group for group in groups if not met & {log.id for log in group}]


def _with_words(robots: list[LogCard], others: list[LogCard]) -> list[list[LogCard]]:
    """Return each robot log with the logs whose paths have the same words; nothing if words or times do not fit."""
    matches = match_names([_words(log) for log in robots], [_words(log) for log in others]) if robots and others else []
    groups = [[robot] for robot in robots]
    for log, number in zip(others, matches or [], strict=False):
        kinds = {table for beside in groups[number] for table in beside.tables}
        if not _meet(robots[number], log) or kinds & set(log.tables):
            return []
        groups[number].append(log)
    return groups if matches else []


def _words(log: LogCard) -> str:
    return f"{_folder(log)}/{_name(log)}"


def _name(log: LogCard) -> str:
    path = Path(log.shown)
    return path.parent.name if len(log.sources) > 1 else path.stem


def _meet(robot: LogCard, log: LogCard) -> bool:
    """Return whether two logs may overlap in time; logs without epoch clocks always may."""
    if robot.clock.kind != "epoch" or log.clock.kind != "epoch":
        return True
    return log.first_s <= robot.last_s and robot.first_s <= log.last_s


def _at_one_time(logs: list[LogCard]) -> list[list[LogCard]]:
    """Group task lists and safety logs that overlap in epoch time; others stay alone."""
    groups: list[list[LogCard]] = []
    until_s = float("-inf")
    for log in sorted(filter(_has_own_time, logs), key=lambda log: log.first_s):
        if not groups or log.first_s > until_s:
            groups.append([])
        groups[-1].append(log)
        until_s = max(until_s, log.last_s)
    return groups + [[log] for log in logs if not _has_own_time(log)]


def _has_own_time(log: LogCard) -> bool:
    return set(log.tables) <= WITHOUT_PLACES and log.clock.kind == "epoch"


def _session_name(group: list[LogCard], taken: set[str]) -> str:
    folder = _folder(group[0]).replace("/", ".")
    folder = valid_name(folder) if folder else ""
    name = folder if folder and folder not in taken else group[0].id
    number = 1
    while name in taken:
        number += 1
        name = f"{group[0].id}-{number}"
    return name
