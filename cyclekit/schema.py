"""The canonical tables: every column with its type, unit and meaning.

Adapters fill ROBOT, PEOPLE, EVENTS, TASK_LIST and SAFETY (and SKELETONS and STAMPS, if available); ingest derives
SAMPLES and TASKS from them, and puts rows that it does not use into QUARANTINE. A null always means "unknown", never
zero.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    """One number per row, shape (N,)."""
    Points = NDArray[np.float64]
    """Numbers per row, shape (N, 3) unless said otherwise."""
    Floats = NDArray[np.float64]
    """Numbers of any shape; `Singles`, `Ints` and `Bools` are the same of other types."""
    Singles = NDArray[np.float32]
    Ints = NDArray[np.int64]
    Bools = NDArray[np.bool_]

Progress = Callable[[float, str], None]
"""Callback for progress: fraction done, 0 to 1, and text."""
_AS_IT_IS = pl.QueryOptFlags.none()
SCHEMA_VERSION = 5
"""Version of the dataset layout; a dataset of another version is rejected."""


@dataclass(frozen=True)
class Column:
    """One column of a canonical table."""

    dtype: pl.DataType
    unit: str
    meaning: str


F64, I64, TEXT, FLAG = pl.Float64(), pl.Int64(), pl.String(), pl.Boolean()

ROBOT: Mapping[str, Column] = {
    "t_s": Column(F64, "s", "time in the log's clock, strictly increasing within a run"),
    "tcp_x_m": Column(F64, "m", "tool centre point, robot base frame"),
    "tcp_y_m": Column(F64, "m", "tool centre point, robot base frame"),
    "tcp_z_m": Column(F64, "m", "tool centre point, robot base frame"),
    "tcp_speed_m_s": Column(F64, "m/s", "norm of the linear TCP velocity; null = not logged"),
    "scaling": Column(F64, "1", "effective speed scaling in [0,1]; null where not logged, not valid or not playing"),
    "slider": Column(F64, "1", "the operator's speed slider (target fraction) in [0,1]; null = not logged"),
    "state": Column(TEXT, "", "program state: playing, paused, stopped; null = not logged"),
    "digital_in_bits": Column(I64, "", "digital inputs as a bit field; null = not logged"),
    "digital_out_bits": Column(I64, "", "digital outputs as a bit field; null = not logged"),
    "register": Column(I64, "", "the integer register chosen for the cell; null = not logged"),
    "source_row": Column(I64, "", "position in the log: a line, row, message or frame, see its entry in dataset.json"),
}
"""Robot recording at its native rate. Joint columns `q<i>_rad` and `qd<i>_rad_s` may follow (see `is_joint`)."""

PEOPLE: Mapping[str, Column] = {
    "t_s": Column(F64, "s", "time in the log's clock"),
    "person": Column(TEXT, "", "track id of the tracker"),
    "x_m": Column(F64, "m", "position of the person's tracked point, the log's frame; null = not seen"),
    "y_m": Column(F64, "m", "as x_m"),
    "z_m": Column(F64, "m", "as x_m; null for a planar tracker"),
    "source_row": Column(I64, "", "position in the log: a line, row, message or frame, see its entry in dataset.json"),
}

EVENTS: Mapping[str, Column] = {
    "t_s": Column(F64, "s", "time in the log's clock"),
    "signal": Column(TEXT, "", "name of the signal: a button, a PLC tag, a digital input"),
    "value": Column(TEXT, "", "its new value, as text"),
    "source_row": Column(I64, "", "position in the log: a line, row, message or frame, see its entry in dataset.json"),
}

TASK_LIST: Mapping[str, Column] = {
    "t_s": Column(F64, "s", "start of the task, the log's clock"),
    "end_s": Column(F64, "s", "end of the task, the log's clock; null = not logged"),
    "agent": Column(TEXT, "", "kind of the agent: robot or operator"),
    "agent_name": Column(TEXT, "", "the agent's name in the log"),
    "task": Column(TEXT, "", "the task's name"),
    "execution": Column(TEXT, "", "the execution's name in the log; null = not logged"),
    "planned_start_s": Column(F64, "s", "planned start, the log's clock; null = not logged"),
    "planned_end_s": Column(F64, "s", "planned end, the log's clock; null = not logged"),
    "outcome": Column(TEXT, "", "done, failed, or the log's word; null = not logged"),
    "source_row": Column(I64, "", "position in the log: a line, row, message or frame, see its entry in dataset.json"),
}
"""A task list: agent, task, start and end; without positions."""

MOST_FAILED = 0.25
"""Maximum share of failed tasks in a task list; above it, the outcome means something else and is not used."""

SAFETY: Mapping[str, Column] = {
    "t_s": Column(F64, "s", "time in the log's clock"),
    "override": Column(F64, "1", "speed override of the safety system in [0,1]; null = not logged"),
    "distance_m": Column(F64, "m", "distance from robot to person, by the safety system; null = not logged"),
    "distance_sd_m": Column(F64, "m", "its standard deviation; null = not logged"),
    "execution": Column(TEXT, "", "the execution's name in the log; null = not logged"),
    "source_row": Column(I64, "", "position in the log: a line, row, message or frame, see its entry in dataset.json"),
}
"""A safety system's log: override, distance or both, without positions."""

