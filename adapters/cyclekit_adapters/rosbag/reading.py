"""Reading of a bag: roles and clocks of its topics, and the tables made from them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import ClockKind, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError
from cyclekit.schema import STAMPS, conform
from cyclekit_adapters.rosbag.clocks import EPOCH_S, StampSource, choose_times, simulated
from cyclekit_adapters.rosbag.container import AGAIN, Bag, opened
from cyclekit_adapters.rosbag.envelope import middle
from cyclekit_adapters.rosbag.facts import facts_of
from cyclekit_adapters.rosbag.frames import Frames, find_frames
from cyclekit_adapters.rosbag.people_tables import people_table, skeletons_table
from cyclekit_adapters.rosbag.roles import Roles, roles_in
from cyclekit_adapters.rosbag.sqlite_file import SqliteFile
from cyclekit_adapters.rosbag.tables import events_table, robot_table
from cyclekit_adapters.rosbag.tracks import Contents, collect
from cyclekit_adapters.text.text_rows import SET_ASIDE

if TYPE_CHECKING:
    from pathlib import Path

_NEAR_S = 1.0  # s; receive times this close to `/clock` were recorded in simulated time


def read_bag(path: Path, options: ReadOptions) -> Recording:
    """Return the recording of a bag; raises as an adapter's `read`."""
    with opened(path) as bag:
        roles, lost = _roles(bag, path, options)
        contents = collect(bag, roles, skeletons=options.skeletons)
        contents.warnings += [f"{topic} is not read: {why}; convert the bag to mcap" for topic, why in lost.items()]
        frames = find_frames(contents, roles, skeletons=options.skeletons, frame_given=options.frame_given)
        if frames.ambiguous and options.role in (None, "robot"):
            raise _several_arms(path, frames.ambiguous)
        is_simulated = _choose_times(contents, roles, frames)
        robot = robot_table(contents, roles, frames) if options.role in (None, "robot") else None
        people = people_table(contents, roles, frames) if roles.people or roles.bodies else None
        events = events_table(contents, roles) if roles.events else None
        if robot is None and people is None and events is None:
            raise _nothing_usable(bag)
        return Recording(
            robot=robot,
            people=people,
            events=events,
            skeletons=skeletons_table(contents, roles, frames) if people is not None and options.skeletons else None,
            stamps=_stamps(contents, frames),
            clock=_clock(robot, people, events, own=contents.times.own),
            joint_names=contents.joint_names,
            rows_are="message",
            rows_read=bag.messages_read,
            set_aside=_set_aside(bag),
            warnings=tuple(contents.warnings),
            facts=facts_of(bag, roles, contents, frames, is_simulated=is_simulated),
        )


def _roles(bag: Bag, path: Path, options: ReadOptions) -> tuple[Roles, dict[str, str]]:
    """Assign the topics; return the roles, and useful topics that cannot be decoded."""
    lost: dict[str, str] = {}
    while True:
        counts = {**bag.counts, **dict.fromkeys(lost, 0)}
        wants_robot = options.role in (None, "robot")
        roles = roles_in(path, bag.topics, counts, options.map, options.body, robot=wants_robot)
        roles = _wanted(roles, options)
        found = bag.resolve_layouts(roles.topics() - set(lost))
        if not found:
            return roles, lost
        lost |= found


def _wanted(roles: Roles, options: ReadOptions) -> Roles:
    """Return only the roles that the cell file requests for this bag."""
    if options.role == "people":
        return replace(
            roles, tcp=None, joints=None, scaling=(), running=None, events=(), modes=(),
            bodies=bool(roles.transforms) and (roles.bodies or not roles.people),
        )  # fmt: skip
    if options.role == "events":
        modes = tuple(topic for topic in roles.modes if topic in roles.events)
        return Roles(events=roles.events, modes=modes, clocks=roles.clocks, time=roles.time)
    if options.role == "robot":
        return replace(roles, people=(), events=(), bodies=False)
    return roles


