"""Parallel simulation of robot, people and part source: each gate opens when its condition has ended.

The robot moves at the scaling that the safety function allows at the position of the nearest person in the same cycle;
the others continue at rate 1. The agents of all cells are the rows of one `ProgramState`, in the order of AGENTS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.choices import COUPLING, HELPER, OPERATOR, REPEATS, SOURCE, stream
from cyclekit_sim.coupled_program import (
    AGENTS,
    Opening,
    Order,
    Script,
    at_row,
    link,
    operator_script,
    people_of,
    robot_script,
    source_script,
    with_changes,
    with_repeats,
)
from cyclekit_sim.coupled_scenes import JOINT_TIMES, Coupled, Gate, Moment
from cyclekit_sim.engine import Arms, Trace, table_rows
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.motion import MotionTable
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.program import IDLE, Execution, Ints, Program
from cyclekit_sim.program_state import ProgramState
from cyclekit_sim.safety import SpeedScaling
from cyclekit_sim.session import Session
from cyclekit_sim.walking import Leg, WalkedTrack

_LONGEST_S = 1800.0
PULSE_S = (0.2, 0.6)
"""Duration range of a signal, s."""


@dataclass(frozen=True)
class Waited:
    """A wait of an agent: task, begin and end, s since the start of the execution, and gate."""

    agent: str
    task: int
    begin_s: float
    end_s: float
    opening: Opening


@dataclass(frozen=True)
class Cell:
    """One execution, ready to run."""

    scripts: dict[str, Script]
    openings: dict[str, list[Opening]]

    def programs(self) -> list[Program]:
        """Return the programs in the order of AGENTS."""
        return [self.scripts[agent].program(self.openings[agent]) for agent in AGENTS]


@dataclass(frozen=True)
class Done:
    """One finished execution: the ends of all segments of each agent, s since its start."""

    cell: Cell
    ends_s: dict[str, Array]

    @property
    def duration_s(self) -> float:
        """Time from the start to the last end of either agent, s."""
        return float(self.ends_s["robot"][-1])

    def moments_s(self, agent: str, place: str, moment: Moment) -> list[float]:
        """Return the times at which an agent arrived at a place, was done there, or left it."""
        return [float(self.ends_s[agent][at]) for at in self.cell.scripts[agent].moments[place, moment]]

    def signals(self, cell: Coupled) -> list[tuple[float, float, str]]:
        """Return begin and end of each signal, s, and its name: pulses, and the times in which a zone is taken."""
        rng = np.random.default_rng(self.cell.scripts["robot"].execution.index)
        taken = {(agent, gate.place): spans for agent, gate, spans in self.zones()}
        pulses = sorted(
            (t_s, name) for key, name in cell.signals.items() if key[:2] not in taken for t_s in self.moments_s(*key)
        )
        found = [(t_s, t_s + rng.uniform(*PULSE_S), name) for t_s, name in pulses]
        return found + [(*span, name) for key, name in cell.signals.items() for span in taken.get(key[:2], ())]

    def zones(self) -> Iterator[tuple[str, Gate, list[tuple[float, float]]]]:
        """Yield agent, gate, and the times in which the agent has taken the zone behind it, s."""
        for agent, script in self.cell.scripts.items():
            for gate in dict.fromkeys(gate for _, gate, _ in script.gates if gate.need.back is None):
                opens = [self.ends_s[agent][segment] for segment, other, _ in script.gates if other is gate]
                yield agent, gate, list(zip(opens, self.moments_s(agent, gate.place, "leaves"), strict=True))

    def waits(self, agent: str) -> Iterator[Waited]:
        """Yield the waits of an agent, including those of length 0."""
        ends_s, script = self.ends_s[agent], self.cell.scripts[agent]
        for opening in self.cell.openings[agent]:
            if opening.gate is not None:
                at = opening.segment
                yield Waited(agent, script.columns[at][4], float(ends_s[at - 1]), float(ends_s[at]), opening)

    def waited_s(self, agent: str) -> float:
        """Return the total wait of an agent, s."""
        return sum(wait.end_s - wait.begin_s for wait in self.waits(agent))


@dataclass(frozen=True)
class CoupledTrace(Trace):
    """Trace of the robot in one execution, with segments and waits of all agents."""

    done: Done = field(kw_only=True)


def coupled_runs(session: Session) -> list[tuple[CoupledTrace, float]]:
    """Return the runs of a coupled cell's session, and the start of each, s."""
    runs = zip(session.traces, session.begins_s, strict=True)
    return [(trace, begin_s) for trace, begin_s in runs if isinstance(trace, CoupledTrace)]


