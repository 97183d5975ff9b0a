"""The 3-D scene: robot, operator, trails, goals, places, and the line between the two in the scaling's colour.

Everything goes in by column. What is unknown at an instant is an empty list there, so that it vanishes from the scene
instead of standing still. Which views show it is the business of `layout`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from cyclekit import colours
from cyclekit.labels import place_labels
from cyclekit.replay.arm import joint_points, recognise_arm

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from cyclekit.dataset import Place
    from cyclekit.replay.execution import Execution

    Times = Callable[[NDArray[np.float64]], list[rr.TimeColumn]]

TRAIL_S = 4.0
BODY_M = 1.75
"""Height at which an operator is drawn; logs know one point of a person, not the size."""

_WAIST_M = 0.95
_SHOULDER_RADIUS_M = 0.18
_HEAD_RADIUS_M = 0.12


def log_scene(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    """Put the scene of one execution into `stream`.

    Returns:
        Instants written, over all entities.
    """
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_places(stream, "scene/places", run.places, colours.ROBOT)
    _log_places(stream, "scene/operator_places", run.human_places, colours.OPERATOR)
    rows = _log_robot(stream, run, times)
    rows += _log_operator(stream, run, times)
    return rows + _log_link(stream, run, times)


def floor_m(run: Execution) -> float:
    """Height of the floor under the operator's drawn feet, metres, base frame; 0 where no operator is known.

    The tracked point of a person is taken for the waist, unless that would put the floor above the robot's base.
    """
    heights = run.human_m[np.isfinite(run.human_m[:, 2]), 2]
    return min(0.0, float(np.median(heights)) - _WAIST_M) if len(heights) else 0.0


def _log_places(stream: rr.RecordingStream, path: str, places: Mapping[str, Place], colour: str) -> None:
    if not places:
        return
    centres = [place.xyz_m for place in places.values()]
    stream.log(
        path,
        rr.Points3D(centres, radii=0.04, colors=[_rgb(colour)] * len(places)),
        static=True,
    )
    labels = place_labels(places)
    at = [(x, y, z - 0.06) for x, y, z in (label.xyz_m for label in labels)]
    words = [label.text for label in labels]
    tags = rr.Points3D(at, radii=0.001, colors=[_rgb(colour)] * len(at), labels=words, show_labels=True)
    stream.log(f"{path}/names", tags, static=True)


def _log_robot(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    known = np.isfinite(run.robot_m).all(axis=1)
    if not known.any():
        return 0
    paint = colours.scaling_rgb(run.scaling)
    _points(stream, "scene/robot/tool", times(run.t_s), run.robot_m, 0.055, paint)
    _trail(stream, "scene/robot/trail", times, run.t_s, run.robot_m, paint, 0.012)
    _goals(stream, "scene/robot/goal", run.t_s, run.robot_goal_m, times, colours.ROBOT)
    stream.log("scene/robot/path", _path(run.robot_m, colours.UNKNOWN), static=True)
    return int(known.sum()) + _log_arm(stream, run, times)


def _log_arm(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    """Draw the links where the joint angles and the logged tool point prove which arm it is."""
    angles = run.joints.six if run.joints else None
    if run.joints is None or angles is None:
        return 0
    fit = recognise_arm(angles, run.joints.tcp_m)
    if fit is None:
        return 0
    known = np.isfinite(angles).all(axis=1)
    points, turn = joint_points(fit.arm, angles[known])
    tool = points[:, -1] + np.einsum("tij,j->ti", turn, fit.tool_m)
    strips = np.concatenate([points, tool[:, None]], axis=1).astype(np.float32)
    at = times(run.joints.t_s[known])
    one = [1] * len(strips)
    stream.log("scene/robot/arm", rr.LineStrips3D.from_fields(colors=[_rgb("#aeb8c4")], radii=[0.05]), static=True)
    stream.send_columns("scene/robot/arm", at, rr.LineStrips3D.columns(strips=list(strips)).partition(one))
    joints = strips[:, :-1].reshape(-1, 3)
    stream.log("scene/robot/joints", rr.Points3D.from_fields(colors=[_rgb("#56626f")], radii=[0.065]), static=True)
    counts = [strips.shape[1] - 1] * len(strips)
    stream.send_columns("scene/robot/joints", at, rr.Points3D.columns(positions=joints).partition(counts))
    return len(strips)


def _log_operator(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    known = np.isfinite(run.human_m).all(axis=1)
    if not known.any():
        return 0
    feet = floor_m(run)
    counts = known.astype(int).tolist()
    at = times(run.t_s)
    seen = run.human_m[known]
    base = np.column_stack([seen[:, :2], np.full(len(seen), feet + _SHOULDER_RADIUS_M)])
    length = BODY_M - 2 * _SHOULDER_RADIUS_M - 2 * _HEAD_RADIUS_M
    green = _rgb(colours.OPERATOR)
    body = rr.Capsules3D.from_fields(lengths=[length], radii=[_SHOULDER_RADIUS_M], colors=[green], fill_mode="solid")
    stream.log("scene/operator/body", body, static=True)
    stream.send_columns("scene/operator/body", at, rr.Capsules3D.columns(translations=base).partition(counts))
    top = base + np.array([0.0, 0.0, length + _SHOULDER_RADIUS_M + _HEAD_RADIUS_M])
    head = rr.Points3D.from_fields(radii=[_HEAD_RADIUS_M], colors=[green])
    stream.log("scene/operator/head", head, static=True)
    stream.send_columns("scene/operator/head", at, rr.Points3D.columns(positions=top).partition(counts))
    ground = run.human_m.copy()
    ground[:, 2] = feet + 0.01
    paint = np.tile(np.array(green, dtype=np.uint8), (len(ground), 1))
    _trail(stream, "scene/operator/trail", times, run.t_s, ground, paint, 0.02)
    goal = run.human_goal_m.copy()
    goal[:, 2] = feet + 0.01
    _goals(stream, "scene/operator/goal", run.t_s, goal, times, colours.OPERATOR)
    return int(known.sum())


def _log_link(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    """The line from tool to operator: how far, and in the colour of the scaling then in force."""
    distance = run.distance_m
    known = np.isfinite(distance)
    if not known.any():
        return 0
    ends = np.stack([run.robot_m[known], run.human_m[known]], axis=1).astype(np.float32)
    labels = [_link_label(d, s) for d, s in zip(distance[known], run.scaling[known], strict=True)]
    counts = known.astype(int).tolist()
    columns = rr.LineStrips3D.columns(strips=list(ends), colors=_pack(colours.scaling_rgb(run.scaling[known])))
    stream.log("scene/distance", rr.LineStrips3D.from_fields(radii=[0.016]), static=True)
    stream.send_columns("scene/distance", times(run.t_s), columns.partition(counts))
    text = rr.Points3D.columns(positions=ends.mean(axis=1), labels=labels)
    ink = rr.Points3D.from_fields(radii=[0.001], colors=[_rgb("#ffffff")], show_labels=True)
    stream.log("scene/distance/text", ink, static=True)
    stream.send_columns("scene/distance/text", times(run.t_s), text.partition(counts))
    return int(known.sum())


def _link_label(distance_m: float, scaling: float) -> str:
    if np.isnan(scaling):
        return f"{distance_m:.2f} m"
    return f"{distance_m:.2f} m: " + ("robot halted" if scaling < 0.02 else f"robot at {100 * scaling:.0f} % speed")


def _points(
    stream: rr.RecordingStream,
    path: str,
    at: list[rr.TimeColumn],
    positions: NDArray[np.float64],
    radius_m: float,
    paint: NDArray[np.uint8],
) -> None:
    known = np.isfinite(positions).all(axis=1)
    stream.log(path, rr.Points3D.from_fields(radii=[radius_m]), static=True)
    columns = rr.Points3D.columns(positions=positions[known], colors=_pack(paint[known]))
    stream.send_columns(path, at, columns.partition(known.astype(int).tolist()))


def _goals(
    stream: rr.RecordingStream,
    path: str,
    t_s: NDArray[np.float64],
    goals: NDArray[np.float64],
    times: Times,
    colour: str,
) -> None:
    """A flat ring-like marker where the motion will end; written only when it changes."""
    filled = np.nan_to_num(goals, nan=1e9)
    changed = np.append(True, np.any(np.diff(filled, axis=0) != 0, axis=1))[: len(goals)]
    some = goals[changed]
    known = np.isfinite(some).all(axis=1)
    if not known.any():
        return
    shape = rr.Ellipsoids3D.from_fields(half_sizes=[(0.14, 0.14, 0.006)], colors=[_rgb(colour)], fill_mode="solid")
    stream.log(path, shape, static=True)
    columns = rr.Ellipsoids3D.columns(centers=some[known])
    stream.send_columns(path, times(t_s[changed]), columns.partition(known.astype(int).tolist()))


def _trail(
    stream: rr.RecordingStream,
    path: str,
    times: Times,
    t_s: NDArray[np.float64],
    positions: NDArray[np.float64],
    paint: NDArray[np.uint8],
    radius_m: float,
) -> None:
    """The way of the last seconds, one strip per colour, never across what is unknown."""
    pieces = _pieces(positions, paint)
    first = np.searchsorted(t_s, t_s - TRAIL_S)
    strips: list[NDArray[np.float32]] = []
    shades: list[NDArray[np.uint8]] = []
    counts = []
    starts, stops = (np.array([piece[end] for piece in pieces]) for end in (0, 1))
    for now, oldest in enumerate(first.tolist()):
        before = len(strips)
        for piece in range(int(np.searchsorted(stops, oldest, "right")), int(np.searchsorted(starts, now))):
            low, high = max(int(starts[piece]), oldest), min(int(stops[piece]), now)
            strips.append(positions[low : high + 1].astype(np.float32))
            shades.append(paint[high])
        counts.append(len(strips) - before)
    if not strips:
        return
    stream.log(path, rr.LineStrips3D.from_fields(radii=[radius_m]), static=True)
    columns = rr.LineStrips3D.columns(strips=strips, colors=_pack(np.array(shades)))
    stream.send_columns(path, times(t_s), columns.partition(counts))


def _pieces(positions: NDArray[np.float64], paint: NDArray[np.uint8]) -> list[tuple[int, int]]:
    """First and last index of each stretch of one colour; a piece starts where the one before ends."""
    known = [bool(row.all()) for row in np.isfinite(positions)]
    shades = paint.tolist()
    pieces: list[tuple[int, int]] = []
    for now in range(1, len(known)):
        if not (known[now] and known[now - 1]):
            continue
        start, end = pieces[-1] if pieces else (-1, -1)
        if end == now - 1 and shades[now] == shades[now - 1] and start < end:
            pieces[-1] = (start, now)
        else:
            pieces.append((now - 1, now))
    return pieces


def _path(positions: NDArray[np.float64], colour: str) -> rr.LineStrips3D:
    """The whole way of the execution as thin lines, broken where it is unknown."""
    known = np.isfinite(positions).all(axis=1)
    cuts = np.flatnonzero(np.diff(known.astype(int))) + 1
    strips = [part[:: max(1, len(part) // 2000)] for part in np.split(positions, cuts) if np.isfinite(part[0, 0])]
    return rr.LineStrips3D([part for part in strips if len(part) > 1], colors=[_rgb(colour)], radii=0.003)


def _rgb(colour: str) -> tuple[int, int, int]:
    return colours.to_rgb(colour)


def _pack(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Red, green, blue (N, 3) as one 0xRRGGBBAA each (N,)."""
    wide = rgb.astype(np.uint32)
    return np.asarray((wide[:, 0] << 24) | (wide[:, 1] << 16) | (wide[:, 2] << 8) | np.uint32(255))