SKELETONS: Mapping[str, Column] = {
    "t_s": Column(F64, "s", "time in the log's clock"),
    "person": Column(TEXT, "", "track id, as in PEOPLE"),
    "joint": Column(TEXT, "", "name of the joint, lower case, from the tracker's documentation"),
    "x_m": Column(F64, "m", "position of the joint, the log's frame; null = not seen"),
    "y_m": Column(F64, "m", "as x_m"),
    "z_m": Column(F64, "m", "as x_m"),
    "source_row": Column(I64, "", "position in the log, as in PEOPLE"),
}
"""Every joint of every person: personal data, kept only on request (`--keep-skeletons`); not used by estimates."""

STAMPS: Mapping[str, Column] = {
    "t_s": Column(F64, "s", "time in the log's clock, which is the device's"),
    "host_s": Column(F64, "s", "time of reception by the recording computer, seconds since 1970 in its clock"),
}
"""Two stamps per row, if a log has both: they relate the device's clock to its host's."""

OF_LOGS: Mapping[str, Mapping[str, Column]] = {
    "robot": ROBOT,
    "people": PEOPLE,
    "events": EVENTS,
    "task_list": TASK_LIST,
    "safety": SAFETY,
    "skeletons": SKELETONS,
    "stamps": STAMPS,
}
"""Tables that a log may provide, by name."""
MAIN = ("robot", "people", "events", "task_list", "safety")
"""Tables of which a log must have at least one; the first one gives its rate."""
UNRATED = ("events", "task_list")
"""Tables whose rows have no rate: events and tasks."""

SAMPLES: Mapping[str, Column] = {
    "execution": Column(TEXT, "", "name of the execution"),
    "t_s": Column(F64, "s", "time since the start of the session, robot clock"),
    "robot_x_m": Column(F64, "m", "x_r: TCP, base frame"),
    "robot_y_m": Column(F64, "m", "x_r"),
    "robot_z_m": Column(F64, "m", "x_r"),
    "human_x_m": Column(F64, "m", "x_h: operator, base frame; null = absent or not seen"),
    "human_y_m": Column(F64, "m", "x_h"),
    "human_z_m": Column(F64, "m", "x_h"),
    "robot_goal_x_m": Column(F64, "m", "g_r: end of the robot's current motion"),
    "robot_goal_y_m": Column(F64, "m", "g_r"),
    "robot_goal_z_m": Column(F64, "m", "g_r"),
    "human_goal_x_m": Column(F64, "m", "g_h: end of the operator's current task"),
    "human_goal_y_m": Column(F64, "m", "g_h"),
    "human_goal_z_m": Column(F64, "m", "g_h"),
    "scaling": Column(F64, "1", "s: the safety system's speed scaling; null = unknown"),
    "scaling_origin": Column(TEXT, "", "logged or inferred; null where scaling is null"),
    "scaling_sd": Column(F64, "1", "standard deviation of scaling: 0 where logged; null where scaling is null"),
    "scaling_gap": Column(TEXT, "", "reason why scaling is null, one of SCALING_GAPS; else null"),
    "slider": Column(F64, "1", "the operator's speed slider; the robot's speed is scaling times it; null = not logged"),
    "step": Column(pl.Int32(), "", "index of the level, ascending; null = unknown or in a ramp"),
    "robot_task": Column(TEXT, "", "the robot's current task, `start->goal`"),
    "human_task": Column(TEXT, "", "the operator's current task, named by the place where it ends"),
    "robot_moving": Column(FLAG, "", "true from the departure to the arrival, also during a protective stop"),
    "human_gap": Column(TEXT, "", "reason why x_h is null: absent, occluded, outside (the tracker's log); else null"),
    "lost_to": Column(TEXT, "", "main cause of lost time, one of LOST_CAUSES; null = no lost time"),
    "human_signals": Column(
        I64, "", "z: operator signals that are on, bit k = entry k of operator_signals in dataset.json; null = unknown"
    ),
}
"""Samples (10 Hz by default) in one clock and one base frame."""

