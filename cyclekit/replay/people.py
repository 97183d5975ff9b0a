"""Draws people: the operator as a skeleton or an upright body, with trail and goal, and other people.

Without skeletons, a log has one point per person, and an upright body is drawn under that point. `tracked_people`
returns the positions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from cyclekit.plots import colours
from cyclekit.replay.shapes import goals, trail

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution
    from cyclekit.replay.sink import Sink

BODY_M = 1.75
"""Height of a drawn person, m; logs do not contain it."""

_WAIST_M = 0.95
_SHOULDER_RADIUS_M = 0.18
_HEAD_RADIUS_M = 0.12
_TRUNK_M = BODY_M - 2 * _SHOULDER_RADIUS_M - 2 * _HEAD_RADIUS_M


def floor_m(run: ReplayedExecution) -> float:
    """Return the height of the floor under the operator, m, base frame; 0 without an operator.

    The tracked point is assumed to be the waist, unless the floor would then be above the robot's base.
    """
    heights = run.human_m[np.isfinite(run.human_m[:, 2]), 2]
    return min(0.0, float(np.median(heights)) - _WAIST_M) if len(heights) else 0.0


def log_people(sink: Sink) -> None:
    """Write operator, skeletons and other people of one execution."""
    run, feet = sink.run, floor_m(sink.run)
    limbs = run.skeletons.of_operator if run.skeletons else np.zeros(len(run.t_s), dtype=np.bool_)
    known = np.isfinite(run.human_m[:, :2]).all(axis=1)
    if known.any():
        upright = [run.human_m[row : row + int(alone)] for row, alone in enumerate(known & ~limbs)]
        _bodies(sink, "scene/operator", upright, feet, colours.OPERATOR)
        ground = run.human_m.copy()
        ground[:, 2] = feet + 0.02
        paint = np.tile(np.array(colours.to_rgb(colours.OPERATOR), dtype=np.uint8), (len(ground), 1))
        trail(sink, "scene/operator/trail", ground, paint, 0.02)
        goal = run.human_goal_m.copy()
        goal[:, 2] = feet + 0.02
        goals(sink, "scene/operator/goal", goal, colours.OPERATOR)
    _limbs(sink)
    if any(len(each) for each in run.others):
        _bodies(sink, "scene/others", run.others, feet, colours.UNKNOWN)


def _bodies(sink: Sink, path: str, people: tuple[NDArray[np.float64], ...] | list[NDArray[np.float64]], feet: float,
            colour: str) -> None:  # fmt: skip
    """Write upright bodies under points; `people` has one array (N, 3), m, per sample."""
    counts = [len(each) for each in people]
    if not any(counts):
        return
    points = np.concatenate(people)
    base = np.column_stack([points[:, :2], np.full(len(points), feet + _SHOULDER_RADIUS_M)])
    top = base + np.array([0.0, 0.0, _TRUNK_M + _SHOULDER_RADIUS_M + _HEAD_RADIUS_M])
    paint = [colours.to_rgb(colour)]
    body = rr.Capsules3D.from_fields(lengths=[_TRUNK_M], radii=[_SHOULDER_RADIUS_M], colors=paint, fill_mode="solid")
    sink.static(f"{path}/body", body)
    sink.columns(f"{path}/body", sink.run.t_s, rr.Capsules3D.columns(translations=base).partition(counts))
    sink.static(f"{path}/head", rr.Points3D.from_fields(radii=[_HEAD_RADIUS_M], colors=paint))
    sink.columns(f"{path}/head", sink.run.t_s, rr.Points3D.columns(positions=top).partition(counts))


def _limbs(sink: Sink) -> None:
    found = sink.run.skeletons
    if found is None:
        return
    counts = [len(each) for each in found.bones]
    strips = list(np.concatenate(found.bones).astype(np.float32))
    look = rr.LineStrips3D.from_fields(radii=[0.03], colors=[colours.to_rgb(colours.OPERATOR)])
    sink.static("scene/limbs", look)
    sink.columns("scene/limbs", sink.run.t_s, rr.LineStrips3D.columns(strips=strips).partition(counts))
