"""The tables of robot and events out of the messages of a bag.

Topics come at rates of their own. The robot's table stands on the time of its TCP pose (of its joints, where there
is none): a position is taken from the nearest message, a scaling or a program state holds until the next message.
What was not recorded, or not yet, stays unknown.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import polars as pl

from cyclekit.schema import EVENTS, ROBOT, conform
from cyclekit_adapters.rosbag.chain import followed, leading
from cyclekit_adapters.rosbag.frames import unknown
from cyclekit_adapters.rosbag.modes import ROBOT_MODE, RUNNING
from cyclekit_adapters.rosbag.tracks import Joints
from cyclekit_adapters.rosbag.transforms import Array

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.frames import Frames
    from cyclekit_adapters.rosbag.roles import Factor, Roles
    from cyclekit_adapters.rosbag.tracks import Contents

_NEAR_PERIODS = 2.0  # a position further away in time than this many of its periods is unknown
_SLACK = 1e-3


def robot_table(contents: Contents, roles: Roles, frames: Frames) -> pl.DataFrame | None:
    """Return table ROBOT, None where the bag says nothing of where the robot is."""
    table = _tcp(contents, roles, frames)
    joints = _joints(contents, roles.joints) if roles.joints in contents.tracks else None
    if table is None:
        table = joints
        contents.rows_of["robot"] = str(roles.joints)
    elif joints is not None:
        table = _nearest(table, joints.drop("source_row"))
    if table is None:
        return None
    if roles.running in contents.tracks:
        running = _series(contents, str(roles.running)).select(
            "t_s", state=pl.when(pl.col("value") > 0.5).then(pl.lit("playing")).otherwise(pl.lit("stopped"))
        )
        table = table.join_asof(running, on="t_s", strategy="backward")
    table = _with_modes(contents, roles, table)
    table = _with_scaling(contents, roles, table)
    return conform(table, ROBOT)


def _tcp(contents: Contents, roles: Roles, frames: Frames) -> pl.DataFrame | None:
    if roles.tcp in contents.tracks:
        topic = str(roles.tcp)
        track = contents.tracks[topic]
        contents.rows_of["robot"] = topic
        return _in_order(_placed(contents.at(topic), track.joined(), track.index))
    if not frames.tool:
        return None
    link = leading(frames.tool)
    place, _ = followed(frames.tool, link.times)
    if lost := unknown(place):
        contents.warnings.append(f"the TCP is unknown at {lost} moments: a transform was not published for a while")
    contents.rows_of["robot"] = link.topic
    return _in_order(_placed(link.times, place, link.index))


def _placed(times: Array, place: Array, index: npt.NDArray[np.int64]) -> pl.DataFrame:
    columns = {f"tcp_{axis}_m": place[:, i] for i, axis in enumerate("xyz")}
    return pl.DataFrame({"t_s": times, "source_row": index, **columns})


def _in_order(table: pl.DataFrame) -> pl.DataFrame:
    """Sort by time and keep one row per instant; NaN becomes null."""
    return table.fill_nan(None).drop_nulls("t_s").unique("t_s", keep="first").sort("t_s")


def _joints(contents: Contents, topic: str | None) -> pl.DataFrame | None:
    """Return joint angles by name; messages of other joints (a gripper on the same topic) are left out."""
    track = contents.tracks[str(topic)]
    parts = [(part.rows, part.value) for part in track.parts if isinstance(part.value, Joints)]
    written: Counter[tuple[str, ...]] = Counter()
    for rows, said in parts:
        written[said.names] += rows.size
    written.pop((), None)
    if not written:
        return None
    order = max(written, key=lambda names: (written[names] * len(names), names))
    ours = [part for part in parts if len(part[1].names) == len(order) and set(part[1].names) == set(order)]
    rows = np.concatenate([rows for rows, _ in ours])
    angles = np.concatenate([_ordered(said.angles, said.names, order) for _, said in ours])
    speeds = np.concatenate([_ordered(said.speeds, said.names, order) for _, said in ours])
    if others := track.index.size - rows.size:
        contents.warnings.append(f"{others} messages of {topic} are about other joints and are left out")
    contents.joint_names = order
    by_time = np.argsort(rows)
    rows, angles, speeds = rows[by_time], angles[by_time], speeds[by_time]
    columns = {f"q{i}_rad": angles[:, i] for i in range(len(order))}
    columns |= {f"qd{i}_rad_s": speeds[:, i] for i in range(len(order))}
    times = contents.at(str(topic))[rows]
    return _in_order(pl.DataFrame({"t_s": times, "source_row": track.index[rows], **columns}))


def _ordered(values: Array, names: tuple[str, ...], order: tuple[str, ...]) -> Array:
    """Return the columns in `order`, shape (N, J); NaN where the driver left them out."""
    if values.shape[1] != len(order):
        return np.full((len(values), len(order)), np.nan)
    return values if names == order else values[:, [names.index(name) for name in order]]


def _nearest(table: pl.DataFrame, other: pl.DataFrame) -> pl.DataFrame:
    period = other["t_s"].diff().median()
    near = _NEAR_PERIODS * float(str(period)) if period is not None else 0.1
    return table.join_asof(other, on="t_s", strategy="nearest", tolerance=near)


def _series(contents: Contents, topic: str) -> pl.DataFrame:
    values = contents.tracks[topic].joined()
    series = pl.DataFrame({"t_s": contents.at(topic), "value": values}).fill_nan(None)
    return series.sort("t_s", maintain_order=True)


def _with_modes(contents: Contents, roles: Roles, table: pl.DataFrame) -> pl.DataFrame:
    """Mark the program as stopped while the robot is in a mode in which none moves it; a mode holds until the next."""
    for topic in roles.modes:
        if topic not in contents.tracks or contents.kinds[topic] != ROBOT_MODE:
            continue
        held = pl.DataFrame({"t_s": contents.at(topic), "_mode": [str(m) for m in contents.tracks[topic].each()]})
        table = table.join_asof(held.sort("t_s", maintain_order=True), on="t_s", strategy="backward")
        known = pl.col("state") if "state" in table.columns else pl.lit(None, pl.String())
        state = pl.when(pl.col("_mode") != RUNNING).then(pl.lit("stopped")).otherwise(known)
        table = table.with_columns(state=state).drop("_mode")
    return table


def _factors(contents: Contents, roles: Roles) -> list[Factor]:
    """Return the factors that were recorded; what the controller used beats what was commanded."""
    found = [factor for factor in roles.scaling if factor.topic in contents.tracks]
    silent = {one.topic for one in found if np.isnan(contents.tracks[one.topic].joined()).all()}
    found = [factor for factor in found if factor.topic not in silent]
    used = [factor for factor in found if factor.family == "controller"]
    return used or found


def _with_scaling(contents: Contents, roles: Roles, table: pl.DataFrame) -> pl.DataFrame:
    """Add the product of all factors in force; unknown before the first message and while the program is stopped."""
    factors = _factors(contents, roles)
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


def events_table(contents: Contents, roles: Roles) -> pl.DataFrame:
    """Return table EVENTS: every text, and every change of a flag."""
    rows: list[tuple[float, str, str, int]] = []
    for topic in roles.events:
        if topic not in contents.tracks:
            continue
        track, times = contents.tracks[topic], contents.at(topic)
        said = track.each()
        last: object = None
        for row in np.argsort(times, kind="stable").tolist():
            value = said[row]
            if isinstance(value, bool | np.bool_):
                if value != last:
                    rows.append((float(times[row]), topic, "true" if value else "false", int(track.index[row])))
                last = value
            elif topic not in roles.modes or value != last:  # a latched mode is said again to each listener
                rows.append((float(times[row]), topic, str(value), int(track.index[row])))
                last = value
    schema = {name: column.dtype for name, column in EVENTS.items()}
    return conform(pl.DataFrame(rows, schema=schema, orient="row").sort("t_s", maintain_order=True), EVENTS)
