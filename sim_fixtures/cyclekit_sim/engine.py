"""Simulation loop: programs, tracks and a safety function, one control cycle at a time.

The scaling acts as time scaling: while the robot moves, the nominal time of its program advances at the rate s; while
it dwells or waits, at rate 1. Many cells are simulated in parallel. The result is minimal (nominal time, s and segment
per cycle, and the end of each segment); the writers turn it into logs and truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array, link_frames
from cyclekit_sim.causes import PART_BIT, REDUCED_BIT, Caps, Slowing, part_there, scaling_of
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.motion import MotionTable
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.program import Ints, Program
from cyclekit_sim.program_state import ProgramState
from cyclekit_sim.safety import SafetyFunction, SafetyInputs, SpeedScaling
from cyclekit_sim.walking import Track

_Now = tuple[Array, NDArray[np.bool_], NDArray[np.bool_], Array]
_CHUNK = 1024  # cycles between two checks whether all are done
_SLOWEST = 20.0  # a run longer than its nominal time by this factor is stuck
_FAR_M = 1e6  # position of an absent person


@dataclass(frozen=True)
class Trace:
    """Result of one run: K control cycles, S segments.

    Attributes:
        program: The program that was run.
        track: The person's track.
        nominal_s: Nominal time since the start of the running segment, at the start of each cycle (K,).
        scaling: s, held over the cycle (K,), all its causes together.
        segment: Running segment (K,).
        ends_s: Real time since the start of the run when each segment ended (S,).
        cycle_s: Length of a cycle.
        caps: Causes of s, slider and pauses; None: the person only.
        inputs: Digital inputs as a bit field (K,); None: there are none.
        others: The tracks of further people.
    """

    program: Program
    track: Track
    nominal_s: Array
    scaling: Array
    segment: Ints
    ends_s: Array
    cycle_s: float
    caps: Caps | None = None
    inputs: Ints | None = None
    others: tuple[Track, ...] = ()

    @property
    def duration_s(self) -> float:
        """Duration of the run, s."""
        return float(self.ends_s[-1])

    @property
    def pace(self) -> Array:
        """Rate at which the nominal time of a move advances (K,): s times slider, 0 in a pause."""
        if self.caps is None:
            return self.scaling
        return np.where(self.caps.paused, 0.0, self.scaling * self.caps.slider)

    @property
    def begins_s(self) -> Array:
        """Real time since the start of the run when each segment began (S,)."""
        return np.concatenate([[0.0], self.ends_s[:-1]])

    def rows(self) -> tuple[Ints, Array]:
        """Return the row of the motion table at the start of each cycle (K,), and the fraction to the next row (K,)."""
        return table_rows(self.program.row[self.segment], self.nominal_s, self.program.rows_per_s[self.segment])


def table_rows(first: Ints, nominal_s: Array, rows_per_s: Array) -> tuple[Ints, Array]:
    """Return table rows and the fraction of the way to the next row, in [0, 1).

    The fraction counts from the start of the segment, so it does not depend on the position of the move in the table.
    """
    within = nominal_s * rows_per_s
    below = within.astype(np.int64)
    return first + below, within - below


class Arms:
    """Inputs of a safety function for robots that follow a motion table."""

    def __init__(self, table: MotionTable) -> None:
        self._q_rad = table.q_rad
        self._tcp, self._tcp_step = table.tcp_m, np.diff(table.tcp_m, axis=0, append=table.tcp_m[-1:])

    def seen(self, row: Ints, way: Array, person_m: Array) -> SafetyInputs:
        """Return the inputs for robots (B,) at these table rows and persons (B, 3), m."""
        tcp_m = self._tcp.take(row, axis=0) + way[:, None] * self._tcp_step.take(row, axis=0)
        return SafetyInputs(tcp_m, person_m, lambda: self._links_m(row, way))

    def _links_m(self, row: Ints, way: Array) -> Array:
        """Return the joints from base to TCP (B, 7, 3), m."""
        q_rad, after = self._q_rad[row], self._q_rad[np.minimum(row + 1, len(self._q_rad) - 1)]
        origins, _, _ = link_frames(q_rad + way[:, None] * (after - q_rad))
        return origins.transpose(1, 0, 2)


class _Cells:
    """B cells at one time."""

    def __init__(self, programs: Sequence[Program], table: MotionTable, scaling: SpeedScaling, cycle_s: float) -> None:
        self.state, self._scaling, self._arms = ProgramState(programs, cycle_s), scaling, Arms(table)

    def step(self, t_s: float, person_m: Array, slowing: Slowing | None, now: _Now | None) -> tuple[Array, Array, Ints]:
        """Advance by one cycle from `t_s`; return nominal time, s and segment (B,) at its start.

        s is that of the safety function alone; `slowing` holds the other causes, `now` their values at this time.
        """
        state = self.state
        u, segment = state.nominal_s, state.segment
        s = self._scaling.advance(self._arms.seen(*table_rows(state.row, u, state.rows_per_s), person_m))
        pace: Array = s
        standing: Array | float = 1.0
        if slowing is not None and now is not None:
            slider, limit = slowing.segment_caps(segment, u)
            reduced, stopped, paused, turned = now
            pace = np.where(stopped | paused, 0.0, np.minimum(np.minimum(s, reduced), limit) * slider * turned)
            standing = np.where(paused, 0.0, 1.0)
        state.advance(t_s, pace, standing)
        return u, s, segment


def run(
    programs: Sequence[Program],
    tracks: Sequence[Track],
    *,
    table: MotionTable,
    safety: SafetyFunction,
    options: SimulationOptions,
    streams: Sequence[np.random.Generator] = (),
    progress: Callable[[float], None] | None = None,
) -> list[Trace]:
    """Run B programs against B tracks until the last one is done; `streams` draw their other causes.

    Raises:
        SimulationError: A robot never finishes, because the person never leaves its way.
    """
    cells = _Cells(programs, table, SpeedScaling(safety, options), options.cycle_s)
    records: list[tuple[Array, Array, Ints]] = []
    limit_s = _SLOWEST * max(float(program.length_s.sum()) for program in programs)
    slowing = None if options.causes is None else Slowing(programs, options.causes, streams, limit_s)
    while cells.state.running.any():
        times = np.asarray((len(records) * _CHUNK + np.arange(_CHUNK)) * options.cycle_s, dtype=np.float64)
        if times[0] > limit_s:
            raise SimulationError(_stuck(programs[int(np.flatnonzero(cells.state.running)[0])], limit_s))
        people = np.stack([track.at(times) for track in tracks], axis=1)
        people = np.where(np.isnan(people), _FAR_M, people)
        now = [None] * _CHUNK if slowing is None else zip(*slowing.during(times), strict=True)
        steps = [
            cells.step(t_s, person, slowing, these)
            for t_s, person, these in zip(times.tolist(), people, now, strict=True)
        ]
        records.append((_stack(steps, 0), _stack(steps, 1), np.stack([step[2] for step in steps])))
        if progress is not None:
            progress(cells.state.share_done)
    nominal_s, scaling = (np.concatenate([record[i] for record in records]) for i in (0, 1))
    segment = np.concatenate([record[2] for record in records])
    traces = []
    for b, (program, track) in enumerate(zip(programs, tracks, strict=True)):
        ends_s = cells.state.ends_s[b, : len(program.kind)]
        n = int(np.ceil(ends_s[-1] / options.cycle_s - 1e-9))
        parts = nominal_s[:n, b].copy(), scaling[:n, b].copy(), segment[:n, b].copy()
        trace = Trace(program, track, *parts, ends_s, options.cycle_s)
        traces.append(trace if slowing is None else _with_causes(trace, slowing, b, options))
    return traces


def _with_causes(trace: Trace, slowing: Slowing, b: int, options: SimulationOptions) -> Trace:
    """Return run `b` with all its causes; its s so far is the person's."""
    times = np.asarray(np.arange(len(trace.scaling)) * trace.cycle_s, dtype=np.float64)
    caps = slowing.caps(b, times, trace.scaling, trace.segment, trace.nominal_s)
    there = part_there(trace.program, trace.segment) & bool(options.causes and options.causes.part_signal)
    inputs = (slowing.switched_on(b, times).astype(np.int64) << REDUCED_BIT) | (there.astype(np.int64) << PART_BIT)
    return replace(trace, scaling=scaling_of(caps), caps=caps, inputs=inputs)


