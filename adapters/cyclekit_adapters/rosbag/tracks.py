"""Content of the topics in use as arrays: one track per topic, in message order.

A track holds receive times, header stamps and the used part of its messages. Messages come in groups of equal layout,
and so do these parts; parts of one shape can be joined. `tables` combines the tracks; `clocks` chooses their times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cyclekit_adapters.rosbag.clocks import BagTimes, StampSource
from cyclekit_adapters.rosbag.modes import ROBOT_MODE, SAFETY_MODE, mode_names
from cyclekit_adapters.rosbag.payloads import Ints
from cyclekit_adapters.rosbag.people import MARKERS, TRACKERS, Persons, headers, persons
from cyclekit_adapters.rosbag.roles import CLOCK, CONTROLLER, FLAG, IO_STATES, JOINTS, POINT, POSE, POSES, TEXT
from cyclekit_adapters.rosbag.transforms import Array, Transforms

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.container import Arrived, Bag
    from cyclekit_adapters.rosbag.decode import Group
    from cyclekit_adapters.rosbag.roles import Factor, Roles


@dataclass(frozen=True)
class JointStates:
    """N messages about the same joints: names (J), angles (N, A) and speeds (N, S); a driver may omit either.

    A controller's state may also hold the speed scaling, shape (N,); NaN where it does not.
    """

    names: tuple[str, ...]
    angles: Array
    speeds: Array
    scaling: Array | None = None


_MAX_PINS = 53
Value = Array | JointStates | Persons | list[str] | npt.NDArray[np.bool_]


@dataclass(frozen=True)
class MessagePart:
    """Content of M messages of one layout.

    Attributes:
        rows: Rows of the track, shape (M,).
        value: Positions (M, 3), positions of several people (M, K, 3), numbers (M,), flags (M,), texts, joints, or
            named people.
        frame: Frame in their headers; empty if they have none.
    """

    rows: Ints
    value: Value
    frame: str = ""


@dataclass
class TopicMessages:
    """Messages of one topic.

    Attributes:
        receive_s, stamp_s: Receive times and header stamps (NaN: no header, or an unset one), shape (N,), s.
        index: Index within the topic, shape (N,), ascending.
        parts: Their content.
    """

    receive_s: Array = field(default_factory=lambda: np.zeros(0))
    stamp_s: Array = field(default_factory=lambda: np.zeros(0))
    index: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    parts: list[MessagePart] = field(default_factory=list)

    def joined(self) -> Array:
        """Return positions or numbers of all messages in order, shape (N, 3) or (N,); for joint states, the scaling."""
        values = [part.value.scaling if isinstance(part.value, JointStates) else part.value for part in self.parts]
        rows = np.concatenate([part.rows for part in self.parts])
        if len(values) == 1 and (rows[1:] > rows[:-1]).all():
            return np.asarray(values[0], dtype=np.float64)
        joined = np.concatenate([np.asarray(value, dtype=np.float64) for value in values])
        ordered = np.empty_like(joined)
        ordered[rows] = joined
        return ordered

    def each(self) -> list[object]:
        """Return the content of each message in order: a text, a flag, or positions of several people, shape (K, 3)."""
        found: list[object] = [None] * self.index.size
        for part in self.parts:
            items: Sequence[object] = part.value if isinstance(part.value, list) else list(np.asarray(part.value))
            for row, item in zip(part.rows.tolist(), items, strict=True):
                found[row] = item
        return found


@dataclass
class Contents:
    """Content collected from a bag, with warnings.

    Attributes:
        tracks: Messages by topic.
        times: Clock of each track, once chosen.
        joint_names: Names of the joints of the angles, once the tables are made.
        rows_of: Table -> topic whose messages are its rows.
    """

    tracks: dict[str, TopicMessages]
    transforms: Transforms
    times: BagTimes = field(default_factory=BagTimes)
    kinds: dict[str, str] = field(default_factory=dict)
    joint_names: tuple[str, ...] = ()
    rows_of: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def source(self, topic: str) -> StampSource:
        """Return the stamps of a topic's messages."""
        return StampSource(self.tracks[topic].receive_s, self.tracks[topic].stamp_s)

    def at(self, topic: str) -> Array:
        """Return the times of a topic's messages, shape (N,), s, in the log's clock."""
        return self.times.chosen[topic].times(self.source(topic))

    def frame_of(self, topic: str | None) -> str:
        """Return the frame in the headers of a topic."""
        parts = self.tracks[topic].parts if topic in self.tracks else []
        return next((part.frame for part in parts if part.frame), "")


@dataclass
class _Piece:
    number: Ints
    receive_ns: Ints
    stamp_s: Array
    value: Value
    frame: str


