"""Irreducible uncertainty: many futures of the same state, and the spread of their speed scalings.

The state is complete at that time: the robot's position in its motion, its past tasks, the operator's position, current
walk and past stations. The future is drawn from another random stream.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.choices import LOGGED, OPERATOR, legs_again, operator_legs, places_again, stream
from cyclekit_sim.engine import Trace, scaling_after
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.plan import Work, prepare, process_times, run_alone
from cyclekit_sim.program import WAIT, Execution, Program, compile_program
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.walking import Leg, WalkedTrack

FUTURES, EVERY_S = 16, 2.0
"""Number of futures of a state, and time between two states of an execution, s."""


def spread_ahead(scene: str, seed: int, executions: int, numbers: Sequence[int], after_s: float) -> Array:
    """Return the variance of the scaling after a time over the futures of states, shape (S,).

    Args:
        scene: A scene whose executions start afresh, without latency, hysteresis and ramps.
        seed: Seed of the simulation, as in `simulate`.
        executions: Number of simulated executions; enough to include every possible move.
        numbers: Executions from which states are taken, one per `EVERY_S`.
        after_s: Prediction horizon, s.
    """
    work = prepare(BUILT_IN[scene], seed, SimulationOptions(), executions=executions)
    found = []
    for trace in run_alone(work, [work.executions[number] for number in numbers]):
        cycles = np.arange(0.0, trace.duration_s - after_s, EVERY_S) / trace.cycle_s
        states = [int(cycle) for cycle in np.rint(cycles)]
        scalings = scaling_of_futures(work, trace, states, after_s, FUTURES)
        found.append(scalings.var(axis=1, ddof=1))
    return np.concatenate(found)


def scaling_of_futures(work: Work, trace: Trace, cycles: Sequence[int], after_s: float, count: int) -> Array:
    """Return the scaling `after_s` after each of some control cycles of a run, shape (cycles, count)."""
    number, legs = trace.program.executions[0].index, _legs(work, trace)
    programs, tracks = [], []
    for cycle in cycles:
        past, into_s = _until(legs, cycle * trace.cycle_s)
        for future in range(count):
            rng = np.random.default_rng([work.seed, number, cycle, future])
            programs.append(_program_again(work, trace, cycle, rng))
            tracks.append(WalkedTrack(legs_again(work.scene, past, into_s, rng), skip_s=into_s))
    begins = (np.repeat(trace.segment[list(cycles)], count), np.repeat(trace.nominal_s[list(cycles)], count))
    options, safety = work.options, work.scene.safety
    found = scaling_after(programs, tracks, begins, after_s, table=work.table, safety=safety, options=options)
    return found.reshape(-1, count)


def _legs(work: Work, trace: Trace) -> list[Leg]:
    """Return the operator's actual legs of a run, up to its end."""
    rng = stream(work.seed, work.scene, OPERATOR, trace.program.executions[0].index, domain=LOGGED)
    found, end_s = [], 0.0
    for leg in operator_legs(work.scene, rng):
        found.append(leg)
        end_s += float(leg.t_s[-1])
        if end_s > trace.duration_s:
            break
    return found


def _until(legs: Sequence[Leg], t_s: float) -> tuple[list[Leg], float]:
    """Return the legs up to the running one, and the time since that one started."""
    ends = np.cumsum([leg.t_s[-1] for leg in legs])
    running = min(int(np.searchsorted(ends, t_s, side="right")), len(legs) - 1)
    return list(legs[: running + 1]), t_s - float(ends[running] - legs[running].t_s[-1])


def _program_again(work: Work, trace: Trace, cycle: int, rng: np.random.Generator) -> Program:
    """Return the program of a run with everything after a cycle redrawn."""
    program, segment = trace.program, trace.segment[cycle]
    (execution,), task = program.executions, int(program.task[segment])
    places = execution.places if task < 0 else places_again(work.scene, execution.places, task, rng)
    waits = tuple(_waits(work, execution, task, program.kind[segment] == WAIT, float(trace.nominal_s[cycle]), rng))
    pick_s, place_s = process_times(work)
    again = replace(execution, places=places, wait_s=waits)
    return compile_program([again], work.table, pick_s=pick_s, place_s=place_s)


def _waits(
    work: Work, execution: Execution, task: int, waiting: bool, waited_s: float, rng: np.random.Generator
) -> Iterator[float]:
    """Yield the wait of each task: boxes arrive at any time, so a running wait lasts on as if it had just begun."""
    for number, wait_s in enumerate(execution.wait_s):
        if number < task or wait_s == 0 or task < 0:
            yield wait_s
        else:
            yield float(rng.exponential(work.scene.wait_s)) + (waited_s if number == task and waiting else 0.0)
