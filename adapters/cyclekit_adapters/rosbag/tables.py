"""Tables of robot and events from the messages of a bag.

Topics have different rates. The robot's table uses the times of its TCP pose (of its joints, if there is none). A
position comes from the nearest message; a scaling or a program state holds until the next message. Values that were not
recorded, or not yet, stay unknown.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import polars as pl

from cyclekit.schema import EVENTS, ROBOT, conform, joints_from_base
from cyclekit.text.numbers import given
from cyclekit_adapters.rosbag.chain import pose_along, reference_link, transformed
from cyclekit_adapters.rosbag.envelope import middle
from cyclekit_adapters.rosbag.frames import unknown
from cyclekit_adapters.rosbag.modes import ROBOT_MODE, RUNNING
from cyclekit_adapters.rosbag.tracks import JointStates
from cyclekit_adapters.rosbag.transforms import Array

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.frames import Frames
    from cyclekit_adapters.rosbag.payloads import Ints
    from cyclekit_adapters.rosbag.roles import Factor, Roles
    from cyclekit_adapters.rosbag.tracks import Contents

_NEAR_PERIODS = 2.0  # maximum time to the nearest position, in periods of its topic
_NEAR_S = 0.1  # the same, s, for a single message without period
_SLACK = 1e-3
_STATES = ("stopped", "playing")
_UNKNOWN = -1
_FINGER = re.compile(r"finger|gripper|knuckle|robotiq", re.IGNORECASE)  # positions in m, or not of the arm


@dataclass(frozen=True)
class _Rows:
    """Rows of a table under construction, one per time.

    Attributes:
        t_s: Times, ascending, shape (T,), s; `index`: index of the message, shape (T,).
        numbers: Values, shape (T, C); `columns`: their C names.
    """

    t_s: Array
    index: Ints
    numbers: Array
    columns: list[str]

    def series(self) -> list[pl.Series]:
        """Return the numbers as columns, NaN as null."""
        found = zip(self.columns, self.numbers.T, strict=True)
        return [pl.Series(name, np.ascontiguousarray(values), nan_to_null=True) for name, values in found]


def robot_table(contents: Contents, roles: Roles, frames: Frames) -> pl.DataFrame | None:
    """Return table ROBOT; None if the bag holds no robot position."""
    rows = _tcp(contents, roles, frames)
    joints = _joints(contents, str(roles.joints)) if roles.joints in contents.tracks else None
    numbers = rows.series() if rows is not None else []
    if rows is None:
        rows, joints = joints, None
        contents.rows_of["robot"] = str(roles.joints)
        numbers = rows.series() if rows is not None else []
    if rows is None:
        return None
    if joints is not None:
        numbers += _nearest(joints, rows.t_s).series()
    state = _state(contents, roles, rows.t_s)
    scaling = _scaling(contents, roles, rows.t_s, state)
    numbers += [pl.Series("scaling", scaling, nan_to_null=True)] if scaling is not None else []
    numbers += _digital(contents, roles, rows.t_s)
    table = pl.DataFrame([pl.Series("t_s", rows.t_s), pl.Series("source_row", rows.index), *numbers])
    if state is not None:
        words = pl.Series("state", state).replace_strict(dict(enumerate(_STATES)), default=None, return_dtype=pl.String)
        table = table.with_columns(words)
    return conform(table, ROBOT)


def _tcp(contents: Contents, roles: Roles, frames: Frames) -> _Rows | None:
    if roles.tcp in contents.tracks:
        topic = str(roles.tcp)
        track = contents.tracks[topic]
        contents.rows_of["robot"] = topic
        place = transformed(frames.tcp, contents.at(topic), track.joined()) if frames.tcp else track.joined()
        return _placed(contents.at(topic), track.index, place)
    if not frames.tool:
        return None
    link = reference_link(frames.tool)
    place, _ = pose_along(frames.tool, link.times)
    if lost := unknown(place):
        contents.warnings.append(f"the TCP is unknown at {lost} times: a transform was not published for some time")
    contents.rows_of["robot"] = link.topic
    return _placed(link.times, link.index, place)


def _placed(times: Array, index: Ints, place: Array) -> _Rows:
    kept = in_order(times)
    return _Rows(times[kept], index[kept], place[kept], [f"tcp_{axis}_m" for axis in "xyz"])


def in_order(times: Array) -> Ints | slice:
    """Return the rows in ascending order of time, the first one of each time; all if already ascending."""
    if (times[1:] > times[:-1]).all() and np.isfinite(times).all():
        return slice(None)
    order = np.argsort(times, kind="stable")
    order = order[np.isfinite(times[order])]
    first = np.append(True, times[order][1:] > times[order][:-1])[: order.size]
    kept: Ints = order[first]
    return kept


def _joints(contents: Contents, topic: str) -> _Rows | None:
    """Return joint angles by name; messages of other joints (a gripper on the same topic) are left out."""
    track = contents.tracks[topic]
    parts = [(part.rows, part.value) for part in track.parts if isinstance(part.value, JointStates)]
    written: Counter[tuple[str, ...]] = Counter()
    for rows, values in parts:
        written[values.names] += rows.size
    written.pop((), None)
    if not written:
        return None
    order = max(written, key=lambda names: (written[names] * len(names), names))
    ours = [part for part in parts if len(part[1].names) == len(order) and set(part[1].names) == set(order)]
    rows = np.concatenate([rows for rows, _ in ours])
    if fingers := [name for name in order if _FINGER.search(name)]:
        contents.warnings.append(f"joints of a gripper are left out: {', '.join(fingers)}")
        order = tuple(name for name in order if name not in fingers)
    if not order:
        return None
    order = tuple(order[i] for i in joints_from_base(order))  # ROS sorts joints by name or by chance
    count = len(order)
    numbers, done = np.empty((rows.size, 2 * count)), 0
    for part, values in ours:
        here = slice(done, done := done + part.size)
        numbers[here, :count] = _ordered(values.angles, values.names, order)
        numbers[here, count:] = _ordered(values.speeds, values.names, order)
    if others := track.index.size - rows.size:
        contents.warnings.append(f"{others} messages of {topic} describe other joints and are left out")
    contents.joint_names = order
    times = contents.at(topic)[rows]
    kept = in_order(times)
    columns = [*(f"q{i}_rad" for i in range(count)), *(f"qd{i}_rad_s" for i in range(count))]
    return _Rows(times[kept], track.index[rows][kept], numbers[kept], columns)


def _ordered(values: Array, names: tuple[str, ...], order: tuple[str, ...]) -> Array:
    """Return the columns in `order`, shape (N, J); NaN if the driver omitted them."""
    if values.shape[1] != len(names):
        return np.full((len(values), len(order)), np.nan)
    return values if names == order else values[:, [names.index(name) for name in order]]


def _nearest(rows: _Rows, at_s: Array) -> _Rows:
    """Return the nearest row at each time; NaN if none is close enough."""
    near = _NEAR_PERIODS * middle(np.diff(rows.t_s)) if rows.t_s.size > 1 else _NEAR_S
    after = np.clip(np.searchsorted(rows.t_s, at_s), 0, rows.t_s.size - 1)
    before = np.maximum(after - 1, 0)
    chosen = np.where(at_s - rows.t_s[before] <= rows.t_s[after] - at_s, before, after)
    numbers = rows.numbers[chosen]
    numbers[np.abs(rows.t_s[chosen] - at_s) > near] = np.nan
    return _Rows(at_s, rows.index[chosen], numbers, rows.columns)


def _held(times: Array, at_s: Array) -> Ints:
    """Return for each time the index of the last row before it, shape (T,); -1 before the first."""
    order = np.argsort(times, kind="stable")
    order = order[np.isfinite(times[order])]
    place = np.searchsorted(times[order], at_s, side="right") - 1
    return np.where(place >= 0, np.append(order, _UNKNOWN)[place], _UNKNOWN)


def _state(contents: Contents, roles: Roles, at_s: Array) -> npt.NDArray[np.int8] | None:
    """Return the program's state at each time as an index of `_STATES`, -1 = unknown; None without a source.

    In a mode in which no program moves the robot, the program counts as stopped. Modes and states hold until the next
    one.
    """
    state: npt.NDArray[np.int8] | None = None
    if roles.running in contents.tracks:
        topic = str(roles.running)
        row = _held(contents.at(topic), at_s)
        running = (contents.tracks[topic].joined() > 0.5).astype(np.int8)
        state = np.where(row >= 0, running[row], _UNKNOWN).astype(np.int8)
    for topic in roles.modes:
        if topic in contents.tracks and contents.kinds[topic] == ROBOT_MODE:
            row = _held(contents.at(topic), at_s)
            still = np.array([mode != RUNNING for mode in contents.tracks[topic].each()])
            state = np.full(at_s.size, _UNKNOWN, np.int8) if state is None else state
            state[(row >= 0) & still[row]] = _STATES.index("stopped")
    return state


def _digital(contents: Contents, roles: Roles, at_s: Array) -> list[pl.Series]:
    """Return digital inputs and outputs at each time as bit fields; unknown before the first message."""
    if roles.inputs not in contents.tracks:
        return []
    row, values = _held(contents.at(roles.inputs), at_s), contents.tracks[roles.inputs].joined()
    bits = np.where(row[:, None] >= 0, values[row], np.nan)
    names = ("digital_in_bits", "digital_out_bits")
    return [pl.Series(name, bits[:, k], nan_to_null=True).cast(pl.Int64) for k, name in enumerate(names)]


def _factors(contents: Contents, roles: Roles) -> list[Factor]:
    """Return the recorded factors; those used by the controller take precedence over commands."""
    found = [factor for factor in roles.scaling if factor.topic in contents.tracks]
    silent = {one.topic for one in found if np.isnan(contents.tracks[one.topic].joined()).all()}
    found = [factor for factor in found if factor.topic not in silent]
    used = [factor for factor in found if factor.family == "controller"]
    return used or found


def _scaling(contents: Contents, roles: Roles, at_s: Array, state: npt.NDArray[np.int8] | None) -> Array | None:
    """Return the product of all factors; NaN before the first message and while the program is stopped."""
    factors = _factors(contents, roles)
    if not factors:
        maybe = next(iter(roles.maybe_scaling), None)
        cure = f'; if {maybe} is it, give [sources.map] scaling = "{maybe}" and scaling_max = 1 or 100' if maybe else ""
        contents.warnings.append(f"no speed scaling in the bag: it is unknown{cure}")
        return None
    if any(factor.family == "command" for factor in factors):
        contents.warnings.append("the speed scaling is the commanded one: what the robot executed was not recorded")
    known = []
    for factor in factors:
        values = contents.tracks[factor.topic].joined() / factor.full
        row = _held(contents.at(factor.topic), at_s)
        if factor.family not in ("cnr", "command") and (values > 1.0 + _SLACK).any():
            contents.warnings.append(f"{factor.topic} exceeds {given(factor.full)} in some messages: unknown there")
        known.append(np.where(row >= 0, _clamped(values, factor)[row], np.nan))
    if all(factor.family == "cnr" for factor in factors) and len(factors) > 1:
        # An override without a message so far does not slow down: the controllers start from 100 percent.
        spoken = ~np.all([np.isnan(values) for values in known], axis=0)
        known = [np.where(spoken & np.isnan(values), 1.0, values) for values in known]
    product: Array = np.prod(known, axis=0)
    if state is not None:
        product[state == _STATES.index("stopped")] = np.nan
    return product


def _clamped(value: Array, factor: Factor) -> Array:
    """Return values clamped as the controllers do; a state outside of its range is invalid and becomes NaN."""
    clipped: Array = np.clip(value, 0.0, 1.0)
    if factor.family not in ("cnr", "command"):
        clipped[~((value >= 0.0) & (value <= 1.0 + _SLACK))] = np.nan
    return clipped


def events_table(contents: Contents, roles: Roles) -> pl.DataFrame:
    """Return table EVENTS: every text, and every change of a flag."""
    rows: list[tuple[float, str, str, int]] = []
    for topic in roles.events:
        if topic not in contents.tracks:
            continue
        track, times = contents.tracks[topic], contents.at(topic)
        values = track.each()
        last: object = None
        for row in np.argsort(times, kind="stable").tolist():
            value = values[row]
            if isinstance(value, bool | np.bool_):
                if value != last:
                    rows.append((float(times[row]), topic, "true" if value else "false", int(track.index[row])))
                last = value
            elif topic not in roles.modes or value != last:  # a latched mode is sent again to each new subscriber
                rows.append((float(times[row]), topic, str(value), int(track.index[row])))
                last = value
    schema = {name: column.dtype for name, column in EVENTS.items()}
    return conform(pl.DataFrame(rows, schema=schema, orient="row").sort("t_s", maintain_order=True), EVENTS)