ADDED_TO_SAMPLES: Mapping[str, str | None] = {"human_signals": None}
"""Columns that datasets of earlier versions lack, and their default values."""

TASKS: Mapping[str, Column] = {
    "execution": Column(TEXT, "", "name of the execution"),
    "index": Column(pl.Int32(), "", "0-based order within the execution, counted for each agent"),
    "task": Column(TEXT, "", "`start->goal`, or its name in a task list"),
    "start_place": Column(TEXT, "", "start of the motion; null = from a task list"),
    "goal_place": Column(TEXT, "", "end of the motion, place of the dwell"),
    "start_s": Column(F64, "s", "start of the motion, or of a listed task, session time"),
    "arrival_s": Column(F64, "s", "end of the motion, session time; null = from a task list, or cut by the log"),
    "end_s": Column(F64, "s", "end of dwell and wait, or of a listed task, session time; null = not logged"),
    "nominal_s": Column(F64, "s", "duration of the motion at full speed; null = scaling unknown"),
    "safety_loss_s": Column(F64, "s", "time lost to speed scaling s below 1: integral of (1 - s) over the motion"),
    "dwell_s": Column(F64, "s", "process time at the goal"),
    "wait_s": Column(F64, "s", "standstill beyond dwell, or with the program paused, not explained by speed scaling"),
    "agent": Column(TEXT, "", "kind of the agent: robot or operator"),
    "agent_name": Column(TEXT, "", "the agent's name in a task list; null = not from a task list"),
    "planned_start_s": Column(F64, "s", "planned start, session time; null = not logged"),
    "planned_end_s": Column(F64, "s", "planned end, session time; null = not logged"),
    "outcome": Column(TEXT, "", "done, failed, or the log's word; null = not logged"),
    "reached_s": Column(F64, "s", "arrival at the waiting position short of the goal; null = no such position"),
    "went_on_s": Column(F64, "s", "departure from there; reached_s if the robot did not stop; null = no such position"),
    "waited_for": Column(TEXT, "", "event that ended the wait, such as `operator leaves fixture`; null = unknown"),
    "lost_person_s": Column(F64, "s", "time lost because a person was near"),
    "lost_slider_s": Column(F64, "s", "time lost to the operator's speed slider: integral of s (1 - slider)"),
    "lost_input_s": Column(F64, "s", "time lost to an input that slows the robot, such as reduced mode"),
    "lost_limits_s": Column(F64, "s", "time lost where the robot is slow in every pass: stopping or joint limits"),
    "lost_wait_s": Column(F64, "s", "wait for the operator, a part or a signal"),
    "lost_pause_s": Column(F64, "s", "time in which the program was paused or stopped"),
    "lost_stop_s": Column(F64, "s", "standstill between places without a person near: protective stop"),
    "lost_unknown_s": Column(F64, "s", "time lost to speed scaling of unknown cause"),
    "cut": Column(FLAG, "", "the robot stood at least so long: the log or the execution ends; null = unknown"),
}
"""One row per executed task. For a task found in the robot's motion, nominal + lost slider + safety loss + dwell + wait
= end - start. Safety loss is the sum of lost person, input, limits, stop and unknown; wait is the sum of lost wait and
pause; so the eight `lost_` columns add up to all lost time. The time of a cause is what would be saved without it but
with those before it: slider, limits, input, person, protective stop. A task from a task list has only start, end and
plan: no places, no motion, no time account."""

HISTORY: Mapping[str, Column] = {
    "execution": Column(TEXT, "", "name of the execution"),
    "agent": Column(TEXT, "", "robot, operator, the name of an agent of a task list, or `signal`"),
    "activity": Column(TEXT, "", "the task, or the signal"),
    "place": Column(TEXT, "", "place of the task; null = from a task list, or a signal"),
    "begin_s": Column(F64, "s", "start of the motion or task, or the signal came on; null = on before the execution"),
    "there_s": Column(F64, "s", "arrival at the place; null = from a task list, or not reached"),
    "ready_s": Column(F64, "s", "end of the own work, after which the agent waits; null = not logged"),
    "end_s": Column(F64, "s", "end of work and wait, or the signal went off; null = after the log or the execution"),
    "waited_for": Column(TEXT, "", "event that ended the wait, such as `operator leaves fixture`; null = unknown"),
    "cut": Column(FLAG, "", "the end of the log or of the execution cuts it: it lasted at least so long"),
}
"""What each agent did, and when each signal was on; times since the start of the execution."""

