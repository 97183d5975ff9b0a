"""The canonical tables out of the messages of a bag.

Topics come at rates of their own. The robot's table stands on the time of its TCP pose (of its joints, where there
is none): a position is taken from the nearest message, a scaling or a program state holds until the next message.
What was not recorded, or not yet, stays unknown.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import polars as pl

from cyclekit.schema import EVENTS, PEOPLE, ROBOT, conform
from cyclekit_adapters.rosbag.chain import Array, Transforms, tool_path
from cyclekit_adapters.rosbag.container import Message
from cyclekit_adapters.rosbag.roles import FLAG, JOINTS, POINT, POSE, POSES, TEXT

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.container import Bag
    from cyclekit_adapters.rosbag.roles import Factor, Roles

_BACK_S = 1.0  # a header clock that jumps back by more than this is no clock
_NEAR_PERIODS = 2.0  # a position further away in time than this many of its periods is unknown
_SLACK = 1e-3


@dataclass
class Track:
    """The messages of one topic: when received, when stamped (None: no header or an unset one), and what."""

    receive_s: list[float] = field(default_factory=list)
    stamp_s: list[float | None] = field(default_factory=list)
    index: list[int] = field(default_factory=list)
    value: list[Message] = field(default_factory=list)

    def add(self, receive_s: float, stamp_s: float | None, index: int, value: Message) -> None:
        """Take in one message."""
        self.receive_s.append(receive_s)
        self.stamp_s.append(stamp_s)
        self.index.append(index)
        self.value.append(value)


@dataclass
class Contents:
    """What was collected from a bag, and what is to be said about it."""

    tracks: dict[str, Track]
    transforms: Transforms
    stamped: bool = False
    frames: dict[str, str] = field(default_factory=dict)
    joint_names: tuple[str, ...] = ()
    tool_chain: str = ""
    warnings: list[str] = field(default_factory=list)

    def times(self, topic: str) -> Array:
        """Return the times of a topic's messages, shape (N,), s, in the clock chosen for this bag."""
        track = self.tracks[topic]
        return np.asarray(track.stamp_s if self.stamped else track.receive_s, dtype=np.float64)


def collect(bag: Bag, roles: Roles) -> Contents:
    """Decode every topic in use."""
    contents = Contents({}, Transforms())
    factors = {factor.topic: factor for factor in roles.scaling}
    for topic, index, receive_s, message in bag.messages(roles.topics()):
        try:
            if topic in roles.transforms:
                contents.transforms.add(message, receive_s)
                continue
            value = _value(bag.topics[topic], message, factors.get(topic))
            stamp_s = _stamp(contents, topic, message)
        except (AttributeError, TypeError, ValueError) as error:  # the definition in the bag is not the one we know
            bag.undecodable.append((topic, index, f"{topic}: message has other fields ({error})"))
            continue
        if value is not None:
            contents.tracks.setdefault(topic, Track()).add(receive_s, stamp_s, index, value)
    contents.stamped = _all_stamped(contents)
    if bag.undecodable:
        contents.warnings.append(f"{len(bag.undecodable)} messages cannot be decoded and are left out")
    return contents


def _value(kind: str, message: Message, factor: Factor | None) -> object:
    """Return the part of a message that is used, None if it has no such part."""
    if factor is not None:
        number = getattr(message, factor.attribute, None)
        return None if number is None else float(number)
    if kind == JOINTS:
        angles, speeds = (np.asarray(part, dtype=np.float64) for part in (message.position, message.velocity))
        return tuple(map(str, message.name)), angles, speeds
    if kind == POSE:
        return _xyz(message.pose.position)
    if kind == POINT:
        return _xyz(message.point)
    if kind == POSES:
        return [_xyz(pose.position) for pose in message.poses]
    if kind == TEXT:
        return str(message.data)
    if kind == FLAG:
        return bool(message.data)
    return None


def _xyz(point: Message) -> tuple[float, float, float]:
    return float(point.x), float(point.y), float(point.z)


def _stamp(contents: Contents, topic: str, message: Message) -> float | None:
    header = getattr(message, "header", None)
    if header is None:
        return None
    contents.frames.setdefault(topic, header.frame_id)
    stamp_s = float(header.stamp.sec + header.stamp.nanosec * 1e-9)
    return stamp_s if stamp_s > 0.0 else None


