"""Reads one execution as arrays for the replay.

All arrays are on the samples; NaN = unknown. Each gap of the log gets one unknown row on either side, so that drawings
stop there. `scene`, `curves` and `words` draw the arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.alignment.clocks import ASSUMED
from cyclekit.dataset.unknown_height import height_notes, in_plane
from cyclekit.replay.floor import FloorZones, learned_zones, rule_shapes
from cyclekit.replay.tracked_people import Skeletons, other_people, skeletons

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit.config import Furniture
    from cyclekit.dataset.dataset import Dataset, Place
    from cyclekit.learning.rules.shapes import RuleShape
    from cyclekit.replay.floor import PredictsNow

GAP_SAMPLES = 3.5
"""Minimum time without a sample, in sampling periods, that counts as a gap; nothing is drawn across gaps."""

FINEST_S = 1 / 30
_JOINTS = tuple(f"q{axis}_rad" for axis in range(6))


@dataclass(frozen=True)
class JointAngles:
    """Joint angles, reduced to at most 30 Hz.

    Attributes:
        t_s: Seconds of the execution, shape (T,).
        angle_rad: By column name (`q0_rad`), shape (T,) each; NaN = unknown.
        tcp_m: Logged TCP at the same times, shape (T, 3), m.
    """

    t_s: NDArray[np.float64]
    angle_rad: Mapping[str, NDArray[np.float64]]
    tcp_m: NDArray[np.float64]

    @property
    def six(self) -> NDArray[np.float64] | None:
        """Angles of a six-axis arm, shape (T, 6), rad; None if the log does not have six joints."""
        if set(self.angle_rad) != set(_JOINTS):
            return None
        return np.stack([self.angle_rad[name] for name in _JOINTS], axis=1)


@dataclass(frozen=True)
class ReplayedExecution:
    """Data of one execution at T instants: its samples and the edges of gaps.

    Attributes:
        name, cell: Names of the execution and of the dataset.
        start_s, duration_s, period_s: Start in session time, duration, and sampling period, s.
        t_s: Seconds of the execution, shape (T,).
        robot_m, human_m, robot_goal_m, human_goal_m: Positions, shape (T, 3), m, base frame.
        scaling: Speed scaling, shape (T,), logged or inferred.
        inferred: Whether `scaling` is inferred, shape (T,).
        predicted: Scaling predicted by the model, shape (T,); None without a model.
        speed_m_s: Speed of the TCP, shape (T,), m/s.
        step: Index of the level, shape (T,); NaN = unknown.
        moving: Whether the robot moves, length T; None = unknown, as in the tasks.
        lost_to: Main cause of the time lost at each sample, one of LOST_CAUSES; None = no loss.
        gaps: Start and end of each gap, seconds of the execution.
        tasks: Rows of TASKS of this execution.
        others: Positions of other people, per instant (N, 3), m.
        skeletons: Skeletons; None if the dataset has none.
        zones: Scaling predicted for an operator on each square of the floor over time; None without a model.
        shapes: Rectangles on the floor and distances to the robot's base of the model's rule, if it has one.
        epoch_s: Seconds since 1970 at session time 0; None if no log has the time of day.
        notes: Missing or doubtful data, one sentence each.
    """

    name: str
    cell: str
    start_s: float
    duration_s: float
    period_s: float
    t_s: NDArray[np.float64]
    robot_m: NDArray[np.float64]
    human_m: NDArray[np.float64]
    robot_goal_m: NDArray[np.float64]
    human_goal_m: NDArray[np.float64]
    scaling: NDArray[np.float64]
    inferred: NDArray[np.bool_]
    predicted: NDArray[np.float64] | None
    speed_m_s: NDArray[np.float64]
    step: NDArray[np.float64]
    moving: tuple[bool | None, ...]
    robot_task: tuple[str | None, ...]
    human_task: tuple[str | None, ...]
    lost_to: tuple[str | None, ...]
    gaps: tuple[tuple[float, float], ...]
    tasks: pl.DataFrame
    places: Mapping[str, Place]
    human_places: Mapping[str, Place]
    furniture: Mapping[str, Furniture]
    levels: tuple[float, ...]
    joints: JointAngles | None
    others: tuple[NDArray[np.float64], ...]
    skeletons: Skeletons | None
    zones: FloorZones | None
    shapes: tuple[RuleShape, ...]
    epoch_s: float | None
    notes: tuple[str, ...]

    @property
    def distance_m(self) -> NDArray[np.float64]:
        """Distance between TCP and operator, shape (T,), m; NaN if one is unknown."""
        return np.asarray(np.linalg.norm(self.robot_m - in_plane(self.robot_m, self.human_m), axis=1))

    def shown(self, task: str) -> str:
        """Return the displayed name of a task or place, from the labels of the cell file."""
        places = {**self.human_places, **self.places}
        return " → ".join(places[name].shown if name in places else name for name in task.split("->"))


def load_execution(dataset: Dataset, name: str, model: PredictsNow | None = None) -> ReplayedExecution:
    """Return one execution with the model's prediction.

    Raises:
        UnknownName: The dataset has no such execution.
    """
    name = dataset.find_execution(name)
    entry = dataset.executions.row(by_predicate=pl.col("execution") == name, named=True)
    start_s, session = float(entry["start_s"]), str(entry["session"])
    raw = dataset.samples([name]).sort("t_s").filter(pl.col("t_s").is_not_null())
    rows, gaps = _with_gaps(raw.with_columns(pl.col("t_s") - start_s), 1.0 / dataset.rate_hz)
    t_s = _floats(rows, "t_s")
    robot_m, human_m = _points(rows, "robot"), _points(rows, "human")
    joints = _joints(dataset.native_robot(name), start_s)
    usable = model if model is not None and model.problem == "now" else None
    tasks = dataset.tasks().filter(pl.col("execution") == name).drop_nulls("arrival_s").sort("index")
    return ReplayedExecution(
        name=name,
        cell=dataset.card.name or dataset.path.name,
        start_s=start_s,
        duration_s=float(entry["duration_s"]),
        period_s=1.0 / dataset.rate_hz,
        t_s=t_s,
        robot_m=robot_m,
        human_m=human_m,
        robot_goal_m=_points(rows, "robot_goal"),
        human_goal_m=_points(rows, "human_goal"),
        scaling=_floats(rows, "scaling"),
        inferred=(rows["scaling_origin"].fill_null("") == "inferred").to_numpy(),
        predicted=_predicted(usable, robot_m, human_m),
        speed_m_s=_speed(t_s, robot_m),
        step=_floats(rows, "step"),
        moving=tuple(rows["robot_moving"].to_list()),
        robot_task=tuple(rows["robot_task"].to_list()),
        human_task=tuple(rows["human_task"].to_list()),
        lost_to=tuple(rows["lost_to"].to_list()),
        gaps=gaps,
        tasks=tasks.with_columns(pl.col("start_s", "arrival_s", "end_s") - start_s),
        places=dataset.places,
        human_places=dataset.human_places,
        furniture=dataset.furniture,
        levels=dataset.levels,
        joints=joints,
        others=other_people(dataset, session, t_s + start_s, human_m, robot_m),
        skeletons=skeletons(dataset, session, t_s + start_s, human_m),
        zones=learned_zones(dataset, usable, t_s, robot_m, human_m) if usable else None,
        shapes=rule_shapes(usable, human_m),
        epoch_s=_epoch(dataset, session),
        notes=_notes(rows, joints, model),
    )


def _epoch(dataset: Dataset, session: str) -> float | None:
    """Return seconds since 1970 at session time 0, from a log of the session with such a clock, the robot's first."""
    records = [record for record in dataset.recordings if record.session == session]
    for record in sorted(records, key=lambda each: "robot" not in each.tables):
        if record.clock.kind == "epoch" and record.clock.method != ASSUMED:
            return -record.clock.offset_s / record.clock.rate
    return None


