"""Content of one execution of two agents as segments: moves or walks, work, and gates that open after an event.

Everything is drawn in advance: the path of every walk, the duration of every work, the lag of every gate. `coupled_run`
determines when a gate opens.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array
from cyclekit_sim.choices import draw_goal, draw_walk
from cyclekit_sim.coupled_scenes import HELPER_REST, JOINT_TIMES, LINGER_S, REST, Coupled, Gate, Moment, Need
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.motion import MotionTable, plan_moves
from cyclekit_sim.program import DWELL, HOME, IDLE, MOVE, WAIT, Column, Execution, Program, program_of
from cyclekit_sim.walking import Leg, stand

Order = dict[str, tuple[str, ...]]
"""Places of each agent in order: `robot` from home to home, `operator` and `helper` from and to those of PEOPLE."""
AGENTS = ("robot", "operator", "helper", "source")
PEOPLE = {"operator": REST, "helper": HELPER_REST}
"""Where each person begins and ends."""


@dataclass(frozen=True)
class Opening:
    """A gate in a script: it opens a lag after the end of an agent's segment; `agent` = None: it is open.

    Attributes:
        segment: Segment of the gate.
        gate: The gate; None for the end of the execution, or for room for a part.
        agent, needed: Agent and segment that must have ended.
        lag_s: Time from that end until the agent continues, s.
        until: Own segment at whose end a zone is given back that this gate takes; -1: it takes none. Then `agent` is
            the other one, who must be outside, and `needed` is -1.
    """

    segment: int
    gate: Gate | None
    agent: str | None
    needed: int
    lag_s: float
    until: int = -1


@dataclass
class Script:
    """Content of one execution of one agent, under construction.

    Attributes:
        execution: Number and places.
        columns, goals: Segments.
        moments: (place, moment) -> segments that end with it, in order.
        gates: Segment, gate, and the number of its passage.
        legs: For an operator, one per segment.
    """

    execution: Execution
    columns: list[Column] = field(default_factory=list)
    goals: list[str] = field(default_factory=list)
    moments: dict[tuple[str, Moment], list[int]] = field(default_factory=lambda: defaultdict(list))
    gates: list[tuple[int, Gate, int]] = field(default_factory=list)
    legs: list[Leg] = field(default_factory=list)

    def add(
        self, kind: int, length_s: float, row: int, per_s: float, task: int, goal: str, closed: int = 0, after: int = 0
    ) -> int:
        """Add a segment; return its number. A robot's work may change the gripper; all else leaves it as it is."""
        after = after if kind == DWELL else closed
        execution = self.execution.index if task >= 0 else -1
        self.columns.append((kind, length_s, row, per_s, task, execution, closed, after))
        self.goals.append(goal)
        return len(self.columns) - 1

    def add_gates(self, gates: Sequence[Gate], row: int, task: int, goal: str, closed: int = 0) -> None:
        """Add several gates in sequence."""
        for gate in gates:
            number = sum(gate is other for _, other, _ in self.gates)
            self.gates.append((self.add(WAIT, 0.0, row, 0.0, task, goal, closed), gate, number))

    def program(self, openings: Sequence[Opening]) -> Program:
        """Return the program; closed gates have no end."""
        program = program_of(self.columns, self.goals, [self.execution])
        for opening in openings:
            if opening.agent is not None:
                program.length_s[opening.segment] = np.inf
        return program


def plan_all(cell: Coupled, orders: Sequence[Order]) -> MotionTable:
    """Plan all moves of these orders, including those via the stop short of a place."""
    pairs = set()
    for order in orders:
        again = [(place, place) for place in cell.repeats if place in order["robot"]]
        changes = [(start, cell.tool[0]) for start in order["robot"]] if cell.tool else []
        changes += [(tool, goal) for _, tool in changes for goal in cell.repeats if goal in order["robot"]]
        for start, goal in [*pairwise(order["robot"]), *again, *changes]:
            via = [_short(goal)] if goal in cell.short_of else []
            pairs |= set(pairwise([start, *via, goal]))
    places = dict(cell.scene.places) | {_short(name): place for name, place in cell.short_of.items()}
    return plan_moves(places, pairs)


