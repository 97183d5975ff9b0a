"""How the viewer opens: scene at the left, lanes and plots at the right, words below; nobody has to arrange views.

Only views that have something to show are there. What they show is the business of `scene` and `curves`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun.blueprint.encodings as rre

from cyclekit.replay.scene import floor_m
from cyclekit.replay.words import slowdowns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.replay.execution import Execution

EXECUTION, SESSION = "execution", "session"
"""Names of the two timelines: seconds of the execution, seconds of the session."""

PAPER = (238, 241, 244)
LEAD_S = 1.5
LONG_S = 240.0


def blueprint(run: Execution) -> rrb.Blueprint:
    """Return the layout for one execution."""
    words = rrb.Horizontal(
        rrb.TextDocumentView(origin="/summary", name=f"{run.cell}, {run.name}"),
        rrb.TextLogView(origin="/log", name="What happened", columns=_log_columns()),
        column_shares=[1, 1],
    )
    right = _right(run)
    scene = _scene(run)
    top = rrb.Horizontal(*[view for view in (scene, right) if view], column_shares=[6, 5] if scene and right else None)
    parts = [top, words] if scene or right else [words]
    return rrb.Blueprint(
        rrb.Vertical(*parts, row_shares=[3, 1] if len(parts) == 2 else None),
        _time_panel(run),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _time_panel(run: Execution) -> rrb.TimePanel:
    """Start at the costliest slow-down, in a loop, so that the first thing seen is why the robot was slow."""
    worst = max(slowdowns(run), key=lambda each: each.lost_s, default=None)
    if worst is None:
        return rrb.TimePanel(state="collapsed", timeline=EXECUTION, play_state="paused")
    start_s, end_s = max(0.0, worst.start_s - LEAD_S), min(run.duration_s, worst.end_s + LEAD_S)
    window = rrb.components.AbsoluteTimeRange(min=round(start_s * 1e9), max=round(end_s * 1e9))
    return rrb.TimePanel(
        state="collapsed", timeline=EXECUTION, play_state="playing", loop_mode="selection", time_selection=window
    )


def _log_columns() -> rrb.TextLogColumns:
    """Time and text only."""
    return rrb.TextLogColumns(
        text_log_columns=[
            rre.TextLogColumn("entitypath", visible=False),
            rre.TextLogColumn("loglevel", visible=False),
            rre.TextLogColumn("body"),
        ]
    )


def _right(run: Execution) -> rrb.Vertical | None:
    """Lanes and plots, one above the other on the same seconds."""
    whole = _whole(run)
    views: list[tuple[float, rrb.View]] = []
    scaled = bool(np.isfinite(run.scaling).any())
    if scaled or any(run.robot_task) or any(run.human_task):
        views.append((5, rrb.StateTimelineView(origin="/lanes", name="Robot speed, robot, operator", time_view=whole)))
    if scaled or (run.predicted is not None and np.isfinite(run.predicted).any()):
        axis = rrb.ScalarAxis(range=(-0.05, 1.05), zoom_lock=True)
        name = "Robot speed scaling (1 = full)"
        views.append((4, rrb.TimeSeriesView(origin="/plots/scaling", name=name, axis_x=whole, axis_y=axis)))
    if np.isfinite(run.distance_m).any():
        name = "Distance robot to operator, m"
        views.append((3, rrb.TimeSeriesView(origin="/plots/distance", name=name, axis_x=whole)))
    if np.isfinite(run.speed_m_s).any():
        views.append((3, rrb.TimeSeriesView(origin="/plots/speed", name="Tool speed, m/s", axis_x=whole)))
    elif run.joints is not None:
        name = "Joint angles, rad (those that move most)"
        views.append((5, rrb.TimeSeriesView(origin="/plots/joints", name=name, axis_x=whole)))
    return rrb.Vertical(*[v for _, v in views], row_shares=[share for share, _ in views]) if views else None


def _whole(run: Execution) -> rrb.TimeAxis | None:
    """The whole execution at once; of a long one the viewer's own window, which follows the time."""
    if run.duration_s > LONG_S:
        return None
    ends = (rrb.TimeRangeBoundary.absolute(seconds=t_s) for t_s in (0.0, run.duration_s))
    return rrb.TimeAxis(view_range=rrb.TimeRange(*ends), link="independent")


def _scene(run: Execution) -> rrb.Spatial3DView | None:
    seen = [p[np.isfinite(p).all(axis=1)] for p in (run.robot_m, run.human_m)]
    if not any(len(p) for p in seen):
        return None
    eye, target = _camera(*seen)
    grid = rrb.LineGrid3D(
        visible=True, spacing=0.5, plane=rr.components.Plane3D.XY.with_distance(floor_m(run)), color=(150, 158, 168, 90)
    )
    return rrb.Spatial3DView(
        origin="/scene",
        name="Cell: the line shows distance, its colour the robot's speed",
        background=rrb.Background(color=PAPER),
        line_grid=grid,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
    )


def _camera(robot: NDArray[np.float64], human: NDArray[np.float64]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Look across the line from robot to operator, from above, so that both stand side by side."""
    points = np.concatenate([robot, human, np.zeros((1, 3))])
    low, high = np.quantile(points, 0.02, axis=0), np.quantile(points, 0.98, axis=0)
    middle = (low + high) / 2
    size = max(float(np.linalg.norm(high - low)), 1.2)
    towards = human[:, :2].mean(axis=0) if len(human) else np.array([1.0, 0.0])
    length = float(np.linalg.norm(towards))
    ahead = towards / length if length > 0.1 else np.array([1.0, 0.0])
    across = np.array([ahead[1], -ahead[0]])
    if len(human) and np.median(human[:, :2] @ across) > middle[:2] @ across:
        across = -across  # the operator shall stand behind the line, not between it and the viewer
    way = np.array([*(across + 0.25 * ahead), 0.8])
    eye = middle + way / np.linalg.norm(way) * size * 0.78
    return tuple(eye.tolist()), tuple(middle.tolist())
