"""Search over orders of both agents: all pairs by mean times, then a rollout of the best ones.

With mean times the robot is slowed by its average factor and nothing is drawn: a pair of orders takes microseconds.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.estimate.joint.draws import CycleDraws, EventColumns
from cyclekit.estimate.joint.roll import Plan, longest_s
from cyclekit.estimate.joint.walk import UnslowedAgent, advance_unslowed
from cyclekit.estimate.plan.search import every_order, random_order

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.joint.legs import Agenda
    from cyclekit.estimate.joint.roll import JointCell
    from cyclekit.estimate.plan.jobs import Jobs
    from cyclekit.schema import Floats, Ints, Vector

MAX_ORDERS = 1000
"""Maximum number of orders of one agent; of more, a random sample of this size."""
PAIRS = 50_000
"""Number of pairs of orders evaluated at once."""
ROLLED, CYCLES = 24, 250
"""Number of best pairs that are rolled out, and number of cycles per pair."""


@dataclass(frozen=True)
class Pair:
    """Numbers of an order of the robot and one of the operator, and the cycle time by mean times, s."""

    robot: int
    operator: int
    mean_s: float


def orders_to_try(jobs: Jobs, seed: int) -> list[tuple[str, ...]]:
    """Return all distinct orders of some jobs; if there are too many, a random sample."""
    found = list(dict.fromkeys(islice(every_order(jobs), MAX_ORDERS + 1)))
    if len(found) <= MAX_ORDERS:
        return found
    rng = np.random.default_rng(seed)
    return list(dict.fromkeys(random_order(jobs, rng) for _ in range(MAX_ORDERS)))


def mean_times(cell: JointCell, robots: Sequence[Agenda], operators: Sequence[Agenda], *, both: bool) -> Floats:
    """Return the cycle time of each pair by mean times, shape (robots, operators), s; inf for a deadlock.

    Args:
        cell: The cell.
        robots: Agendas of the robot.
        operators: Agendas of the operator.
        both: Whether the cycle ends when both agents are done; else when the robot is.
    """
    sources = [cell.source(source, robots) for source in (cell.coupling.sources if cell.coupling else ())]
    columns = EventColumns([*robots, *operators, *sources])
    slowed = _slowed(cell)
    robot = _usual(robots, columns, [[slowed * leg.way_s for leg in agenda.legs] for agenda in robots])
    operator = _usual(operators, columns, [_walks_s(cell, agenda) for agenda in operators])
    for row, agenda in enumerate(operators):
        operator.straight_s[row, : len(agenda.legs)] = _straight_s(cell, agenda)
    _set_trips(operator, cell.pace)
    parts = [_usual([source], columns, [[0.0] * len(source.legs)]) for source in sources]
    events = [
        columns.times([(agenda, np.array([row])) for row, agenda in enumerate(agendas)], len(agendas))
        for agendas in (robots, operators)
    ]
    found = np.empty((len(robots), len(operators)))
    at_once = max(1, PAIRS // len(operators))
    for first in range(0, len(robots), at_once):
        some = np.arange(first, min(first + at_once, len(robots)))
        r, o = np.repeat(some, len(operators)), np.tile(np.arange(len(operators)), len(some))
        events_s = np.maximum(events[0][r], events[1][o])
        for source in sources:
            mine = columns.times([(source, np.arange(1))], 1)
            events_s = np.maximum(events_s, mine)
        agents = [UnslowedAgent(_rows(robot, r), events_s), UnslowedAgent(_rows(operator, o), events_s)]
        agents += [UnslowedAgent(_rows(part, np.zeros_like(r)), events_s) for part in parts]
        advance_unslowed(agents, np.arange(len(r)))
        ends = [_ends_s(agent) for agent in agents[: 2 if both else 1]]
        found[some] = np.max(ends, axis=0).reshape(len(some), len(operators))
    return found


def best_pairs(means_s: Floats) -> list[Pair]:
    """Return the fastest pairs, in ascending order of cycle time."""
    order = np.argsort(means_s, axis=None, kind="stable")[:ROLLED]
    pairs = (np.unravel_index(int(n), means_s.shape) for n in order)
    return [Pair(int(r), int(o), float(means_s[r, o])) for r, o in pairs if np.isfinite(means_s[r, o])]


def rolled_cycles(cell: JointCell, plans: Sequence[Plan], seed: int) -> list[Vector | None]:
    """Return the durations of CYCLES cycles of each plan, s; None for a deadlock."""
    until_s = max(longest_s(plan) for plan in plans)
    rolled = cell.roll(plans, cycles=CYCLES, seed=seed, until_s=until_s)
    return [None if isinstance(each, EstimateError) else np.resize(each.duration_s, CYCLES) for each in rolled]


def _slowed(cell: JointCell) -> float:
    """Return the mean ratio of the robot's motion times to nominal ones."""
    tasks = cell.dataset.tasks()
    nominal, lost = float(tasks["nominal_s"].sum() or 0.0), float(tasks["safety_loss_s"].sum() or 0.0)
    return 1.0 + lost / nominal if nominal > 0.0 else 1.0


def _walks_s(cell: JointCell, agenda: Agenda) -> list[float]:
    return [_walk_s(cell, leg.start, leg.place) for leg in agenda.legs]


def _straight_s(cell: JointCell, agenda: Agenda) -> list[float]:
    """Return how long the walk to each leg takes if the one before is left out because nobody waits there, s."""
    starts = [None, *(leg.start if leg.if_waits else None for leg in agenda.legs[:-1])]
    return [_walk_s(cell, start, leg.place) for start, leg in zip(starts, agenda.legs, strict=True)]


def _walk_s(cell: JointCell, start: str | None, goal: str) -> float:
    """Return the mean duration of the walk between two places, s; 0 without a start."""
    if start is None:
        return 0.0
    return cell.pace * float(cell.segments.durations_s(cell.segments.walk(start, goal)).mean())


def _set_trips(draws: CycleDraws, pace: float) -> None:
    """Let each wait with trips have one of a typical duration times the share of waits with a trip."""
    draws.trip_level[:] = 0.5
    for number, agenda in enumerate(draws.agendas):
        for n, leg in enumerate(agenda.legs):
            if leg.trip is not None:
                draws.set_kind(number, n, leg.trip, pace * leg.trip.waiting)
                draws.trips_waiting[number, n] = True


def _usual(agendas: Sequence[Agenda], columns: EventColumns, ways_s: Sequence[Sequence[float]]) -> CycleDraws:
    """Return agendas with median work and lags, and mean ways, one row each."""
    every = np.arange(len(agendas))
    draws = CycleDraws(agendas, every, np.zeros_like(every), 1, columns, 0)
    for row, seconds in enumerate(ways_s):
        draws.walk_s[row, : len(seconds)] = seconds
    return draws


def _rows(draws: CycleDraws, rows: Ints) -> CycleDraws:
    """Return selected rows of draws; rows may repeat."""
    found = copy(draws)
    for name in (
        "which",
        "own_s",
        "lag_s",
        "walk",
        "walk_s",
        "straight",
        "straight_s",
        "trip_level",
        "trips_waiting",
        "trips_free",
    ):
        setattr(found, name, getattr(draws, name)[rows])
    return found


def _ends_s(agent: UnslowedAgent) -> Vector:
    last = agent.draws.last[agent.draws.which]
    return np.asarray(agent.times.passes_s[np.arange(len(last)), last])