def _short(place: str) -> str:
    return f"short of {place}"


def robot_script(
    cell: Coupled, places: Sequence[str], table: MotionTable, index: int, rng: np.random.Generator | None = None
) -> Script:
    """Return the robot's script; at the end it stays at home until the operator is done.

    Args:
        cell: The cell.
        places: Where it goes.
        table: Its moves.
        index: Number of the execution.
        rng: Of delays and jams; None: there are none.
    """
    script = Script(Execution(index, tuple(places), ()))
    closed = 0
    for task, (start, goal) in enumerate(pairwise(places)):
        at = start
        closed = 1 - closed if start == goal else closed  # it failed: the gripper is as before
        if goal in cell.short_of:
            at = _short(goal)
            row = _move(script, table, (start, at), task, goal, closed)
            script.add_gates(_gates(cell, "robot", "approach", goal), row, task, goal, closed)
        row = _move(script, table, (at, goal), task, goal, closed)
        script.moments[goal, "arrives"].append(len(script.columns) - 1)
        if goal != HOME:
            script.add_gates(_gates(cell, "robot", "work", goal), row, task, goal, closed)
            if rng is not None and (late_s := _late_s(cell, goal, rng)) > 0.0:
                script.add(DWELL, late_s, row, 0.0, task, goal, closed, closed)
            after = closed if goal in cell.keeps else 1 - closed
            work = script.add(DWELL, cell.robot_s[goal], row, 0.0, task, goal, closed, after)
            script.moments[goal, "leaves"].append(work)
            closed = after
    for _ in people_of(cell):
        script.add(IDLE, 0.0, row, 0.0, -1, places[-1], closed)
    return script


def people_of(cell: Coupled) -> list[str]:
    """Return the people of a cell."""
    return list(PEOPLE) if cell.helper_jobs else ["operator"]


def _late_s(cell: Coupled, place: str, rng: np.random.Generator) -> float:
    """Return how long the robot stands before its process, s: for the camera, and if it jams."""
    chance, lasts_s = cell.jam
    camera_s = float(rng.uniform(*cell.late_s[place])) if place in cell.late_s else 0.0
    return camera_s + (float(rng.uniform(*lasts_s)) if rng.random() < chance else 0.0)


def with_changes(cell: Coupled, places: Sequence[str], index: int) -> tuple[str, ...]:
    """Return the robot's places with the tool changes of execution `index`."""
    if cell.tool is None:
        return tuple(places)
    found: list[str] = []
    part = index * JOINT_TIMES
    for place in places:
        if place in cell.repeats:
            found += [cell.tool[0]] if part % cell.tool[1] == 0 else []
            part += 1
        found.append(place)
    return tuple(found)


def with_repeats(cell: Coupled, places: Sequence[str], rng: np.random.Generator) -> tuple[str, ...]:
    """Return the robot's places, each as often in a row as its process is done until it succeeds."""
    often = [int(rng.geometric(1.0 - cell.repeats[place])) if place in cell.repeats else 1 for place in places]
    return tuple(place for place, times in zip(places, often, strict=True) for _ in range(times))


def _move(script: Script, table: MotionTable, pair: tuple[str, str], task: int, goal: str, closed: int) -> int:
    """Add a move; return the row of the table at its end."""
    rows, length_s = table.rows[pair], table.duration_s[pair]
    script.add(MOVE, length_s, table.first_row[pair], rows / length_s, task, goal, closed)
    return table.first_row[pair] + rows