def _choose_times(contents: Contents, roles: Roles, frames: Frames) -> bool:
    """Choose the clock of every topic and link in use; return whether time was simulated."""
    clocks = [topic for topic in roles.clocks if topic in contents.tracks]
    columns = [(contents.tracks[topic].receive_s, contents.tracks[topic].joined()) for topic in clocks]
    for topic in clocks:
        del contents.tracks[topic]
    ticks = [np.concatenate(part) for part in zip(*columns, strict=True)] if columns else []
    if ticks and middle(np.abs(ticks[0] - ticks[1])) > _NEAR_S:
        for track in contents.tracks.values():
            track.receive_s = simulated(track.receive_s, ticks[0], ticks[1])
        for link in contents.transforms.links.values():
            link.receive_s = simulated(link.receive_s, ticks[0], ticks[1])
        contents.warnings.append(
            f"{', '.join(clocks)}: time was simulated, so header stamps and receive times are different clocks; "
            "all times are simulated; a message without a header gets the simulated time at which it was received"
        )
    sources = {topic: contents.source(topic) for topic in contents.tracks}
    links = {link.name: link for link in frames.links()}
    asked = dict(roles.time)
    for name, link in links.items():
        sources[name] = StampSource(link.receive_s, np.where(link.stamp_s > 0.0, link.stamp_s, np.nan))
        if link.topic in roles.time:
            asked[name] = roles.time[link.topic]
    contents.times = choose_times(sources, asked)
    for name, link in links.items():
        link.times = contents.times.chosen[name].times(sources[name])
    contents.warnings += contents.times.warnings
    return bool(ticks)


def _stamps(contents: Contents, frames: Frames) -> pl.DataFrame | None:
    """Return table STAMPS if the log keeps a clock other than the recorder's; else None."""
    if not contents.times.own:
        return None
    both = [contents.source(topic) for topic in contents.tracks]
    both += [StampSource(link.receive_s, link.stamp_s) for link in frames.links()]
    t_s, host_s = (np.concatenate(part) for part in zip(*((s.stamp_s, s.receive_s) for s in both), strict=True))
    if float(host_s.min()) < EPOCH_S:
        return None
    return conform(pl.DataFrame({"t_s": t_s, "host_s": host_s}).sort("t_s", "host_s"), STAMPS)


def _several_arms(path: Path, tools: list[str]) -> LogError:
    cure = f'Name one in [sources.map] of cell.toml: tool_frame = "{tools[0]}".'
    return LogError(path, f"the transforms lead to the tools of several arms ({', '.join(tools)})", cure=cure)


def _nothing_usable(bag: Bag) -> DamagedLog:
    if bag.topics and not any(bag.counts.values()):
        named = ", ".join(sorted(bag.topics)[:4]) + (", ..." if len(bag.topics) > 4 else "")
        files = [file.path.name for file in bag.files if isinstance(file, SqliteFile)]
        cure = f"Copy {files[0]}-wal from beside it too: it holds what was not in the bag yet. " if files else ""
        cause = f"it names {len(bag.topics)} topics ({named}) and holds no message"
        return DamagedLog(bag.path, cause, cure=f"{cure}Else record it again.")
    if bag.undecodable:
        topic, _, reason = bag.undecodable[0]
        cause = f"none of its messages of a robot, people or events can be read; the first, of {topic}: {reason}"
        return DamagedLog(bag.path, cause, cure=f"{AGAIN}, or convert it there: ros2 bag convert")
    none = {topic for topic, count in bag.counts.items() if not count}
    of = {topic: f"{kind}{', no message' if topic in none else ''}" for topic, kind in sorted(bag.topics.items())}
    found = ", ".join(f"{topic} ({about})" for topic, about in of.items()) or "none"
    cure = "Name the topics in [sources.map] of cell.toml: tcp, joints, scaling, people, events."
    return DamagedLog(bag.path, f"no topic with a robot, people or events; topics in the bag: {found}", cure=cure)


def _clock(*tables: pl.DataFrame | None, own: bool) -> ClockKind:
    first = [float(str(table["t_s"].min())) for table in tables if table is not None and table.height]
    if first and min(first) > EPOCH_S:
        return "epoch"
    return "uptime" if own else "relative"


def _set_aside(bag: Bag) -> pl.DataFrame:
    rows: list[tuple[int | None, str]] = []
    order = {topic: bag.order(topic) for topic, _, _ in bag.undecodable}
    rows += [(int(order[topic][number]), reason) for topic, number, reason in bag.undecodable]
    rows += [(None, reason) for reason in bag.set_aside()]  # a damaged chunk has no row
    return pl.DataFrame(rows, schema=SET_ASIDE, orient="row")