def _all_stamped(contents: Contents) -> bool:
    """Tell whether every message in use has a header time, and those times go forward."""
    tracks = [track.stamp_s for track in contents.tracks.values()]
    tracks += [list(link.stamp_s) for link in contents.transforms.links.values() if len(link.stamp_s) > 1]
    if not tracks or any(stamp is None for stamps in tracks for stamp in stamps):
        return False
    for stamps in tracks:
        if (np.diff(np.asarray(stamps, dtype=np.float64)) < -_BACK_S).any():
            contents.warnings.append("the header times jump back: the moments of recording are used instead")
            return False
    return True


def robot_table(contents: Contents, roles: Roles) -> pl.DataFrame | None:
    """Return table ROBOT, None where the bag says nothing of where the robot is."""
    table = _tcp(contents, roles)
    joints = _joints(contents, roles.joints) if roles.joints in contents.tracks else None
    if table is None:
        table = joints
    elif joints is not None:
        table = _nearest(table, joints.drop("source_row"))
    if table is None:
        return None
    if roles.running in contents.tracks:
        running = _series(contents, str(roles.running)).select(
            "t_s", state=pl.when(pl.col("value") > 0.5).then(pl.lit("playing")).otherwise(pl.lit("stopped"))
        )
        table = table.join_asof(running, on="t_s", strategy="backward")
    table = _with_scaling(contents, roles, table)
    return conform(table, ROBOT)


def _tcp(contents: Contents, roles: Roles) -> pl.DataFrame | None:
    if roles.tcp in contents.tracks:
        track = contents.tracks[str(roles.tcp)]
        times, place = contents.times(str(roles.tcp)), np.asarray(track.value, dtype=np.float64)
        return _in_order(_placed(times, place, np.asarray(track.index, dtype=np.int64)))
    chain = contents.transforms.chain(roles.base_frame, roles.tool_frame)
    if not chain:
        return None
    times, place = tool_path(chain, stamped=contents.stamped)
    contents.tool_chain = f"transforms from {chain[0].parent} over {len(chain)} link(s)"
    return _in_order(_placed(times, place, np.arange(times.size, dtype=np.int64)))


def _placed(times: Array, place: Array, index: npt.NDArray[np.int64]) -> pl.DataFrame:
    columns = {f"tcp_{axis}_m": place[:, i] for i, axis in enumerate("xyz")}
    return pl.DataFrame({"t_s": times, "source_row": index, **columns})


def _in_order(table: pl.DataFrame) -> pl.DataFrame:
    """Sort by time and keep one row per instant; NaN becomes null."""
    return table.fill_nan(None).drop_nulls("t_s").unique("t_s", keep="first").sort("t_s")


def _joints(contents: Contents, topic: str | None) -> pl.DataFrame | None:
    """Return joint angles by name; messages of other joints (a gripper on the same topic) are left out."""
    track = contents.tracks[str(topic)]
    messages = [value for value in track.value if isinstance(value, tuple)]
    written = Counter(names for names, _, _ in messages)
    written.pop((), None)
    if not written:
        return None
    order = max(written, key=lambda names: (written[names] * len(names), names))
    times = contents.times(str(topic))
    rows, angles, speeds = [], [], []
    for row, (names, position, velocity) in enumerate(messages):
        if len(names) != len(order) or set(names) != set(order):
            continue
        pick = None if names == order else [names.index(name) for name in order]
        rows.append(row)
        angles.append(_ordered(position, pick, len(order)))
        speeds.append(_ordered(velocity, pick, len(order)))
    if others := len(messages) - len(rows):
        contents.warnings.append(f"{others} messages of {topic} are about other joints and are left out")
    contents.joint_names = order
    columns = {f"q{i}_rad": np.asarray(angles)[:, i] for i in range(len(order))}
    columns |= {f"qd{i}_rad_s": np.asarray(speeds)[:, i] for i in range(len(order))}
    index = np.asarray(track.index, dtype=np.int64)[rows]
    return _in_order(pl.DataFrame({"t_s": times[rows], "source_row": index, **columns}))


def _ordered(values: Array, pick: list[int] | None, width: int) -> Array:
    if len(values) != width:  # a driver may leave out what it does not measure
        return np.full(width, np.nan)
    return values if pick is None else values[pick]


def _nearest(table: pl.DataFrame, other: pl.DataFrame) -> pl.DataFrame:
    period = other["t_s"].diff().median()
    near = _NEAR_PERIODS * float(str(period)) if period is not None else 0.1
    return table.join_asof(other, on="t_s", strategy="nearest", tolerance=near)