def operator_script(
    cell: Coupled, places: Sequence[str], index: int, rng: np.random.Generator, pace: float = 1.0, who: str = "operator"
) -> Script:
    """Return the script of a person; rows refer to the consecutive legs. Walks and work take `pace` times as long."""
    script, stations = Script(Execution(index, tuple(places), ())), cell.scene.stations
    here = draw_goal(cell.scene, places[0], rng)
    _stay(script, here, pace * float(rng.uniform(*stations[places[0]].dwell_s)), -1, places[0])
    for task, place in enumerate(places[1:]):
        for gate in _gates(cell, who, "approach", place):
            script.add_gates([gate], _rows(script), max(task - 1, 0), places[task])
            script.legs.append(stand(here, 0.0))
        there = draw_goal(cell.scene, place, rng)
        leg = draw_walk(cell.scene, here, there, place, rng)
        leg = replace(leg, t_s=pace * leg.t_s)
        length_s = float(leg.t_s[-1])
        number = script.add(MOVE, length_s, _rows(script), (len(leg.t_s) - 1) / length_s, task, place)
        script.moments[place, "arrives"].append(number)
        script.legs.append(leg)
        here = there
        if place != PEOPLE[who]:
            for gate in _gates(cell, who, "work", place):
                script.add_gates([gate], _rows(script), task, place)
                script.legs.append(stand(here, 0.0))
            work_s = pace * float(rng.uniform(*stations[place].dwell_s))
            script.moments[place, "done"].append(_stay(script, here, work_s, task, place))
            script.moments[place, "leaves"].append(
                _stay(script, here, pace * float(rng.uniform(*LINGER_S)), task, place)
            )
    return script


def _stay(script: Script, here: Array, length_s: float, task: int, place: str) -> int:
    number = script.add(DWELL if task >= 0 else IDLE, length_s, _rows(script), 0.0, task, place)
    script.legs.append(stand(here, length_s))
    return number


def _rows(script: Script) -> int:
    return sum(len(leg.t_s) for leg in script.legs)


def source_script(cell: Coupled, parts: int, index: int, rng: np.random.Generator) -> Script:
    """Return the script of the part source: for each part a gap, then a gate until there is room."""
    script = Script(Execution(index, (), ()))
    if cell.feed is not None:
        for part in range(parts):
            shortest, mean = cell.feed.gap_s
            script.add(DWELL, shortest + float(rng.exponential(mean - shortest)), 0, 0.0, part, cell.feed.place)
            script.moments[cell.feed.place, "arrives"].append(script.add(WAIT, 0.0, 0, 0.0, part, cell.feed.place))
    if not script.columns:
        script.add(IDLE, 0.0, 0, 0.0, -1, "")
    return script


def _gates(cell: Coupled, agent: str, at: str, place: str) -> list[Gate]:
    return [gate for gate in cell.gates if (gate.agent, gate.at, gate.place) == (agent, at, place)]


def link(
    cell: Coupled, scripts: dict[str, Script], waits: NDArray[np.bool_], rng: np.random.Generator
) -> dict[str, list[Opening]]:
    """Return what opens each gate of one execution; `waits`: whether they wait in each joint task (JOINT_TIMES,)."""
    found: dict[str, list[Opening]] = {agent: [] for agent in AGENTS}
    for agent in ("robot", *people_of(cell)):
        for segment, gate, passage in scripts[agent].gates:
            need = gate.need
            moments = scripts[need.agent].moments[need.place, need.moment]
            lag_s, waiting = float(rng.uniform(*need.lag_s)), bool(waits[passage % JOINT_TIMES])
            if need.back is None:
                until = scripts[agent].moments[gate.place, "leaves"][passage]
                found[agent].append(
                    Opening(segment, gate, need.agent, -1, lag_s, until)
                    if waiting
                    else Opening(segment, gate, None, -1, lag_s)
                )
                continue
            turn = passage - need.back
            closed = 0 <= turn < len(moments) and waiting
            needs, needed = (need.agent, moments[turn]) if closed else (None, -1)
            found[agent].append(Opening(segment, gate, needs, needed, lag_s))
    for number, who in enumerate(reversed(people_of(cell)), 1):
        done = len(scripts[who].columns) - 1
        found["robot"].append(Opening(len(scripts["robot"].columns) - number, None, who, done, 0.0))
    if cell.feed is not None:
        taken = scripts["robot"].moments[cell.feed.place, "leaves"]
        for part, segment in enumerate(scripts["source"].moments[cell.feed.place, "arrives"]):
            turn = part - cell.feed.buffer
            needs, needed = ("robot", taken[turn]) if turn >= 0 else (None, -1)
            found["source"].append(Opening(segment, None, needs, needed, 0.0))
    return found


