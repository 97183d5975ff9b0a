"""Lays out the viewer: scene and texts on the left, lanes and plots on the right.

Several executions are shown side by side, each with its scene and lanes; their curves share axes. Empty views are left
out. `scene` and `curves` write the contents.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun.blueprint.encodings as rre

from cyclekit.dataset.unknown_height import in_plane
from cyclekit.errors import CyclekitError
from cyclekit.replay.compare import most_different
from cyclekit.replay.curves import HUE_NAMES, spent_words
from cyclekit.replay.people import floor_m
from cyclekit.replay.phase import TASK
from cyclekit.replay.prediction_errors import prediction_errors
from cyclekit.replay.scene import PAPER
from cyclekit.replay.sink import EXECUTION, PHASE
from cyclekit.replay.words import slowdowns
from cyclekit.text.numbers import fixed, given

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution
    from cyclekit.replay.phase import Order

Focus = Literal["slowdown", "error"] | float
"""Start of the replay: the costliest slow-down, the largest error of the model, or a second of the execution."""

LEAD_S = 1.5
PHASES_PER_S = 25
LONG_S = 240.0


class Opening(NamedTuple):
    """An interval on a timeline: nanoseconds of the execution, or hundredths of a task on the path phase."""

    timeline: str
    start: int
    end: int


def blueprint(runs: Sequence[ReplayedExecution], order: Order, first: Opening | None) -> rrb.Blueprint:
    """Return the layout for one execution, or for several side by side."""
    return rrb.Blueprint(
        _alone(runs[0]) if len(runs) == 1 else _beside(runs, order),
        _time_panel(first),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _alone(run: ReplayedExecution) -> rrb.Container:
    """Return the layout of one execution, which fits into 1300 x 700 px."""
    words = [
        rrb.TextDocumentView(origin="/summary", name="Where the time went"),
        rrb.TextLogView(origin="/log", name="What happened", columns=_log_columns()),
    ]
    if prediction_errors(run):
        words.append(rrb.TextLogView(origin="/misses", name="Where model and log differ most", columns=_log_columns()))
    right, scene = _right(run), _scene(run)
    left = rrb.Vertical(*([scene] if scene else []), rrb.Tabs(*words), row_shares=[8, 5] if scene else None)
    return rrb.Horizontal(left, right, column_shares=[6, 5]) if right else left


def _beside(runs: Sequence[ReplayedExecution], order: Order) -> rrb.Vertical:
    whole = _whole_path(order)
    roots = [f"/{number + 1}" for number in range(len(runs))]
    names = [f"{run.name} ({hue})" for run, hue in zip(runs, HUE_NAMES, strict=False)]
    scenes = [_scene(run, root, name) for run, root, name in zip(runs, roots, names, strict=True)]
    rows: list[tuple[float, rrb.Container | rrb.View]] = []
    if any(scenes):
        rows.append((5, rrb.Horizontal(*[scene for scene in scenes if scene])))
    lanes = [
        rrb.StateTimelineView(origin=f"{root}/lanes", name=name, time_view=whole)
        for root, name in zip(roots, names, strict=True)
    ]  # fmt: skip
    rows.append((5, rrb.Horizontal(*lanes)))
    hidden = rrb.PlotLegend(visible=False)  # a legend would cover the first seconds; the titles name the colours
    axis = rrb.ScalarAxis(range=(-0.05, 1.05), zoom_lock=True)
    scaled = [f"+ {root}/plots/scaling/{kind}" for root in roots for kind in ("logged", "inferred")]
    lost = [f"+ {root}/plots/lost_in_task" for root in roots]
    curves = rrb.Horizontal(
        rrb.TimeSeriesView(
            origin="/", contents=scaled, name="Robot speed scaling", axis_x=whole, axis_y=axis, plot_legend=hidden
        ),
        rrb.TimeSeriesView(
            origin="/", contents=lost, name="Safety slow-down in the task so far, s", axis_x=whole, plot_legend=hidden
        ),
        rrb.TextDocumentView(origin="/comparison", name="Which is slower, and where"),
    )
    rows.append((4, curves))
    return rrb.Vertical(*[view for _, view in rows], row_shares=[share for share, _ in rows])


def opening(runs: Sequence[ReplayedExecution], order: Order, at: Focus) -> Opening | None:
    """Return the interval to play first; None = open paused at the start.

    For one execution: the interval selected by `at`, by default the costliest slow-down. For several, on the path
    phase: the task whose times differ most.
    """
    if len(runs) > 1:
        keys = most_different(runs)
        return Opening(PHASE, order[keys[0]] * TASK, (order[keys[0]] + 1) * TASK - 1) if keys else None
    span = _span(runs[0], at)
    if span is None:
        return None
    start_s, end_s = max(0.0, span[0] - LEAD_S), min(runs[0].duration_s, span[1] + LEAD_S)
    return Opening(EXECUTION, round(start_s * 1e9), round(end_s * 1e9))


def _span(run: ReplayedExecution, at: Focus) -> tuple[float, float] | None:
    if isinstance(at, float | int):
        if at > run.duration_s:
            seen = (
                f"execution {run.name} lasts {fixed(run.duration_s, 1)} s, so there is nothing to show at {given(at)} s"
            )
            raise CyclekitError(seen, cure="Give --at a time since the execution began, such as 12.5s.")
        return float(at), float(at)
    wrong = prediction_errors(run, 1)
    if at == "error" and wrong:
        return wrong[0].start_s, wrong[0].end_s
    worst = max(slowdowns(run), key=lambda each: each.lost_s, default=None)
    return None if worst is None else (worst.start_s, worst.end_s)


def _time_panel(first: Opening | None) -> rrb.TimePanel:
    """Return a panel that loops `first`. A file cannot set the viewer's start time; `viewer.open_viewer` does."""
    if first is None:
        return rrb.TimePanel(state="collapsed", timeline=EXECUTION, play_state="paused")
    window = rrb.components.AbsoluteTimeRange(min=first.start, max=first.end)
    return rrb.TimePanel(
        state="collapsed",
        timeline=first.timeline,
        fps=PHASES_PER_S if first.timeline == PHASE else None,
        play_state="playing",
        loop_mode="selection",
        time_selection=window,
    )