def _floats(rows: pl.DataFrame, column: str) -> NDArray[np.float64]:
    return rows[column].cast(pl.Float64).fill_null(float("nan")).to_numpy().astype(np.float64)


def _points(rows: pl.DataFrame, stem: str) -> NDArray[np.float64]:
    """Return positions (T, 3), m; the unknown height of a planar tracker becomes 0, the plane of the robot's base."""
    x_m, y_m, z_m = (_floats(rows, f"{stem}_{axis}_m") for axis in "xyz")
    z_m = np.where(np.isnan(z_m) & ~np.isnan(x_m), 0.0, z_m)
    points = np.stack([x_m, y_m, z_m], axis=1)
    points[np.isnan(points).any(axis=1)] = np.nan
    return points


def _with_gaps(rows: pl.DataFrame, period_s: float) -> tuple[pl.DataFrame, tuple[tuple[float, float], ...]]:
    """Return the rows with a row of nulls in every gap, so that nothing is drawn across, and the gaps, s."""
    times = rows["t_s"].to_numpy()
    before = np.flatnonzero(np.diff(times) > GAP_SAMPLES * period_s)
    gaps = tuple((float(times[i]), float(times[i + 1])) for i in before)
    if not gaps:
        return rows, ()
    edges = pl.DataFrame({"t_s": [start + period_s for start, _ in gaps]}, schema={"t_s": pl.Float64})
    return pl.concat([rows, edges], how="diagonal").sort("t_s"), gaps


