"""One recording session: runs arranged in session time, with states of robot and person.

Session time is 0 at the first robot sample. Between two runs the robot's logger is off, while the tracker continues and
sees the operator return to the start of the next run. The writers choose clock, frame, unit and file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array, rotation_vector
from cyclekit_sim.engine import Trace
from cyclekit_sim.motion import MotionTable
from cyclekit_sim.program import MOVE, Ints
from cyclekit_sim.walking import Press


@dataclass(frozen=True)
class RobotStates:
    """The robot at N control cycles, ascending in time.

    Attributes:
        t_s: Session time (N,).
        q_rad, qd_rad_s: Joints and their speeds (N, 6).
        tcp_m: TCP position (N, 3).
        quaternion: TCP orientation x, y, z, w (N, 4).
        twist: TCP velocity, linear then angular (N, 6).
        scaling: s (N,).
        closed: Gripper closed, 0 or 1 (N,).
        execution: Execution number; on an idle stay that of the previous execution (N,).
        slider: The operator's speed slider (N,).
        paused: Whether the program is paused (N,).
        inputs: Digital inputs as a bit field (N,).
    """

    t_s: Array
    q_rad: Array
    qd_rad_s: Array
    tcp_m: Array
    quaternion: Array
    twist: Array
    scaling: Array
    closed: Ints
    execution: Ints
    slider: Array
    paused: NDArray[np.bool_]
    inputs: Ints

    @property
    def rotation_vector(self) -> Array:
        """TCP orientation as a rotation vector (N, 3), rad."""
        return rotation_vector(self.quaternion)


@dataclass(frozen=True)
class Session:
    """Runs and their starts (session time, whole control cycles).

    `signals` holds time, name and value of the logged events; None: the operator's button presses.
    """

    index: int
    traces: tuple[Trace, ...]
    begins_s: tuple[float, ...]
    table: MotionTable
    signals: tuple[tuple[float, str, str], ...] | None = None

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"session_{self.index:03d}"

    @property
    def end_s(self) -> float:
        """End of the last run, s."""
        return self.begins_s[-1] + self.traces[-1].duration_s

    @cached_property
    def robot(self) -> RobotStates:
        """The controller's states, cycle by cycle."""
        parts = [robot_states(t, self.table, begin_s=b) for t, b in zip(self.traces, self.begins_s, strict=True)]
        names = RobotStates.__dataclass_fields__
        return RobotStates(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @property
    def people(self) -> int:
        """Number of people."""
        return 1 + len(self.traces[0].others)

    def person(self, t_s: Array, number: int = 0) -> Array:
        """Return the position of a person (M, 3), base frame, at session times (M,); NaN: absent."""
        tracks = [(trace.track, *trace.others)[number] for trace in self.traces]
        found = np.empty((len(t_s), 3))
        ends = [b + trace.duration_s for b, trace in zip(self.begins_s, self.traces, strict=True)]
        for i, (trace, begin) in enumerate(zip(self.traces, self.begins_s, strict=True)):
            last = i + 1 == len(self.traces)
            mine = (t_s >= begin if i else np.ones(len(t_s), dtype=bool)) & ((t_s <= ends[i]) | last)
            found[mine] = tracks[i].at(np.clip(t_s[mine] - begin, 0.0, trace.duration_s))
            if not last:
                here = tracks[i].at(np.array([trace.duration_s]))
                there = tracks[i + 1].at(np.array([0.0]))
                between = (t_s > ends[i]) & (t_s < self.begins_s[i + 1])
                done = (t_s[between] - ends[i]) / (self.begins_s[i + 1] - ends[i])
                found[between] = here + (done**2 * (3 - 2 * done))[:, None] * (there - here)
        return found

    def events(self) -> list[tuple[float, str, str]]:
        """Return time, name and value of each event, in session time."""
        if self.signals is not None:
            return list(self.signals)
        return [(press.t_s, "operator_goal", press.goal) for press in self.presses()]

    def presses(self) -> list[Press]:
        """Return the operator's button presses, in session time."""
        return [
            Press(begin + press.t_s, press.goal, press.goal_m)
            for trace, begin in zip(self.traces, self.begins_s, strict=True)
            for press in trace.track.presses(trace.duration_s)
        ]


def robot_states(trace: Trace, table: MotionTable, *, begin_s: float, cycles: Ints | None = None) -> RobotStates:
    """Return the robot of one run at its control cycles (all of them, or those numbered in `cycles`)."""
    k = np.arange(len(trace.scaling)) if cycles is None else cycles
    of, program = trace.segment[k], trace.program
    below, way = (part[k] for part in trace.rows())
    above, share = np.minimum(below + 1, len(table.q_rad) - 1), way[:, None]

    def read(column: Array) -> Array:
        return np.asarray(column[below] + share * (column[above] - column[below]))

    speed = np.where(program.kind[of] == MOVE, trace.pace[k], 0.0)[:, None]
    turned = read(table.quaternion)
    late = trace.nominal_s[k] >= 0.5 * program.length_s[of]
    running = np.where(program.execution < 0, np.roll(program.execution, 1), program.execution)
    return RobotStates(
        t_s=np.asarray(begin_s + k * trace.cycle_s, dtype=np.float64),
        q_rad=read(table.q_rad),
        qd_rad_s=read(table.qd_rad_s) * speed,
        tcp_m=read(table.tcp_m),
        quaternion=turned / np.linalg.norm(turned, axis=1, keepdims=True),
        twist=read(table.twist) * speed,
        scaling=trace.scaling[k],
        closed=np.where(late, program.closed_after[of], program.closed_before[of]),
        execution=running[of],
        slider=np.ones(len(k)) if trace.caps is None else trace.caps.slider[k],
        paused=np.zeros(len(k), dtype=bool) if trace.caps is None else trace.caps.paused[k],
        inputs=np.zeros(len(k), dtype=np.int64) if trace.inputs is None else trace.inputs[k],
    )