SCALING_CAUSES = ("person", "input", "limits", "stop", "unknown")
"""Causes of a speed scaling below 1, into which `safety_loss_s` is split."""
LOST_CAUSES = ("person", "slider", "input", "limits", "wait", "pause", "stop", "unknown")
"""All causes of lost time; `lost_CAUSE_s` in table TASKS."""

ADDED_TO_TASKS: Mapping[str, str | None] = {
    "agent": "robot",
    "agent_name": None,
    "planned_start_s": None,
    "planned_end_s": None,
    "outcome": None,
    "reached_s": None,
    "went_on_s": None,
    "waited_for": None,
    **{f"lost_{cause}_s": None for cause in LOST_CAUSES},
    "cut": None,
}
"""Columns that datasets of earlier versions lack, and their default values."""

SCALING_GAPS = (
    "standing",
    "paused",
    "stopped",
    "not logged",
    "no reference",
    "never at full speed",
    "other path",
    "too slow to tell",
    "log gap",
)
"""Reasons for an unknown scaling, in order: standstill at a place; program paused; program stopped; not logged and not
inferred; too few repetitions show the motion at full speed; the motion was slowed in every repetition; it took another
path than its repetitions; it was too slow to infer the scaling; gap in the log."""


QUARANTINE: Mapping[str, Column] = {
    "recording": Column(TEXT, "", "id of the recording"),
    "file": Column(TEXT, "", "path of the log, relative to the folder of logs"),
    "source_row": Column(I64, "", "position in the log; null if the damage has no row"),
    "row_is": Column(TEXT, "", "unit of source_row: line (from 1), row, message or frame (from 0)"),
    "reason": Column(TEXT, "", "reason why it is not used"),
}
"""Rows (or messages, or damaged parts) of the logs that are in no other table."""


@lru_cache(maxsize=1024)
def is_joint(name: str) -> bool:
    """Return whether a column is a joint angle (`q3_rad`) or joint speed (`qd3_rad_s`)."""
    stem, _, unit = name.partition("_")
    digits = stem.removeprefix("qd") if stem.startswith("qd") else stem.removeprefix("q")
    return stem.startswith("q") and digits.isdigit() and unit == ("rad_s" if stem.startswith("qd") else "rad")


def empty(table: Mapping[str, Column]) -> pl.DataFrame:
    """Return an empty frame with exactly the columns of `table`."""
    return pl.DataFrame(schema={name: column.dtype for name, column in table.items()})


def conform(frame: pl.DataFrame | pl.LazyFrame, table: Mapping[str, Column]) -> pl.DataFrame:
    """Return `frame` with the columns of `table`, in order and type; missing ones are null.

    If `table` is ROBOT, joint columns are kept after the others. A lazy frame is computed.

    Raises:
        ShapeError: `frame` has a column that the table does not have (an error of an adapter).
    """
    if isinstance(frame, pl.LazyFrame):  # a table in memory: optimisation takes longer than it saves
        frame = frame.collect(engine="in-memory", optimizations=_AS_IT_IS)
    have = frame.schema
    joints = sorted((name for name in have if is_joint(name)), key=joint_order) if table is ROBOT else []
    if unknown := set(have) - set(table) - set(joints):
        msg = f"columns {sorted(unknown)} are not in the canonical table ({', '.join(table)})"
        raise ShapeError(msg)
    wanted = {name: column.dtype for name, column in table.items()} | dict.fromkeys(joints, F64)
    if list(have.items()) == list(wanted.items()):
        return frame
    return pl.DataFrame(
        [
            frame.get_column(name).cast(dtype)
            if name in have
            else _nothing(name, dtype).new_from_index(0, frame.height)
            for name, dtype in wanted.items()
        ]
    )


@lru_cache(maxsize=256)
def _nothing(name: str, dtype: pl.DataType) -> pl.Series:
    """Return a column with a single null."""
    return pl.Series(name, [None], dtype=dtype)


def joint_order(name: str) -> tuple[bool, int]:
    """Return the sort key of joint columns: angles before speeds, each by number."""
    speed = name.startswith("qd")
    return speed, int(name.removeprefix("qd" if speed else "q").partition("_")[0])


_UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


def joints_from_base(names: Sequence[str]) -> list[int]:
    """Return the indices of the joints in order from the base, by their names; in the given order if unclear."""
    ur = [[i for i, name in enumerate(names) if part in name] for part in _UR_JOINTS]
    if len(names) == len(_UR_JOINTS) and all(len(found) == 1 for found in ur):
        return [found[0] for found in ur]
    numbers = [re.findall(r"\d+", name)[-1:] for name in names]
    if all(numbers) and len({int(n[0]) for n in numbers}) == len(names):
        return sorted(range(len(names)), key=lambda i: int(numbers[i][0]))
    return list(range(len(names)))