def collect(bag: Bag, roles: Roles, *, skeletons: bool = False) -> Contents:
    """Decode every topic in use; `skeletons`: also the joints of people."""
    contents = Contents({}, Transforms(), kinds=dict(bag.topics))
    factors = {factor.topic: factor for factor in roles.scaling}
    pieces: dict[str, list[_Piece]] = {}
    nobody: dict[str, list[_Piece]] = {}
    for arrived in bag.messages(roles.topics()):
        topic, group = arrived.topic, arrived.group
        try:
            if topic in roles.transforms:
                contents.transforms.add(topic, arrived.number, group)
                continue
            value = _value(arrived.kind, group, factors.get(topic), skeletons=skeletons)
            stamp_s, frame = _stamps(arrived)
        except (AttributeError, TypeError, ValueError, IndexError) as error:  # another definition than the known one
            reason = f"{topic}: a message has other fields ({error})"
            bag.undecodable += [(topic, number, reason) for number in arrived.number.tolist()]
            continue
        if value is not None:  # messages without people may lack a header, and their time would be of another clock
            is_empty = isinstance(value, Persons) and not value.places.shape[1]
            into = nobody if is_empty else pieces
            into.setdefault(topic, []).append(_Piece(arrived.number, group.receive_ns, stamp_s, value, frame))
    contents.tracks = {topic: _track(parts, bag.order(topic)) for topic, parts in (pieces or nobody).items()}
    contents.transforms.finish(bag.order)
    contents.warnings += bag.warnings
    if lost := bag.set_aside():
        contents.warnings.append(f"{len(lost)} parts of the bag are damaged and are left out: {lost[0]}")
    if bag.undecodable:
        contents.warnings.append(f"{len(bag.undecodable)} messages cannot be decoded and are left out")
    return contents


def _track(pieces: list[_Piece], order: Ints) -> TopicMessages:
    """Return the pieces of one topic in the order of their index; `order` is the index of each arrival number."""
    index = [order[piece.number] for piece in pieces]
    known = np.concatenate(index)
    by_index = np.argsort(known, kind="stable")
    ends = np.cumsum([part.size for part in index])
    row = np.empty(known.size, np.int64)
    row[by_index] = np.arange(known.size)
    return TopicMessages(
        receive_s=np.concatenate([piece.receive_ns for piece in pieces])[by_index] * 1e-9,
        stamp_s=np.concatenate([piece.stamp_s for piece in pieces])[by_index],
        index=known[by_index],
        parts=[
            MessagePart(rows, piece.value, piece.frame)
            for rows, piece in zip(np.split(row, ends[:-1]), pieces, strict=True)
        ],
    )


def _value(kind: str, group: Group, factor: Factor | None, *, skeletons: bool) -> Value | None:
    """Return the used part of the messages; None if they have none."""
    if kind == CONTROLLER:
        return _controller(group)
    if factor is not None:
        return _scalars(group, factor.attribute) if hasattr(group.message, factor.attribute) else None
    if kind == JOINTS:
        names = tuple(map(str, group.first("name")))
        angles, speeds = (group.numbers(part).astype(np.float64, copy=False) for part in ("position", "velocity"))
        return JointStates(names, angles, speeds)
    if kind == MARKERS or kind in TRACKERS:
        return persons(kind, group, skeletons=skeletons)
    if kind in (ROBOT_MODE, SAFETY_MODE):
        return mode_names(kind, group)
    if kind == POSE:
        return _xyz(group, "pose", "position")
    if kind == POINT:
        return _xyz(group, "point")
    if kind == POSES:
        places = [_xyz(group, "poses", person, "position") for person in range(len(group.first("poses")))]
        return np.stack(places, axis=1) if places else np.zeros((group.rows.size, 0, 3))
    if kind == TEXT:
        return [str(group.first("data"))] * group.rows.size
    if kind == FLAG:
        return _scalars(group, "data").astype(bool)
    if kind == CLOCK:
        return _seconds(group, "clock")
    if kind == IO_STATES:
        return np.stack([_bits(group, name) for name in ("digital_in_states", "digital_out_states")], axis=1)
    return None


def _bits(group: Group, name: str) -> Array:
    """Return pins and their states as a bit field, shape (N,); pins beyond the precision of a float are left out."""
    found = np.zeros(group.rows.size, np.int64)
    for place in range(len(group.first(name))):
        pin, state = (_scalars(group, name, place, part).astype(np.int64) for part in ("pin", "state"))
        found |= np.where(pin < _MAX_PINS, (state > 0).astype(np.int64) << np.minimum(pin, _MAX_PINS), 0)
    return found.astype(np.float64)


def _controller(group: Group) -> JointStates:
    """Read a controller's state by its fields: the measured position is called `actual`, later `feedback`."""
    measured = [name for name in ("feedback", "actual") if hasattr(group.message, name)]
    name = next((name for name in measured if len(group.first(name, "positions"))), measured[0])
    angles, speeds = (group.numbers(name, part).astype(np.float64, copy=False) for part in ("positions", "velocities"))
    has_scaling = hasattr(group.message, "speed_scaling_factor")
    scaling = _scalars(group, "speed_scaling_factor") if has_scaling else np.full(group.rows.size, np.nan)
    return JointStates(tuple(map(str, group.first("joint_names"))), angles, speeds, scaling)


def _scalars(group: Group, *path: str | int) -> Array:
    values = group.numbers(*path).astype(np.float64, copy=False)
    if values.ndim != 1:
        raise TypeError(f"{path[-1]} is not a single number")
    return values


def _xyz(group: Group, *path: str | int) -> Array:
    return np.stack([_scalars(group, *path, axis) for axis in "xyz"], axis=1)


def _stamps(arrived: Arrived) -> tuple[Array, str]:
    """Return the header times, shape (N,), s, NaN if missing or unset, and the frame."""
    group = arrived.group
    found, frame = np.full(group.rows.size, np.nan), ""
    for path in headers(group):
        frame = frame or str(group.first(*path, "frame_id"))
        stamp_s = _seconds(group, *path, "stamp")
        found = np.where(np.isnan(found) & (stamp_s > 0.0), stamp_s, found)
    return found, frame


def _seconds(group: Group, *path: str | int) -> Array:
    return _scalars(group, *path, "sec") + _scalars(group, *path, "nanosec") * 1e-9