def _log_columns() -> rrb.TextLogColumns:
    """Return the columns of the text log: time and text."""
    return rrb.TextLogColumns(
        text_log_columns=[
            rre.TextLogColumn("entitypath", visible=False),
            rre.TextLogColumn("loglevel", visible=False),
            rre.TextLogColumn("body"),
        ]
    )


def _right(run: ReplayedExecution) -> rrb.Vertical | None:
    """Return lanes and plots, stacked on a common time axis."""
    whole, hidden = _whole(run), rrb.PlotLegend(visible=False)  # a legend would cover the first seconds
    views: list[tuple[float, rrb.View | rrb.Container]] = []
    scaled = bool(np.isfinite(run.scaling).any())
    if scaled or any(run.robot_task) or any(run.human_task):
        name = f"{run.name}: robot speed, robot, operator, lost to"
        views.append((7, rrb.StateTimelineView(origin="/lanes", name=name, time_view=whole)))
    predicted = run.predicted is not None and bool(np.isfinite(run.predicted).any())
    if scaled or predicted:
        axis = rrb.ScalarAxis(range=(-0.05, 1.05), zoom_lock=True)
        kinds = [
            text
            for text, part in (("logged (blue)", ~run.inferred), ("inferred (green)", run.inferred))
            if np.isfinite(run.scaling[part]).any()
        ]
        kinds += ["predicted (violet)"] if predicted else []
        name = f"Robot speed scaling: {', '.join(kinds)}"
        plot = rrb.TimeSeriesView(origin="/plots/scaling", name=name, axis_x=whole, axis_y=axis, plot_legend=hidden)
        views.append((4, plot))
    tabs = []
    if np.isfinite(run.distance_m).any():
        tabs.append(("distance", "Distance robot to operator, m"))
    if np.isfinite(run.speed_m_s).any():
        tabs.append(("speed", "Tool speed, m/s"))
    if not run.tasks.is_empty():
        tabs.append(("phase", "Progress of the task"))
    plots: list[rrb.View] = [
        rrb.TimeSeriesView(origin=f"/plots/{path}", name=name, axis_x=whole, plot_legend=hidden) for path, name in tabs
    ]
    if run.joints is not None and not np.isfinite(run.speed_m_s).any():
        name = "Joint angles, rad (most moved)"
        plots.insert(0, rrb.TimeSeriesView(origin="/plots/joints", name=name, axis_x=whole))
    if plots:
        views.append((4, rrb.Tabs(*plots) if len(plots) > 1 else plots[0]))
    if scaled:
        name = "Time since the start, s: " + ", ".join(f"{words} ({colour})" for words, colour in spent_words(run))
        views.append((4, rrb.TimeSeriesView(origin="/plots/spent", name=name, axis_x=whole, plot_legend=hidden)))
    return rrb.Vertical(*[v for _, v in views], row_shares=[share for share, _ in views]) if views else None