def _speed(t_s: NDArray[np.float64], robot_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the speed since the previous sample, shape (T,), m/s; NaN at the first sample and after a gap."""
    if len(t_s) < 2:
        return np.full(len(t_s), np.nan)
    way = np.linalg.norm(np.diff(robot_m, axis=0), axis=1)
    return np.concatenate([[np.nan], way / np.maximum(np.diff(t_s), 1e-6)])


def _predicted(
    model: PredictsNow | None, robot_m: NDArray[np.float64], human_m: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    if model is None:
        return None
    x = np.concatenate([robot_m, in_plane(robot_m, human_m)], axis=1)
    known = np.isfinite(x).all(axis=1)
    out = np.full(len(x), np.nan)
    if known.any():
        out[known] = np.asarray(model.predict(x[known].astype(np.float32)), dtype=np.float64)
    return out


def _joints(native: pl.DataFrame | None, start_s: float) -> JointAngles | None:
    if native is None:
        return None
    names = [c for c in native.columns if c.startswith("q") and c.endswith("_rad") and native[c].count()]
    if not names or native.is_empty():
        return None
    slot = ((pl.col("t_s") - start_s) / FINEST_S).floor()
    thin = native.filter(slot.is_first_distinct()).sort("t_s")
    return JointAngles(
        t_s=thin["t_s"].to_numpy() - start_s,
        angle_rad={name: _floats(thin, name) for name in names},
        tcp_m=np.stack([_floats(thin, f"tcp_{axis}_m") for axis in "xyz"], axis=1),
    )


def _notes(rows: pl.DataFrame, joints: JointAngles | None, model: PredictsNow | None) -> tuple[str, ...]:
    """Return notes on missing data, so that an empty scene is not mistaken for an empty cell."""
    notes = []
    if not rows["robot_x_m"].count():
        seen = f"{len(joints.angle_rad)} joints are plotted instead" if joints else "no robot is shown"
        notes.append(f"The log has no robot tool position: {seen}.")
    if not rows["human_x_m"].count():
        notes.append("No operator position: the operator was absent or not tracked.")
    notes += [f"{text[0].upper()}{text[1:]}." for text in height_notes(rows)]
    if not rows["scaling"].count():
        notes.append("Speed scaling is unknown in this execution.")
    if model is None:
        notes.append("No model was given: no predicted scaling.")
    elif model.problem != "now":
        notes.append(f"The model predicts problem '{model.problem}', not 'now': no predicted scaling.")
    return tuple(notes)
