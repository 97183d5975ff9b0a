"""ROS 1 and ROS 2 bags: .bag, .mcap, .db3 or the folder of a recording.

Robot: the TCP pose (`tcp_pose_broadcaster/pose`, or the transforms from the base to the tool), JointState by joint
name (else a controller's state), the speed scaling in the unit of the driver that writes it, whether the program runs,
and UR's modes. People: PoseArray, PoseStamped and PointStamped whose topic speaks of people; the messages of Azure
Kinect, SPENCER, people_msgs and ZED; the bodies of ROS4HRI. Events: String, Bool and modes. Metres, radians, seconds
since 1970; the time is the header's where every topic in use has one, else the moment of recording. Topics that
nobody needs are skipped; which topic means what can be set in `[sources.map]`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ClockKind, ReadOptions, Recording
from cyclekit.errors import DamagedLog
from cyclekit_adapters.rosbag.container import Bag, is_bag, opened
from cyclekit_adapters.rosbag.roles import CLOCK, CUSTOM, Factor, Roles, roles_in
from cyclekit_adapters.rosbag.tables import events_table, people_table, robot_table
from cyclekit_adapters.rosbag.tracks import Contents, collect

if TYPE_CHECKING:
    from pathlib import Path

_EPOCH_S = 1e8  # a clock below this (1973) counts from the start of something, not from 1970


class _RosBag:
    def recognises(self, path: Path) -> bool:
        return is_bag(path)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        with opened(path) as bag:
            skipped = [topic for topic in bag.undefined(CUSTOM) if bag.counts.get(topic)]
            counts = {**bag.counts, **dict.fromkeys(skipped, 0)}
            roles = _wanted(roles_in(path, bag.topics, counts, options.map, options.body), options)
            contents = collect(bag, roles)
            contents.warnings += [_not_defined(topic, bag.topics[topic]) for topic in skipped]
            contents.warnings += _clock_warning(bag, contents)
            robot = robot_table(contents, roles) if options.role in (None, "robot") else None
            people = people_table(contents, roles) if roles.people or roles.bodies else None
            events = events_table(contents, roles) if roles.events else None
            if robot is None and people is None and events is None:
                raise _nothing_usable(bag)
            return Recording(
                robot=robot,
                people=people,
                events=events,
                clock=_clock(robot, people, events),
                joint_names=contents.joint_names,
                rows_are="message",
                rows_read=bag.messages_read,
                set_aside=_set_aside(bag),
                warnings=tuple(contents.warnings),
                facts=_facts(bag, roles, contents),
            )


def _wanted(roles: Roles, options: ReadOptions) -> Roles:
    """Keep only what the cell file wants of this bag, where it says so."""
    if options.role == "people":
        bodies = bool(roles.transforms) and (roles.bodies or not roles.people)
        transforms = roles.transforms if bodies else ()
        return Roles(people=roles.people, transforms=transforms, bodies=bodies, base_frame=roles.base_frame)
    if options.role == "events":
        return Roles(events=roles.events, modes=tuple(topic for topic in roles.modes if topic in roles.events))
    if options.role == "robot":
        return replace(roles, people=(), events=(), bodies=False)
    return roles


def _not_defined(topic: str, kind: str) -> str:
    return f"{topic} is not read: its type {kind} is defined neither in the bag nor in ROS; convert the bag to mcap"


def _simulated_clocks(bag: Bag) -> list[str]:
    return [topic for topic, kind in bag.topics.items() if kind == CLOCK and bag.counts.get(topic)]


def _clock_warning(bag: Bag, contents: Contents) -> list[str]:
    clocks = _simulated_clocks(bag)
    used = "header stamps" if contents.stamped else "moments of recording"
    said = f"{', '.join(clocks)}: time was simulated, so header stamps and moments of recording may be different clocks"
    return [f"{said}; the {used} are used"] if clocks else []


def _nothing_usable(bag: Bag) -> DamagedLog:
    found = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(bag.topics.items())) or "none"
    cure = "Name the topics in [sources.map] of cell.toml: tcp, joints, scaling, people, events."
    return DamagedLog(bag.path, f"no topic of robot, people or events; topics in the bag: {found}", cure=cure)


def _clock(*tables: pl.DataFrame | None) -> ClockKind:
    first = [float(str(table["t_s"].min())) for table in tables if table is not None and table.height]
    return "epoch" if first and min(first) > _EPOCH_S else "relative"


def _set_aside(bag: Bag) -> pl.DataFrame:
    rows: list[tuple[int | None, str]] = []
    order = {topic: bag.order(topic) for topic, _, _ in bag.undecodable}
    rows += [(int(order[topic][number]), reason) for topic, number, reason in bag.undecodable]
    rows += [(None, reason) for reason in bag.set_aside()]  # a damaged chunk has no row
    return pl.DataFrame(rows, schema={"source_row": pl.Int64(), "reason": pl.String()}, orient="row")


def _facts(bag: Bag, roles: Roles, contents: Contents) -> dict[str, str]:
    def scale(factor: Factor) -> str:
        return f"{factor.topic} / {factor.full:g}"

    unused = sorted(set(bag.topics) - roles.topics())
    checked = {"checksum": "CRC-32 of every chunk, verified"} if bag.has_checksums() else {}
    return {
        **checked,
        "time": "header stamp" if contents.stamped else "receive time",
        "time_because": contents.why_time or "every topic in use has a header time",
        "simulated_time": "yes" if _simulated_clocks(bag) else "no sign of it",
        "tcp": roles.tcp or (contents.tool_chain or "none"),
        "joints": roles.joints or "none",
        "speed_scaling": " * ".join(map(scale, roles.scaling)) or "not recorded",
        "program_running": roles.running or "not recorded",
        "people": ", ".join([*roles.people, *(["body_<id> in transforms"] if roles.bodies else [])]) or "none",
        "events": ", ".join(roles.events) or "none",
        "frames": ", ".join(f"{topic}: {frame}" for topic, frame in sorted(contents.frames.items())) or "none",
        "skipped_topics": ", ".join(unused) or "none",
    }


ADAPTER: Adapter = _RosBag()
