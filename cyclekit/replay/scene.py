"""Writes the 3-D scene: robot, places, learned zones, and the line from robot to operator in the scaling's colour.

`people` draws people; `layout` decides which views show the scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from cyclekit.config.arms import recognise_arm
from cyclekit.dataset.unknown_height import in_plane
from cyclekit.plots import colours
from cyclekit.plots.labels import place_labels
from cyclekit.replay.people import floor_m, log_people
from cyclekit.replay.shapes import goals, pack, trail
from cyclekit.text.numbers import exact_percent, fixed, whole_percent

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Place
    from cyclekit.replay.sink import Sink

PAPER = (238, 241, 244)
"""Background colour of the scene; zones are blended with it, so that objects on them remain visible."""

FURNITURE = (206, 211, 217)
ZONE_TINT = 0.42
_LABEL_INK = {colours.OPERATOR: (190, 245, 232)}
"""Colours of labels, on a grey background: light, with a little green for the operator's."""


def log_scene(sink: Sink) -> None:
    """Write the scene of one execution."""
    sink.static("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    _places(sink, "scene/places", sink.run.places, colours.ROBOT)
    _places(sink, "scene/operator_places", sink.run.human_places, colours.OPERATOR)
    _furniture(sink)
    _zones(sink)
    _rule(sink)
    _robot(sink)
    log_people(sink)
    _link(sink)


def _places(sink: Sink, path: str, places: Mapping[str, Place], colour: str) -> None:
    if not places:
        return
    centres = [place.xyz_m for place in places.values()]
    sink.static(path, rr.Points3D(centres, radii=0.04, colors=[colours.to_rgb(colour)] * len(places)))
    labels = place_labels(places)
    at = [(x, y, z - 0.06) for x, y, z in (label.xyz_m for label in labels)]
    words = [label.text for label in labels]
    paint = [_LABEL_INK.get(colour, (255, 255, 255))] * len(at)
    sink.static(f"{path}/names", rr.Points3D(at, radii=0.001, colors=paint, labels=words, show_labels=True))


def _furniture(sink: Sink) -> None:
    """Write the boxes of the cell file, light, so that objects on them remain visible."""
    things = sink.run.furniture
    if not things:
        return
    halves = np.array([thing.size_m for thing in things.values()]) / 2
    centres = np.array([thing.xyz_m for thing in things.values()]) - halves * (0, 0, 1)
    turns = [rr.RotationAxisAngle(axis=(0, 0, 1), degrees=thing.yaw_deg) for thing in things.values()]
    boxes = rr.Boxes3D(
        centers=centres,
        half_sizes=halves,
        rotation_axis_angles=turns,
        colors=[FURNITURE] * len(things),
        labels=list(things),
        show_labels=False,
        fill_mode="solid",
    )
    sink.static("scene/furniture", boxes)


def _zones(sink: Sink) -> None:
    """Write the floor squares in the colour of the scaling predicted for an operator on them."""
    zones = sink.run.zones
    if zones is None:
        return
    height = floor_m(sink.run) - 0.004
    centres = np.column_stack([zones.centre_m, np.full(len(zones.centre_m), height)])
    half = float(np.abs(np.diff(np.unique(zones.centre_m[:, 0]))).min(initial=1.0)) / 2
    boxes = rr.Boxes3D.from_fields(centers=centres, half_sizes=[(half, half, 0.003)], fill_mode="solid")
    sink.static("scene/zones", boxes)
    rgb = colours.scaling_rgb(zones.scaling.ravel()) * ZONE_TINT + np.array(PAPER) * (1 - ZONE_TINT)
    columns = rr.Boxes3D.columns(colors=pack(np.rint(rgb).astype(np.uint8)))
    sink.columns("scene/zones", zones.t_s, columns.partition([len(centres)] * len(zones.t_s)))


def _rule(sink: Sink) -> None:
    """Write the rule's shapes on the floor in the colour of the scaling that applies inside."""
    shapes = [shape for shape in sink.run.shapes if not shape.leaving]
    if not shapes:
        return
    height = floor_m(sink.run) + 0.004
    strips = [[(x, y, height) for x, y in (*shape.outline_m, shape.outline_m[0])] for shape in shapes]
    paint = [colours.to_rgb(colours.scaling_hex(shape.level)) for shape in shapes]
    words = [exact_percent(shape.level) for shape in shapes]
    sink.static("scene/rule", rr.LineStrips3D(strips, radii=0.012, colors=paint, labels=words, show_labels=True))


def _robot(sink: Sink) -> None:
    run = sink.run
    known = np.isfinite(run.robot_m).all(axis=1)
    if not known.any():
        return
    paint = colours.scaling_rgb(run.scaling)
    sink.static("scene/robot/tool", rr.Points3D.from_fields(radii=[0.055]))
    columns = rr.Points3D.columns(positions=run.robot_m[known], colors=pack(paint[known]))
    sink.columns("scene/robot/tool", run.t_s, columns.partition(known.astype(int).tolist()))
    trail(sink, "scene/robot/trail", run.robot_m, paint, 0.012)
    goals(sink, "scene/robot/goal", run.robot_goal_m, colours.ROBOT)
    sink.static("scene/robot/path", _path(run.robot_m, colours.UNKNOWN))
    _arm(sink)


def _arm(sink: Sink) -> None:
    """Write the links of the arm if joint angles and logged TCP identify a known arm."""
    joints = sink.run.joints
    angles = joints.six if joints else None
    fit = None if joints is None or angles is None else recognise_arm(angles, joints.tcp_m)
    if joints is None or angles is None or fit is None:
        return
    known = np.isfinite(angles).all(axis=1)
    points, turn = fit.points(angles[known])
    tool = points[:, -1] + np.einsum("tij,j->ti", turn, fit.tool_m)
    strips = np.concatenate([points, tool[:, None]], axis=1).astype(np.float32)
    t_s, one = joints.t_s[known], [1] * len(strips)
    look = rr.LineStrips3D.from_fields(colors=[colours.to_rgb("#aeb8c4")], radii=[0.05])
    sink.static("scene/robot/arm", look)
    sink.columns("scene/robot/arm", t_s, rr.LineStrips3D.columns(strips=list(strips)).partition(one))
    bearings = strips[:, :-1].reshape(-1, 3)
    sink.static("scene/robot/joints", rr.Points3D.from_fields(colors=[colours.to_rgb("#56626f")], radii=[0.065]))
    counts = [strips.shape[1] - 1] * len(strips)
    sink.columns("scene/robot/joints", t_s, rr.Points3D.columns(positions=bearings).partition(counts))


def _link(sink: Sink) -> None:
    """Write the line from TCP to operator, with its length, in the colour of the scaling."""
    run, distance = sink.run, sink.run.distance_m
    known = np.isfinite(distance)
    if not known.any():
        return
    ends = np.stack([run.robot_m[known], in_plane(run.robot_m, run.human_m)[known]], axis=1).astype(np.float32)
    labels = [_link_label(d, s) for d, s in zip(distance[known], run.scaling[known], strict=True)]
    counts = known.astype(int).tolist()
    columns = rr.LineStrips3D.columns(strips=list(ends), colors=pack(colours.scaling_rgb(run.scaling[known])))
    sink.static("scene/distance", rr.LineStrips3D.from_fields(radii=[0.016]))
    sink.columns("scene/distance", run.t_s, columns.partition(counts))
    text = rr.Points3D.columns(positions=ends.mean(axis=1), labels=labels)
    ink = rr.Points3D.from_fields(radii=[0.001], colors=[colours.to_rgb("#ffffff")], show_labels=True)
    sink.static("scene/distance/text", ink)
    sink.columns("scene/distance/text", run.t_s, text.partition(counts))


def _link_label(distance_m: float, scaling: float) -> str:
    if np.isnan(scaling):
        return f"{fixed(distance_m, 2)} m"
    return f"{fixed(distance_m, 2)} m: robot at {whole_percent(scaling)} speed"


def _path(positions: NDArray[np.float64], colour: str) -> rr.LineStrips3D:
    """Return the whole path of the execution as thin lines, interrupted where it is unknown."""
    known = np.isfinite(positions).all(axis=1)
    cuts = np.flatnonzero(np.diff(known.astype(int))) + 1
    strips = [part[:: max(1, len(part) // 2000)] for part in np.split(positions, cuts) if np.isfinite(part[0, 0])]
    return rr.LineStrips3D([part for part in strips if len(part) > 1], colors=[colours.to_rgb(colour)], radii=0.003)