def scaling_after(
    programs: Sequence[Program],
    tracks: Sequence[Track],
    begins: tuple[Ints, Array],
    after_s: float,
    *,
    table: MotionTable,
    safety: SafetyFunction,
    options: SimulationOptions,
) -> Array:
    """Return s (B,) a time after B cells started in the segments (B,) and nominal times (B,) of `begins`.

    Raises:
        SimulationError: The scaling depends on the past: latency, hysteresis or ramps.
    """
    if options.latency_s or options.hysteresis_m or options.ramp_down_per_s or options.ramp_up_per_s:
        raise SimulationError("futures are drawn without latency, hysteresis and ramps")
    cells = _Cells(programs, table, SpeedScaling(safety, options), options.cycle_s)
    cells.state.begin_at(*begins)
    times = np.asarray(np.arange(round(after_s / options.cycle_s) + 1) * options.cycle_s, dtype=np.float64)
    people = np.stack([track.at(times) for track in tracks], axis=1)
    for t_s, person in zip(times.tolist(), np.where(np.isnan(people), _FAR_M, people), strict=True):
        _, s, _ = cells.step(t_s, person, None, None)
    return s


def _stack(steps: list[tuple[Array, Array, Ints]], column: int) -> Array:
    return np.stack([np.asarray(step[column], dtype=np.float64) for step in steps])


def _stuck(program: Program, limit_s: float) -> str:
    return (
        f"execution {program.executions[0].index} is not done after {limit_s:.0f} s: a person stands so close that the "
        "robot never moves on. Move the operator (operator_xyz_m, operator_yaw_deg) farther from the robot."
    )
