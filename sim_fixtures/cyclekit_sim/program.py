"""The robot's program: places in visiting order to segments in nominal time.

A segment is a move (which the safety function stretches), a dwell (gripping or releasing), a wait (the box is not there
yet) or an idle stay (at home between two executions). `engine` runs the segments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array
from cyclekit_sim.motion import MotionTable

MOVE, DWELL, WAIT, IDLE = 0, 1, 2, 3
HOME = "home"
Ints = NDArray[np.int64]
Column = tuple[int, float, int, float, int, int, int, int]
"""kind, length_s, row, rows_per_s, task, execution, closed_before, closed_after of a segment."""


@dataclass(frozen=True)
class Execution:
    """One execution to run: its number, places in visiting order, the wait on arrival at each, the idle stay after it.

    `wait_s` has one value per task (one fewer than `places`).
    """

    index: int
    places: tuple[str, ...]
    wait_s: tuple[float, ...]
    idle_s: float = 0.0


@dataclass(frozen=True)
class Program:
    """S consecutive segments, and what is needed to read a robot state from the motion table at any nominal time.

    Attributes:
        kind: MOVE, DWELL, WAIT or IDLE (S,).
        length_s: Nominal length (S,).
        row: First row of the segment in the motion table (S,).
        rows_per_s: Table rows per nominal second (S,); 0 at standstill.
        task: Task number within the execution (S,).
        execution: Execution number (S,); -1 on an idle stay.
        closed_before: Gripper closed in the first half of the segment (S,).
        closed_after: Gripper closed in its second half (S,).
        goals: Name of the goal place per segment.
        executions: The executions of the program.
    """

    kind: Ints
    length_s: Array
    row: Ints
    rows_per_s: Array
    task: Ints
    execution: Ints
    closed_before: Ints
    closed_after: Ints
    goals: tuple[str, ...]
    executions: tuple[Execution, ...]


def compile_program(executions: Sequence[Execution], table: MotionTable, *, pick_s: float, place_s: float) -> Program:
    """Return the executions as segments: move, wait, dwell, task by task.

    The gripper decides what a dwell is: an empty one picks, a full one places. There is no process at home.
    """
    columns: list[Column] = []
    goals: list[str] = []
    closed = 0
    for execution in executions:
        for task, pair in enumerate(zip(execution.places[:-1], execution.places[1:], strict=True)):
            first, rows, length = table.first_row[pair], table.rows[pair], table.duration_s[pair]
            stand, who = first + rows, (task, execution.index)
            columns.append((MOVE, length, first, rows / length, *who, closed, closed))
            if execution.wait_s[task] > 0:
                columns.append((WAIT, execution.wait_s[task], stand, 0.0, *who, closed, closed))
            if pair[1] != HOME:
                columns.append((DWELL, place_s if closed else pick_s, stand, 0.0, *who, closed, 1 - closed))
                closed = 1 - closed
            goals += [pair[1]] * (len(columns) - len(goals))
        if execution.idle_s > 0:
            columns.append((IDLE, execution.idle_s, stand, 0.0, -1, -1, closed, closed))
            goals.append(execution.places[-1])
    return program_of(columns, goals, executions)


def program_of(columns: Sequence[Column], goals: Sequence[str], executions: Sequence[Execution]) -> Program:
    """Return the program of these segments with their goals."""
    kind, length_s, row, per_s, task_no, index, before, after = zip(*columns, strict=True)

    def whole(values: Sequence[int]) -> Ints:
        return np.array(values, dtype=np.int64)

    return Program(
        kind=whole(kind),
        length_s=np.array(length_s),
        row=whole(row),
        rows_per_s=np.array(per_s),
        task=whole(task_no),
        execution=whole(index),
        closed_before=whole(before),
        closed_after=whole(after),
        goals=tuple(goals),
        executions=tuple(executions),
    )