def make_cell(
    cell: Coupled, order: Order, table: MotionTable, seed: int, index: int, coupling: float, domain: int, pace: float
) -> Cell:
    """Draw one execution; the operator's walks and work take `pace` times as long as in the scene."""

    def drawn(purpose: int) -> np.random.Generator:
        return stream(seed, cell.scene, purpose, index, domain=domain)

    repeats, places = drawn(REPEATS), with_changes(cell, order["robot"], index)
    parts = 0 if cell.feed is None else order["robot"].count(cell.feed.place)
    scripts = {
        "robot": robot_script(cell, with_repeats(cell, places, repeats), table, index, repeats),
        "operator": operator_script(cell, order["operator"], index, drawn(OPERATOR), pace),
        "helper": Script(Execution(index, (), ())),
        "source": source_script(cell, parts, index, drawn(SOURCE)),
    }
    if cell.helper_jobs:
        scripts["helper"] = operator_script(cell, order["helper"], index, drawn(HELPER), pace, "helper")
    else:
        scripts["helper"].add(IDLE, 0.0, 0, 0.0, -1, "")
    rng = drawn(COUPLING)
    return Cell(scripts, link(cell, scripts, rng.random(JOINT_TIMES) < coupling, rng))


class _Gates:
    """Conditions of the gates of all agents: a segment of an agent and a lag, or a zone that nobody may be in.

    -1: none. A cell has one zone, which two agents take and give back.
    """

    def __init__(self, cells: Sequence[Cell], width: int) -> None:
        shape = (len(AGENTS) * len(cells), width)
        self._line, self._segment = np.full(shape, -1), np.full(shape, -1)
        self._lag_s, self._until = np.zeros(shape), np.full(shape, -1)
        self._taken_until = np.full(shape[0], -1)
        for a, agent in enumerate(AGENTS):
            for b, cell in enumerate(cells):
                for opening in cell.openings[agent]:
                    if opening.agent is not None:
                        row, at = a * len(cells) + b, opening.segment
                        self._line[row, at] = AGENTS.index(opening.agent) * len(cells) + b
                        self._segment[row, at], self._lag_s[row, at] = opening.needed, opening.lag_s
                        self._until[row, at] = opening.until

    def open(self, state: ProgramState) -> None:
        """Release the agents whose condition has ended."""
        waiting = state.waiting
        if len(waiting):
            at = (waiting, state.segment[waiting])
            ended_s = state.ends_s[self._line[at], self._segment[at]]
            asks = self._until[at] >= 0
            known = ~np.isnan(ended_s) & ~asks
            if known.any():
                state.release(waiting[known], (ended_s + self._lag_s[at])[known])
            if asks.any():
                self._enter(state, waiting[asks])

    def _enter(self, state: ProgramState, asking: Ints) -> None:
        """Let one of the two agents into the zone of each cell where nobody is: who has asked first."""
        asking = asking[np.argsort(state.ends_s[asking, state.segment[asking] - 1], kind="stable")]
        other = self._line[asking, state.segment[asking]]
        _, first = np.unique(np.minimum(asking, other), return_index=True)
        asking, other = asking[first], other[first]
        left_s = np.where(self._taken_until[other] < 0, -np.inf, state.ends_s[other, self._taken_until[other]])
        asking, left_s = asking[~np.isnan(left_s)], left_s[~np.isnan(left_s)]
        at = (asking, state.segment[asking])
        self._taken_until[asking] = self._until[at]
        state.release(asking, left_s + self._lag_s[at])


class _People:
    """Paths of one person in each of B cells in one table of positions."""

    def __init__(self, cells: Sequence[Cell], who: str) -> None:
        ways = [np.concatenate([leg.xyz_m for leg in cell.scripts[who].legs]) for cell in cells]
        self.first_row = np.concatenate([[0], np.cumsum([len(way) for way in ways])])
        self._xyz_m = np.concatenate(ways)
        self._step = np.diff(self._xyz_m, axis=0, append=self._xyz_m[-1:])

    def at(self, row: Ints, nominal_s: Array, rows_per_s: Array) -> Array:
        """Return their positions (B, 3), m."""
        row, way = table_rows(row, nominal_s, rows_per_s)
        return np.asarray(self._xyz_m.take(row, axis=0) + way[:, None] * self._step.take(row, axis=0))


