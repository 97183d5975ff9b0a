"""A robot log whose clock was restarted while recording becomes one recording and session per part.

In one log, times before and after the restart overlap, so neither a signal nor a tracker's row would belong to one
instant. Another log of the session joins each part whose clock it can be related to, and else the first part only.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from msgspec import structs

from cyclekit import schema
from cyclekit.alignment.recording_clocks import RESTART_S, can_follow, is_stated
from cyclekit.dataset.cards import LogCard, Note, note
from cyclekit.storage.parquet import TableWriter, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from cyclekit.config import Source
    from cyclekit.dataset.cards.recording import Table
    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.schema import Ints

MAX_PARTS = 100
"""Maximum number of parts: a clock that steps back more often was not restarted, its times are wrong."""


@dataclass(frozen=True)
class Divided:
    """Sessions whose robot logs have one clock each.

    Attributes:
        groups: The sessions.
        copies: Id of each added recording -> id of its log.
        notes: Which logs were divided.
    """

    groups: list[LogGroup]
    copies: Mapping[str, str]
    notes: list[Note]


def divide_restarted(
    groups: Sequence[LogGroup], sources: Mapping[str, Source | None], read: Read, stored: Stored, staging: Path
) -> Divided:
    """Return sessions in which no robot log's clock was restarted: each part of such a log is a session.

    Args:
        groups: Sessions; the robot log is the first of its session.
        sources: Section of the cell file for each recording, by id.
        read: Function from (id, table) to a native table of a recording, or None.
        stored: Function from (id, columns) to the robot table of a recording.
        staging: Folder of the dataset being built.

    Raises:
        OSError: A recording cannot be written.
    """
    ids = {log.id for group in groups for log in group.logs}
    names = {group.name for group in groups}
    made: list[LogGroup] = []
    copies, notes = dict[str, str](), list[Note]()
    for group in groups:
        log = group.logs[0]
        if not 0 < len(log.restart_rows) < MAX_PARTS or log.rows_are == "message":  # messages count by topic
            made.append(group)
            continue
        joints = [name for name in stored(log.id, ["t_s"]).names if name not in schema.ROBOT]
        parts = _parts(log, joints, ids, staging / "recordings")
        copies |= {part.id: log.id for part in parts[1:]}
        known = {**sources, **{part.id: sources[log.id] for part in parts}}
        follows = partial(_follows, sources=known, read=read, stored=stored)
        tested = [log for log in group.logs[1:] if "people" in log.tables and not is_stated(sources[log.id])]
        members, left = _members(parts, group.logs[1:], follows, tested)
        for part, others in zip(parts, members, strict=True):
            name = group.name if part is parts[0] else _free(group.name, names)
            made.append(replace(group, name=name, logs=(part, *others)))
        new = [one.name for one in made[-len(parts) :]]
        notes.append(note("log-divided", log=log.shown, parts=len(parts), first=new[0], last=new[-1]))
        if left:
            notes.append(note("log-in-first-part", log=left[0].shown, others=len(left) - 1, robot=log.shown))
    return Divided(made, copies, notes)


def _parts(log: LogCard, joints: Sequence[str], ids: set[str], recordings: Path) -> list[LogCard]:
    """Write the parts of a log as recordings, the first under its own name; return their cards."""
    bounds = [0, *log.restart_rows, log.rows["robot"]]
    whole = recordings / log.id
    begins = [int(_rows(whole / "robot.parquet", at, at + 1)["source_row"][0]) for at in log.restart_rows]
    cards = []
    for number, (first, end) in enumerate(pairwise(bounds)):
        name = log.id if number == 0 else _free(log.id, ids)
        folder = recordings / f"{name}.part"
        rows: dict[Table, int] = {}
        for table in log.tables:
            file = whole / f"{table}.parquet"
            frames: Iterator[pl.DataFrame]
            if table == "robot":
                frames = (_between(part, at, first, end) for at, part in _numbered(file))
            elif table == "stamps":
                frames = iter(_stretch(pl.concat([*parts_of(file)]), number, len(bounds) - 1))
            else:
                frames = (part.filter(_part_of(part, begins) == number) for part in parts_of(file))
            rows[table] = _write(frames, folder / f"{table}.parquet", table, joints if table == "robot" else [])
        times = np.concatenate([part["t_s"].to_numpy() for part in parts_of(folder / "robot.parquet")])
        first_s, last_s = float(times.min()), float(times.max())
        here = structs.replace(
            log,
            id=name,
            key="",  # read again by the next ingest: no part holds the whole log
            rows=rows,
            first_s=first_s,
            last_s=last_s,
            duration_s=last_s - first_s,
            restart_rows=(),
        )
        cards.append(here if number == 0 else structs.replace(here, rows_set_aside=(), warnings=()))
    shutil.rmtree(whole)  # its files may be links to those of the dataset before
    for card in cards:
        (recordings / f"{card.id}.part").rename(recordings / card.id)
    return cards


def _write(frames: Iterator[pl.DataFrame], file: Path, table: Table, joints: Sequence[str]) -> int:
    with TableWriter(file, schema.OF_LOGS[table], more=joints) as out:
        for frame in frames:
            if frame.height:
                out.write(frame)
        return out.rows


def _numbered(file: Path) -> Iterator[tuple[int, pl.DataFrame]]:
    """Yield a table by row groups, each with the number of its first row."""
    at = 0
    for part in parts_of(file):
        yield at, part
        at += part.height


def _between(part: pl.DataFrame, at: int, first: int, end: int) -> pl.DataFrame:
    return part[max(first - at, 0) : max(end - at, 0)]


def _rows(file: Path, first: int, end: int) -> pl.DataFrame:
    return pl.concat([_between(part, at, first, end) for at, part in _numbered(file)])


def _part_of(frame: pl.DataFrame, begins: Sequence[int]) -> pl.Series:
    """Return the number of the part to which each row of another table of the log belongs, by its place in the log."""
    places = frame["source_row"].fill_null(0).to_numpy()
    return pl.Series(np.searchsorted(begins, places, side="right"))


def _stretch(stamps: pl.DataFrame, number: int, count: int) -> list[pl.DataFrame]:
    """Return the stamps of a part; none if they do not step back as the robot's times do."""
    steps: Ints = np.flatnonzero(np.diff(stamps["t_s"].to_numpy()) < -RESTART_S) + 1
    bounds = [0, *steps.tolist(), stamps.height]
    return [stamps[bounds[number] : bounds[number + 1]]] if len(bounds) == count + 1 else []