def _whole(run: ReplayedExecution) -> rrb.TimeAxis | None:
    """Return the axis of the whole execution; None for a long one, for which the viewer's window follows the time."""
    if run.duration_s > LONG_S:
        return None
    ends = (rrb.TimeRangeBoundary.absolute(seconds=t_s) for t_s in (0.0, run.duration_s))
    return rrb.TimeAxis(view_range=rrb.TimeRange(*ends), link="independent")


def _whole_path(order: Order) -> rrb.TimeAxis | None:
    if not order:
        return None
    ends = (rrb.TimeRangeBoundary.absolute(seq=phase) for phase in (0, len(order) * TASK))
    return rrb.TimeAxis(view_range=rrb.TimeRange(*ends), link="independent")


def _scene(run: ReplayedExecution, root: str = "", who: str = "") -> rrb.Spatial3DView | None:
    seen = [p[np.isfinite(p).all(axis=1)] for p in (run.robot_m, in_plane(run.robot_m, run.human_m))]
    if not any(len(p) for p in seen):
        return None
    eye, target = _camera(*seen)
    grid = rrb.LineGrid3D(
        visible=True, spacing=0.5, plane=rr.components.Plane3D.XY.with_distance(floor_m(run)), color=(150, 158, 168, 90)
    )
    floor = "" if run.zones is None else "; floor: predicted with the operator there"
    return rrb.Spatial3DView(
        origin=f"{root}/scene",
        name=who or f"Colour: robot speed, 0 % red, 100 % blue{floor}",
        background=rrb.Background(color=PAPER),
        line_grid=grid,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
    )


def _camera(robot: NDArray[np.float64], human: NDArray[np.float64]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return position and target of a camera above, looking across the line from robot to operator."""
    points = np.concatenate([robot, human, np.zeros((1, 3))])
    low, high = np.quantile(points, 0.08, axis=0), np.quantile(points, 0.92, axis=0)
    middle = (low + high) / 2
    size = max(float(np.linalg.norm(high - low)), 1.2)
    towards = human[:, :2].mean(axis=0) if len(human) else np.array([1.0, 0.0])
    length = float(np.linalg.norm(towards))
    ahead = towards / length if length > 0.1 else np.array([1.0, 0.0])
    across = np.array([ahead[1], -ahead[0]])
    if len(human) and np.median(human[:, :2] @ across) > middle[:2] @ across:
        across = -across  # the camera is on the side opposite to the operator
    way = np.array([*(across + 0.25 * ahead), 1.5])  # steep, so that the operator rarely hides the robot
    eye = middle + way / np.linalg.norm(way) * size * 0.86
    return tuple(eye.tolist()), tuple(middle.tolist())