def run_cells(
    cell: Coupled,
    cells: Sequence[Cell],
    table: MotionTable,
    options: SimulationOptions,
    *,
    logged: bool = False,
    progress: Callable[[float], None] | None = None,
) -> tuple[list[Done], list[CoupledTrace]]:
    """Simulate cells in parallel until all agents are done; traces only if `logged`.

    Raises:
        SimulationError: An agent never finishes.
    """
    people, count = {AGENTS.index(who): _People(cells, who) for who in people_of(cell)}, len(cells)
    columns = list(zip(*(each.programs() for each in cells), strict=True))
    for a, ways in people.items():
        columns[a] = tuple(at_row(one, int(row)) for one, row in zip(columns[a], ways.first_row[:-1], strict=True))
    state = ProgramState([one for column in columns for one in column], options.cycle_s)
    gates, arms = _Gates(cells, state.ends_s.shape[1]), Arms(table)
    scaling, ones = SpeedScaling(cell.scene.safety, options), np.ones((len(AGENTS) - 1) * count)
    records: list[tuple[Array, Array, Ints]] = []
    robots, cycle = slice(0, count), 0
    while state.running.any():
        t_s = cycle * options.cycle_s
        if t_s > _LONGEST_S:
            raise SimulationError(f"{cell.scene.name}: an agent is not done after {_LONGEST_S:.0f} s")
        u, segment = state.nominal_s, state.segment
        row, way = table_rows(state.row[robots], u[robots], state.rows_per_s[robots])
        persons_m = []
        for a, ways in people.items():
            mine = slice(a * count, (a + 1) * count)
            persons_m.append(ways.at(state.row[mine], u[mine], state.rows_per_s[mine]))
        s = scaling.advance(arms.seen(row, way, _nearest(persons_m, arms.seen(row, way, persons_m[0]).tcp_m)))
        gates.open(state)
        state.advance(t_s, np.concatenate([s, ones]), 1.0)
        cycle += 1
        if logged:
            records.append((u[robots], s, segment[robots]))
        if progress is not None and cycle % 1024 == 0:
            progress(state.share_done)
    done = [_done(each, state, b, count) for b, each in enumerate(cells)]
    return done, _traces(cell, done, records, options) if logged else []


def _nearest(persons_m: Sequence[Array], tcp_m: Array) -> Array:
    """Return the position of the person nearest to the TCP in each of B cells, shape (B, 3), m."""
    if len(persons_m) == 1:
        return persons_m[0]
    every_m = np.stack(persons_m)
    nearest = np.linalg.norm(every_m - tcp_m, axis=2).argmin(axis=0)
    return np.asarray(every_m[nearest, np.arange(len(nearest))])


def _done(cell: Cell, state: ProgramState, b: int, count: int) -> Done:
    ends = {
        agent: state.ends_s[a * count + b, : len(cell.scripts[agent].columns)].copy() for a, agent in enumerate(AGENTS)
    }
    return Done(cell, ends)


def _traces(
    cell: Coupled, done: Sequence[Done], records: list[tuple[Array, Array, Ints]], options: SimulationOptions
) -> list[CoupledTrace]:
    nominal_s = np.stack([u for u, _, _ in records])
    scaling, segment = np.stack([s for _, s, _ in records]), np.stack([of for _, _, of in records])
    found = []
    for b, each in enumerate(done):
        ends_s = each.ends_s["robot"]
        n = int(np.ceil(ends_s[-1] / options.cycle_s - 1e-9))
        program, ways = realised(each, "robot"), [_track(each, who) for who in people_of(cell)]
        at_s, s, of = nominal_s[:n, b].copy(), scaling[:n, b].copy(), segment[:n, b].astype(np.int64)
        inputs = _inputs(cell, each, n, options) if options.signals and cell.bits else None
        mine = (at_s, s, of, ends_s, options.cycle_s)
        others = tuple(ways[1:])
        found.append(CoupledTrace(program, ways[0], *mine, inputs=inputs, others=others, done=each))
    return found


def _inputs(cell: Coupled, done: Done, cycles: int, options: SimulationOptions) -> Ints:
    """Return the digital inputs as a bit field (K,)."""
    t_s = np.arange(cycles) * options.cycle_s
    found = np.zeros(cycles, dtype=np.int64)
    for begin_s, end_s, name in done.signals(cell):
        if name in cell.bits:
            found[(t_s >= begin_s) & (t_s < end_s)] |= 1 << cell.bits[name]
    return found


def realised(done: Done, agent: str) -> Program:
    """Return the program of an agent with the actual lengths of its gates."""
    program = done.cell.scripts[agent].program([])
    length_s = program.length_s.copy()
    ends_s = done.ends_s[agent]
    for opening in done.cell.openings[agent]:
        at = opening.segment
        length_s[at] = ends_s[at] - (ends_s[at - 1] if at else 0.0)
    return replace(program, length_s=length_s)


def _track(done: Done, who: str) -> WalkedTrack:
    """Return the track of a person: the legs, with the actual waits at gates."""
    script, program = done.cell.scripts[who], realised(done, who)
    gates = {segment for segment, _, _ in script.gates}
    legs = []
    for at, leg in enumerate(script.legs):
        t_s = np.array([0.0, program.length_s[at]]) if at in gates else leg.t_s
        if t_s[-1] > 0:
            legs.append(Leg(t_s, leg.xyz_m, leg.press))
    return WalkedTrack(iter(legs))