def _members(
    parts: Sequence[LogCard], others: Sequence[LogCard], follows: partial[bool], tested: Sequence[LogCard]
) -> tuple[list[list[LogCard]], list[LogCard]]:
    """Return the other logs of each part, and those that are in the first part for want of a known clock.

    Clocks that will be tested in each part belong to all of them.
    """
    members: list[list[LogCard]] = [[] for _ in parts]
    left: list[LogCard] = []
    for log in others:
        fit = [members[number] for number, part in enumerate(parts) if follows(log, part, others)]
        for mine in fit or (members if log in tested else members[:1]):
            mine.append(log)
        left += [] if fit or log in tested else [log]
    return members, left


def _follows(
    log: LogCard,
    part: LogCard,
    others: Sequence[LogCard],
    *,
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
) -> bool:
    """Return whether the clock of a log can be related to that of one part of the robot's log."""
    source = sources[log.id]
    path = source.same_clock_as if source is not None else None
    if path is not None:
        lenders = [one for one in others if one is not log and (one.shown == path or fnmatchcase(one.shown, path))]
        return bool(lenders) and _follows(lenders[0], part, [], sources=sources, read=read, stored=stored)
    if log.clock.kind == part.clock.kind == "epoch":
        return log.first_s <= part.last_s and part.first_s <= log.last_s
    return can_follow(log, part, sources, read, stored)


def _free(name: str, taken: set[str]) -> str:
    """Return a name with the first free number, from 2, and take it."""
    found = next(new for number in range(2, len(taken) + 3) if (new := f"{name}-{number}") not in taken)
    taken.add(found)
    return found
