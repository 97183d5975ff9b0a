"""What the topics in use say, as arrays: one track per topic, in the order of time.

A track holds when its messages were received and stamped, and the part of them that is used. Messages come in groups
of equal form, so the parts do too; parts of one shape can be joined. What the tracks mean together is the business of
`tables`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cyclekit_adapters.rosbag.chain import Array, Transforms
from cyclekit_adapters.rosbag.payloads import Ints
from cyclekit_adapters.rosbag.roles import FLAG, JOINTS, POINT, POSE, POSES, TEXT

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.container import Arrived, Bag
    from cyclekit_adapters.rosbag.decode import Group
    from cyclekit_adapters.rosbag.roles import Factor, Roles

_BACK_S = 1.0  # a header clock that jumps back by more than this is no clock


@dataclass(frozen=True)
class Joints:
    """N messages about the same joints: names (J), angles (N, A) and speeds (N, S); a driver may leave out either."""

    names: tuple[str, ...]
    angles: Array
    speeds: Array


Value = Array | Joints | list[str] | npt.NDArray[np.bool_]


@dataclass
class Track:
    """The messages of one topic.

    Attributes:
        receive_s, stamp_s: When received and stamped (NaN: no header or an unset one), shape (N,), s.
        index: Index within the topic, shape (N,).
        parts: Rows of this track, shape (M,), and what those messages say: places (M, 3), places of several
            (M, K, 3), numbers (M,), flags (M,), texts, or joints.
    """

    receive_s: Array = field(default_factory=lambda: np.zeros(0))
    stamp_s: Array = field(default_factory=lambda: np.zeros(0))
    index: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    parts: list[tuple[Ints, Value]] = field(default_factory=list)

    def joined(self) -> Array:
        """Return places or numbers of all messages in order, shape (N, 3) or (N,)."""
        rows = np.concatenate([rows for rows, _ in self.parts])
        values = np.concatenate([np.asarray(value, dtype=np.float64) for _, value in self.parts])
        ordered = np.empty_like(values)
        ordered[rows] = values
        return ordered

    def each(self) -> list[object]:
        """Return what each message says, in order: a text, a flag, or places of several, shape (K, 3)."""
        found: list[object] = [None] * self.index.size
        for rows, value in self.parts:
            items: Sequence[object] = value if isinstance(value, list) else list(np.asarray(value))
            for row, item in zip(rows.tolist(), items, strict=True):
                found[row] = item
        return found


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
        return track.stamp_s if self.stamped else track.receive_s


@dataclass
class _Piece:
    number: Ints
    receive_ns: Ints
    stamp_s: Array
    value: Value


def collect(bag: Bag, roles: Roles) -> Contents:
    """Decode every topic in use."""
    contents = Contents({}, Transforms())
    factors = {factor.topic: factor for factor in roles.scaling}
    pieces: dict[str, list[_Piece]] = {}
    for arrived in bag.messages(roles.topics()):
        topic, group = arrived.topic, arrived.group
        try:
            if topic in roles.transforms:
                contents.transforms.add(group)
                continue
            value = _value(arrived.kind, group, factors.get(topic))
            stamp_s = _stamps(contents, arrived)
        except (AttributeError, TypeError, ValueError, IndexError) as error:  # not the definition that we know
            said = f"{topic}: message has other fields ({error})"
            bag.undecodable += [(topic, number, said) for number in arrived.number.tolist()]
            continue
        if value is not None:
            pieces.setdefault(topic, []).append(_Piece(arrived.number, group.receive_ns, stamp_s, value))
    contents.tracks = {topic: _track(parts, bag.order(topic)) for topic, parts in pieces.items()}
    contents.transforms.finish()
    contents.stamped = _all_stamped(contents)
    contents.warnings += bag.warnings
    if lost := bag.set_aside():
        contents.warnings.append(f"{len(lost)} parts of the bag are damaged and are left out: {lost[0]}")
    if bag.undecodable:
        contents.warnings.append(f"{len(bag.undecodable)} messages cannot be decoded and are left out")
    return contents


def _track(pieces: list[_Piece], order: Ints) -> Track:
    """Put the pieces of one topic into the order of time; `order` is the index of each arrival number."""
    index = [order[piece.number] for piece in pieces]
    known = np.concatenate(index)
    by_time = np.argsort(known)
    ends = np.cumsum([part.size for part in index])
    row = np.empty(known.size, np.int64)
    row[by_time] = np.arange(known.size)
    return Track(
        receive_s=np.concatenate([piece.receive_ns for piece in pieces])[by_time] * 1e-9,
        stamp_s=np.concatenate([piece.stamp_s for piece in pieces])[by_time],
        index=known[by_time],
        parts=[(rows, piece.value) for rows, piece in zip(np.split(row, ends[:-1]), pieces, strict=True)],
    )


def _value(kind: str, group: Group, factor: Factor | None) -> Value | None:
    """Return the part of the messages that is used, None if they have no such part."""
    if factor is not None:
        return _scalars(group, factor.attribute) if hasattr(group.message, factor.attribute) else None
    if kind == JOINTS:
        names = tuple(map(str, group.first("name")))
        angles, speeds = (group.numbers(part).astype(np.float64) for part in ("position", "velocity"))
        return Joints(names, angles, speeds)
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
    return None


def _scalars(group: Group, *path: str | int) -> Array:
    values = group.numbers(*path).astype(np.float64)
    if values.ndim != 1:
        raise TypeError(f"{path[-1]} is no single number")
    return values


def _xyz(group: Group, *path: str | int) -> Array:
    return np.stack([_scalars(group, *path, axis) for axis in "xyz"], axis=1)


def _stamps(contents: Contents, arrived: Arrived) -> Array:
    group = arrived.group
    header = getattr(group.message, "header", None)
    if header is None:
        return np.full(group.rows.size, np.nan)
    contents.frames.setdefault(arrived.topic, header.frame_id)
    stamp_s = stamps(group, "header")
    return np.where(stamp_s > 0.0, stamp_s, np.nan)


def stamps(group: Group, *path: str | int) -> Array:
    """Return the times in the headers at `path`, shape (N,), s."""
    return _scalars(group, *path, "stamp", "sec") + _scalars(group, *path, "stamp", "nanosec") * 1e-9


def _all_stamped(contents: Contents) -> bool:
    """Tell whether every message in use has a header time, and those times go forward."""
    tracks = [track.stamp_s for track in contents.tracks.values()]
    tracks += [link.stamp_s for link in contents.transforms.links.values() if link.stamp_s.size > 1]
    if not tracks or any(np.isnan(stamp_s).any() for stamp_s in tracks):
        return False
    if any((np.diff(stamp_s) < -_BACK_S).any() for stamp_s in tracks):
        contents.warnings.append("the header times jump back: the moments of recording are used instead")
        return False
    return True
