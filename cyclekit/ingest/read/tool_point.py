"""TCP of a log that holds only joint angles, if the cell file gives the arm."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.config.arms import ARMS, MODELS, Arm, ArmLink, points_in_base
from cyclekit.schema import is_joint, joints_from_base

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cyclekit.adapter import Recording
    from cyclekit.config import Robot

TCP = ("tcp_x_m", "tcp_y_m", "tcp_z_m")
"""Computed columns."""


def with_tool_point(parts: Iterable[Recording], robot: Robot | None) -> Iterator[Recording]:
    """Yield the parts of a log, with the TCP computed by forward kinematics if it was not logged.

    Args:
        parts: Parts of one log.
        robot: The arm; None = compute nothing.
    """
    for part in parts:
        yield part if robot is None else _computed(part, robot)


def _computed(part: Recording, robot: Robot) -> Recording:
    frame = part.robot
    if frame is None or any(name in frame.columns and frame[name].count() for name in TCP):
        return part
    names = sorted((n for n in frame.columns if is_joint(n) and n.endswith("_rad")), key=lambda n: int(n[1:-4]))
    arm = _arm(robot)
    if not names:
        return part
    if len(names) != len(arm.links):
        warning = f"[robot] is an arm of {len(arm.links)} joints and the log holds {len(names)}: no TCP is computed"
        return replace(part, warnings=(*part.warnings, warning))
    order = joints_from_base(part.joint_names) if len(part.joint_names) == len(names) else range(len(names))
    angles = np.column_stack([frame[names[i]].cast(pl.Float64).to_numpy() for i in order])
    turned = arm in ARMS and part.facts.get("base_frame", "").rpartition("/")[2] == "base_link"  # as a UR's in ROS
    points, turn = points_in_base(arm, angles, turned=turned)
    tcp = points[:, -1] + turn @ np.asarray(robot.tool_m)
    columns = [pl.Series(name, tcp[:, axis], nan_to_null=True) for axis, name in enumerate(TCP)]
    at = "the flange" if robot.tool_m == (0.0, 0.0, 0.0) else "the tool of the cell file"
    warning = f"the TCP was not logged: computed for {at} from the joint angles ({arm.name})"
    return replace(part, robot=frame.with_columns(columns), warnings=(*part.warnings, warning))


def _arm(robot: Robot) -> Arm:
    if robot.model is not None:
        return MODELS[robot.model]
    links = (ArmLink(d, a, float(np.deg2rad(alpha)), float(np.deg2rad(theta))) for d, a, alpha, theta in robot.dh)
    return Arm("dh of the cell file", tuple(links))