def random_order(cell: Coupled, rng: np.random.Generator) -> Order:
    """Return an order of both agents: three joint tasks and all other tasks of each, shuffled; never a deadlock."""
    chosen = rng.integers(cell.joint, size=JOINT_TIMES) if cell.joint > 1 else np.zeros(JOINT_TIMES, dtype=np.int64)
    while True:
        found = {
            agent: (end, *(place for name in _shuffled(cell, agent, chosen, rng) for place in jobs[name]), end)
            for agent, jobs, end in agents_of(cell)
        }
        if cell.joint == 1 or _ends(cell, found):
            return found


def agents_of(cell: Coupled) -> list[tuple[str, Mapping[str, tuple[str, ...]], str]]:
    """Return name, jobs, and first and last place of each agent."""
    people = {"operator": cell.operator_jobs, "helper": cell.helper_jobs}
    return [("robot", cell.robot_jobs, HOME), *((who, people[who], PEOPLE[who]) for who in people_of(cell))]


def order_beside(cell: Coupled, robot: Sequence[str], rng: np.random.Generator) -> tuple[str, ...]:
    """Return an order of the operator as drawn by the scene beside this order of the robot."""
    jobs = list(cell.robot_jobs.values())[: cell.joint : cell.products]
    done = Counter(robot)
    chosen = np.repeat(np.arange(len(jobs)) * cell.products, [done[places[-1]] for places in jobs])
    while True:
        names = _shuffled(cell, "operator", chosen, rng)
        found = (REST, *(place for name in names for place in cell.operator_jobs[name]), REST)
        if cell.joint == 1 or _ends(cell, {"robot": tuple(robot), "operator": found}):
            return found


def _shuffled(cell: Coupled, agent: str, chosen: NDArray[np.int64], rng: np.random.Generator) -> list[str]:
    """Return an agent's tasks in random order: these joint ones, numbered as the robot's, and all others."""
    names = next(list(jobs) for who, jobs, _ in agents_of(cell) if who == agent)
    products = 1 if agent == "robot" else cell.products
    chosen, joint = chosen // products, cell.joint // products
    return [str(name) for name in rng.permutation(np.array([names[n] for n in chosen] + names[joint:]))]


def _ends(cell: Coupled, order: Order) -> bool:
    """Return whether both agents reach the end of their orders, each visit beginning when those it needs are over."""
    needs: dict[tuple[str, str], Need] = {(gate.agent, gate.place): gate.need for gate in cell.gates}
    at, over = dict.fromkeys(order, 0), Counter[tuple[str, str]]()
    moved = True
    while moved:
        moved = False
        for agent, places in order.items():
            while at[agent] < len(places):
                here = (agent, places[at[agent]])
                need = needs.get(here)
                if (
                    need is not None
                    and need.back is not None
                    and over[need.agent, need.place] <= over[here] - need.back
                ):
                    break
                over[here] += 1
                at[agent] += 1
                moved = True
    return all(at[agent] == len(places) for agent, places in order.items())


def check_order(cell: Coupled, order: Order) -> None:
    """Refuse an order with unknown places, or one that does not go from home to home or from rest to rest.

    Raises:
        SimulationError: The order is invalid.
    """
    known = {"robot": (HOME, cell.scene.places)} | {who: (PEOPLE[who], cell.scene.stations) for who in people_of(cell)}
    for agent, (end, names) in known.items():
        places = order.get(agent, ())
        if unknown := sorted(set(places) - set(names)):
            msg = f"{cell.scene.name}: the {agent} has no place {', '.join(unknown)}; it has {', '.join(names)}"
            raise SimulationError(msg)
        if len(places) < 3 or places[0] != end or places[-1] != end:
            raise SimulationError(f"{cell.scene.name}: the {agent} goes from {end} to {end}, not {', '.join(places)}")


def at_row(program: Program, row: int) -> Program:
    """Return an operator's program with its rows shifted by `row`."""
    return replace(program, row=program.row + row)