def _series(contents: Contents, topic: str) -> pl.DataFrame:
    values = np.asarray(contents.tracks[topic].value, dtype=np.float64)
    return pl.DataFrame({"t_s": contents.times(topic), "value": values}).sort("t_s", maintain_order=True)


def _with_scaling(contents: Contents, roles: Roles, table: pl.DataFrame) -> pl.DataFrame:
    """Add the product of all factors in force; unknown before the first message and while the program is stopped."""
    factors = [factor for factor in roles.scaling if factor.topic in contents.tracks]
    if not factors:
        contents.warnings.append("no speed scaling in the bag: it stays unknown")
        return table
    if any(factor.family == "command" for factor in factors):
        contents.warnings.append("the speed scaling is the one commanded: what the robot made of it was not recorded")
    names = []
    for number, factor in enumerate(factors):
        series = _series(contents, factor.topic).select("t_s", (pl.col("value") / factor.full).alias(f"_{number}"))
        table = table.join_asof(series, on="t_s", strategy="backward")
        names.append(_clamped(pl.col(f"_{number}"), factor))
        if factor.family not in ("cnr", "command") and (series[f"_{number}"] > 1.0 + _SLACK).any():
            contents.warnings.append(f"{factor.topic} exceeds {factor.full:g} in places: left unknown there")
    if all(factor.family == "cnr" for factor in factors) and len(factors) > 1:
        # An override that has not spoken yet does not slow: the controllers start from 100 percent.
        spoken = pl.any_horizontal([name.is_not_null() for name in names])
        names = [pl.when(spoken).then(name.fill_null(1.0)) for name in names]
    product = names[0]
    for name in names[1:]:
        product = product * name
    if "state" in table.columns:
        product = pl.when(pl.col("state").fill_null("playing") == "playing").then(product)
    columns = table.with_columns(scaling=product)
    return columns.drop([f"_{number}" for number in range(len(factors))])


def _clamped(value: pl.Expr, factor: Factor) -> pl.Expr:
    """Clamp as the controllers do; a state beyond its range is not that state, and unknown."""
    if factor.family in ("cnr", "command"):
        return value.clip(0.0, 1.0)
    return pl.when(value.is_between(0.0, 1.0 + _SLACK)).then(value.clip(0.0, 1.0))


def people_table(contents: Contents, roles: Roles) -> pl.DataFrame:
    """Return table PEOPLE; of an array the index is the person, and one with fewer entries has people not seen."""
    rows: list[tuple[float, str, float | None, float | None, float | None, int]] = []
    for topic in roles.people:
        if topic not in contents.tracks:
            continue
        track = contents.tracks[topic]
        prefix = f"{topic} " if len(roles.people) > 1 else ""
        most = max((len(seen) for seen in track.value if isinstance(seen, list)), default=1)
        if most > 1:
            contents.warnings.append(f"{topic} holds up to {most} places without identity: each index is one person")
        for t_s, index, value in zip(contents.times(topic).tolist(), track.index, track.value, strict=True):
            places = value if isinstance(value, list) else [value]
            for person in range(most):
                place = places[person] if person < len(places) else (None, None, None)
                rows.append((t_s, f"{prefix}{person}", place[0], place[1], place[2], index))
    schema = {name: column.dtype for name, column in PEOPLE.items()}
    table = pl.DataFrame(rows, schema=schema, orient="row").fill_nan(None)
    return conform(table.sort("t_s", "person", maintain_order=True), PEOPLE)


def events_table(contents: Contents, roles: Roles) -> pl.DataFrame:
    """Return table EVENTS: every text, and every change of a flag."""
    rows: list[tuple[float, str, str, int]] = []
    for topic in roles.events:
        if topic not in contents.tracks:
            continue
        track = contents.tracks[topic]
        last: object = None
        for t_s, index, value in zip(contents.times(topic).tolist(), track.index, track.value, strict=True):
            if isinstance(value, bool):
                if value != last:
                    rows.append((t_s, topic, "true" if value else "false", index))
                last = value
            else:
                rows.append((t_s, topic, str(value), index))
    schema = {name: column.dtype for name, column in EVENTS.items()}
    return conform(pl.DataFrame(rows, schema=schema, orient="row").sort("t_s", maintain_order=True), EVENTS)
