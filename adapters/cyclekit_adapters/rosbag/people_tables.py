"""Tables of people and of their joints from the messages of a bag.

In an array without ids, the index is the person; trackers name theirs. Positions are transformed to the robot's base if
the bag holds the transforms; `frames` knows the chains.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import polars as pl

from cyclekit.schema import PEOPLE, SKELETONS, Column, conform
from cyclekit_adapters.rosbag.chain import pose_along
from cyclekit_adapters.rosbag.frames import unknown
from cyclekit_adapters.rosbag.people import Persons
from cyclekit_adapters.rosbag.transforms import Array

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit_adapters.rosbag.frames import Frames
    from cyclekit_adapters.rosbag.roles import Roles
    from cyclekit_adapters.rosbag.tracks import Contents, MessagePart

Columns = dict[str, list[npt.NDArray[np.generic]]]


def people_table(contents: Contents, roles: Roles, frames: Frames) -> pl.DataFrame:
    """Return table PEOPLE; in an array without ids the index is the person, and missing entries are people not seen."""
    columns: Columns = {}
    for topic in roles.people:
        parts = contents.tracks[topic].parts if topic in contents.tracks else []
        prefix = f"{topic} " if len(roles.people) > 1 else ""
        if any(isinstance(part.value, Persons) for part in parts):
            _add_named(contents, frames, topic, prefix, columns)
        elif parts:
            _add_numbered(contents, frames, topic, prefix, columns)
    _add_bodies(contents, roles, frames, columns)
    topics = contents.rows_of["people"] = _topics(contents, roles, frames)
    if ", " in topics:
        contents.warnings.append(
            f"people are on several topics ({topics}): if they are the same people, name one as `body`"
        )
    return _table(columns, PEOPLE)


def skeletons_table(contents: Contents, roles: Roles, frames: Frames) -> pl.DataFrame | None:
    """Return table SKELETONS; None if the bag has no joints of people."""
    columns: Columns = {}
    for topic in roles.people:
        prefix = f"{topic} " if len(roles.people) > 1 else ""
        for part, value in _named(contents, topic):
            if value.bodies is not None and value.bodies.joints is not None:
                _add(contents, frames, topic, prefix, part, value.bodies, columns)
    _add_bodies(contents, roles, frames, columns, joints=True)
    return _table(columns, SKELETONS) if columns else None


def _named(contents: Contents, topic: str) -> Iterator[tuple[MessagePart, Persons]]:
    for part in contents.tracks[topic].parts if topic in contents.tracks else []:
        if isinstance(part.value, Persons):
            yield part, part.value


def _add_numbered(contents: Contents, frames: Frames, topic: str, prefix: str, columns: Columns) -> None:
    """Add the people of a topic of positions, by index in the array; a topic without any gets one person never seen."""
    track, times = contents.tracks[topic], contents.at(topic)
    seen = [(part, _several(part.value)) for part in track.parts if isinstance(part.value, np.ndarray)]
    most = max([1, *(places.shape[1] for _, places in seen)])
    if most > 1:
        contents.warnings.append(f"{topic} holds up to {most} positions without ids: each index is one person")
    place: Array = np.full((track.index.size, most, 3), np.nan)
    lost = nobody = 0
    for part, places in seen:
        given = _of_somebody(places)
        nobody += unknown(given) - unknown(places)
        placed = frames.placed(part.frame, times[part.rows], given)
        lost += unknown(placed) - unknown(given)
        place[part.rows, : given.shape[1]] = placed
    _say_lost(contents, topic, lost)
    _say_nobody(contents, topic, nobody)
    names = np.array([f"{prefix}{person}" for person in range(most)])
    _append(columns, "t_s", np.repeat(times, most))
    _append(columns, "person", np.tile(names, track.index.size))
    _append(columns, "source_row", np.repeat(track.index, most))
    _append(columns, "place", place.reshape(-1, 3))


def _add_named(contents: Contents, frames: Frames, topic: str, prefix: str, columns: Columns) -> None:
    """Add the people of a topic whose messages name them; a person without a name is absent."""
    hidden, why, lost, nobody = 0, "", 0, 0
    if all(not value.names.shape[1] for _, value in _named(contents, topic)):
        _add_nobody(contents, topic, columns)
        return
    for part, value in _named(contents, topic):
        if value.joints is None:
            places = _of_somebody(value.places)
            nobody += int((np.isnan(places[..., 0]) & ~np.isnan(value.places[..., 0]) & (value.names != "")).sum())
            value = replace(value, places=places)
        before, after = _add(contents, frames, topic, prefix, part, value, columns)
        lost += after - before
        if before:
            hidden, why = hidden + before, value.reason or "no position"
    _say_lost(contents, topic, lost)
    _say_nobody(contents, topic, nobody)
    hidden -= nobody
    if hidden:
        contents.warnings.append(f"{hidden} positions on {topic} are unknown: {why}")


def _add_nobody(contents: Contents, topic: str, columns: Columns) -> None:
    """Add a topic without a person in any message: its times, no positions."""
    track = contents.tracks[topic]
    _append(columns, "t_s", contents.at(topic))
    _append(columns, "person", np.full(track.index.size, ""))
    _append(columns, "source_row", track.index)
    _append(columns, "place", np.full((track.index.size, 3), np.nan))


def _add(
    contents: Contents, frames: Frames, topic: str, prefix: str, part: MessagePart, value: Persons, columns: Columns
) -> tuple[int, int]:
    """Add the named people in one part of a topic; return the numbers of unknown positions before and after."""
    times, index = contents.at(topic), contents.tracks[topic].index
    message, entry = np.nonzero(value.names != "")
    given = value.places[message, entry]
    place = given.copy()
    own = [frame or part.frame for frame in value.frames] or [part.frame] * value.names.shape[1]
    for frame in sorted(set(own)):
        mine = np.array([name == frame for name in own], bool)[entry]
        place[mine] = frames.placed(frame, times[part.rows[message[mine]]], given[mine])
    rows = part.rows[message]
    _append(columns, "t_s", times[rows])
    _append(columns, "person", np.char.add(prefix, value.names[message, entry]))
    _append(columns, "source_row", index[rows])
    _append(columns, "place", place)
    if value.joints is not None:
        _append(columns, "joint", value.joints[message, entry])
    return unknown(given), unknown(place)


def _add_bodies(contents: Contents, roles: Roles, frames: Frames, columns: Columns, *, joints: bool = False) -> None:
    """Add the bodies among the transforms, or their joints, each at the times of its track."""
    for body in frames.bodies:
        if bool(body.joint) != joints or not body.chain:
            continue
        times, first = np.unique(body.link.times, return_index=True)
        place, _ = pose_along(body.chain, times)
        if not joints:
            _say_lost(contents, f"body {body.person!r}", unknown(place))
        _append(columns, "t_s", times)
        _append(columns, "person", np.full(times.size, f"transforms {body.person}" if roles.people else body.person))
        _append(columns, "source_row", body.link.index[first])
        _append(columns, "place", place)
        if joints:
            _append(columns, "joint", np.full(times.size, body.joint))


def _of_somebody(places: Array) -> Array:
    """Return positions, shape (..., 3), NaN where they mean no person; applied before any transform."""
    nobody = (places == 0.0).all(axis=-1) | (places == -1.0).all(axis=-1)
    return np.where(nobody[..., None], np.nan, places)


def _say_nobody(contents: Contents, topic: str, count: int) -> None:
    if count:
        contents.warnings.append(
            f"{count} positions on {topic} are exactly 0, 0, 0 or -1, -1, -1: this means no person seen; unknown there"
        )


def _say_lost(contents: Contents, what: str, lost: int) -> None:
    if lost:
        contents.warnings.append(
            f"{lost} positions of {what} are unknown: a transform to the robot's base was not published for some time"
        )


def _topics(contents: Contents, roles: Roles, frames: Frames) -> str:
    """Return the topics of the rows; with several topics, each person's name starts with its topic."""
    topics = [topic for topic in roles.people if topic in contents.tracks]
    return ", ".join(dict.fromkeys([*topics, *(body.link.topic for body in frames.bodies)]))


def _append(columns: Columns, name: str, values: npt.NDArray[np.generic]) -> None:
    columns.setdefault(name, []).append(values)


def _several(value: npt.NDArray[np.generic]) -> Array:
    """Return positions as (N, K, 3), also for a single person."""
    places = np.asarray(value, dtype=np.float64)
    return places[:, None, :] if places.ndim == 2 else places


def _table(columns: Columns, table: Mapping[str, Column]) -> pl.DataFrame:
    schema = pl.Schema({name: column.dtype for name, column in table.items()})
    if not columns:
        return conform(pl.DataFrame(schema=schema), table)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    place = joined.pop("place")
    frame = pl.DataFrame({**joined, **{f"{axis}_m": place[:, i] for i, axis in enumerate("xyz")}}).fill_nan(None)
    return conform(frame.select(list(schema)).cast(schema).sort("t_s", "person", maintain_order=True), table)
