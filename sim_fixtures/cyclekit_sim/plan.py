"""From a scene and a seed to simulated sessions: draws executions, runs them in batches, sets session time.

`simulate` writes them to disk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.choices import (
    FRESH,
    LOGGED,
    OPERATOR,
    PARTS,
    PAUSE,
    ROBOT,
    SLOWING,
    draw_execution,
    draw_places,
    operator_legs,
    stream,
)
from cyclekit_sim.engine import Trace, run
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.fields import with_inputs
from cyclekit_sim.motion import MotionTable, plan_moves
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.program import HOME, Execution, compile_program
from cyclekit_sim.recorded import read_recording
from cyclekit_sim.scenes import Scene
from cyclekit_sim.session import Session
from cyclekit_sim.walking import Nobody, RecordedTrack, Track, WalkedTrack

_BATCH = 128  # executions simulated in parallel
_CONTINUOUS = 60  # executions in one recording without pauses: about 110 minutes
_PAUSE_S = (6.0, 9.0)


@dataclass(frozen=True)
class Work:
    """Content of a simulation: the scene, its motion table, and the executions in order."""

    scene: Scene
    seed: int
    options: SimulationOptions
    table: MotionTable
    executions: tuple[Execution, ...]
    domain: int
    recording: tuple[Array, Array] | None


def prepare(
    scene: Scene, seed: int, options: SimulationOptions, *, executions: int, places: Sequence[str] | None = None
) -> Work:
    """Draw every execution (or use `places` for each) and plan the moves they need.

    Raises:
        SimulationError: A place is unknown, the sequence is invalid, or the recording cannot be read.
    """
    if executions < 1:
        raise SimulationError(f"executions is {executions}: simulate at least one")
    domain = LOGGED if places is None else FRESH
    if places is not None:
        _check_places(scene, places)
    drawn = []
    for index in range(executions):
        rng = stream(seed, scene, ROBOT, index, domain=domain)
        product = options.products[index % len(options.products)] if options.products else None
        visited = tuple(places or (product.places if product else draw_places(scene, rng)))
        execution = draw_execution(scene, index, visited, rng, options.causes)
        more = product.process_s if product else {}
        waits = tuple(wait + more.get(goal, 0.0) for wait, goal in zip(execution.wait_s, visited[1:], strict=True))
        drawn.append(replace(execution, wait_s=waits))
    pairs = {pair for e in drawn for pair in zip(e.places[:-1], e.places[1:], strict=True)}
    recording = read_recording(options.operator_log, options) if options.operator_log else None
    return Work(scene, seed, options, plan_moves(scene.places, pairs), tuple(drawn), domain, recording)


def run_alone(work: Work, batch: Sequence[Execution], progress: Callable[[float], None] | None = None) -> list[Trace]:
    """Run each execution separately, with a fresh start of both agents."""
    return _run(work, [[execution] for execution in batch], progress)


def run_sessions(work: Work, progress: Callable[[float], None] | None = None) -> Iterator[Session]:
    """Yield the sessions in order."""
    scene, options = work.scene, work.options
    size = max(options.executions_per_session, _CONTINUOUS) if scene.continuous else options.executions_per_session
    parts = [work.executions[i : i + size] for i in range(0, len(work.executions), size)]
    per_batch = 1 if scene.continuous else max(1, _BATCH // size)
    for first in range(0, len(parts), per_batch):
        batch = parts[first : first + per_batch]

        def report(done: float, first: int = first, count: int = len(batch)) -> None:
            if progress is not None:
                progress((first + done * count) / len(parts))

        groups = [list(part) for part in batch] if scene.continuous else [[e] for part in batch for e in part]
        traces = iter(_run(work, groups, report))
        for number, part in enumerate(batch, start=first):
            mine = [next(traces)] if scene.continuous else [next(traces) for _ in part]
            yield Session(number, tuple(mine), begins_of(scene, work.seed, options, mine), work.table)


def _run(work: Work, groups: list[list[Execution]], progress: Callable[[float], None] | None) -> list[Trace]:
    scene = work.scene
    pick_s, place_s = process_times(work)
    programs = [compile_program(group, work.table, pick_s=pick_s, place_s=place_s) for group in groups]
    tracks = [_track(work, group[0].index) for group in groups]
    streams = [stream(work.seed, scene, SLOWING, group[0].index, domain=work.domain) for group in groups]
    traces = run(
        programs,
        tracks,
        table=work.table,
        safety=scene.safety,
        options=work.options,
        streams=streams,
        progress=progress,
    )
    if work.options.people not in ("signals", "both"):
        return traces
    parts = [stream(work.seed, scene, PARTS, group[0].index, domain=work.domain) for group in groups]
    return [with_inputs(trace, scene.fields, rng) for trace, rng in zip(traces, parts, strict=True)]


def process_times(work: Work) -> tuple[float, float]:
    """Return the process times of picking and placing, s."""
    options, scene = work.options, work.scene
    pick_s = scene.pick_s if options.pick_s is None else options.pick_s
    return pick_s, scene.place_s if options.place_s is None else options.place_s


def _track(work: Work, index: int) -> Track:
    if not work.options.with_operator:
        return Nobody()
    rng = stream(work.seed, work.scene, OPERATOR, index, domain=work.domain)
    if work.recording is not None:
        t_s, xyz_m = work.recording
        return RecordedTrack(t_s, xyz_m, float(rng.uniform(0.0, 2 * t_s[-1])))
    # An operator who roams or visits has been doing so for some time when a fresh execution starts.
    at_any_time = work.scene.operator == "visit" or (work.scene.continuous and work.domain == FRESH)
    skip_s = float(rng.uniform(60.0, 120.0)) if at_any_time else 0.0
    return WalkedTrack(operator_legs(work.scene, rng), skip_s=skip_s)


def begins_of(scene: Scene, seed: int, options: SimulationOptions, traces: Sequence[Trace]) -> tuple[float, ...]:
    """Return the start of each run, a pause after the previous one, on whole control cycles."""
    cycle_s, begins, at = options.cycle_s, [0.0], 0.0
    for before, after in pairwise(traces):
        rng = stream(seed, scene, PAUSE, after.program.executions[0].index)
        at = float(np.ceil((at + before.duration_s + rng.uniform(*_PAUSE_S)) / cycle_s)) * cycle_s
        begins.append(at)
    return tuple(begins)


def _check_places(scene: Scene, places: Sequence[str]) -> None:
    if unknown := sorted(set(places) - set(scene.places)):
        raise SimulationError(f"{scene.name} has no place {', '.join(unknown)}; it has {', '.join(scene.places)}")
    if len(places) < 2 or any(a == b for a, b in pairwise(places)):
        raise SimulationError("a sequence needs two places or more, and no place twice in a row")
    if places[0] != HOME:
        raise SimulationError(f"a sequence starts at {HOME!r}, not at {places[0]!r}")
