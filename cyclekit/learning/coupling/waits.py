"""Finds the waits in logged executions and the event that ended each."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeGuard

import numpy as np
import polars as pl

from cyclekit.learning.coupling.conditions.waiting_spots import spots_of, with_spots
from cyclekit.learning.coupling.events.errands import with_errands
from cyclekit.learning.coupling.events.givers import WITHIN_S
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
from cyclekit.learning.coupling.parts.unseen_parts import with_parts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from cyclekit.dataset.cards.coupling import Agent, ConditionCard, CouplingCard, GateCard
    from cyclekit.learning.coupling.events.visits import PlaceVisit

MIN_S = 0.1
"""Minimum duration of a wait, s."""
ABOUT_S = 0.1
"""Tolerance, s: an event ended a wait if the time between them lies within the range of its lags plus or minus this."""


class _Wait(NamedTuple):
    """A wait of one agent: execution, task number, agent, duration, ending event, whether short of the place."""

    execution: str
    task: int
    agent: str
    wait_s: float
    waited_for: str
    short: bool


def with_waits_named(tasks: pl.DataFrame, courses: Sequence[ExecutionVisits], coupling: CouplingCard) -> pl.DataFrame:
    """Return table TASKS with the event that ended each wait, and with dwell and wait separated at learned gates.

    Args:
        tasks: Tasks of both agents.
        courses: The executions of these tasks.
        coupling: Learned wait conditions.
    """
    parted = with_errands(courses, coupling.errands) if coupling.errands else courses
    learned = with_spots(parted, spots) if (spots := spots_of(coupling)) else parted
    tasks_at = [{(visit.place, visit.arrived_s): visit.task for visit in one.visits["operator"]} for one in courses]
    both = zip(with_parts(learned, coupling.sources), tasks_at, strict=True)
    waits = [wait for course, mine in both for wait in _waits(course, coupling, mine)]
    kinds = {name: tasks.schema[name] for name in ("execution", "index", "agent")}
    columns = kinds | {"ended_s": pl.Float64, "ended_by": pl.String, "short": pl.Boolean}
    ended = pl.DataFrame(waits, schema=columns, orient="row").unique(list(kinds), keep="first")
    joined = tasks.join(ended, on=list(kinds), how="left", maintain_order="left")
    own = (pl.col("agent") == "operator") & pl.col("agent_name").is_null()
    stood = pl.col("end_s") - pl.col("arrival_s")
    on_the_way = pl.when(own).then(0.0).otherwise(pl.col("dwell_s") + pl.col("wait_s") - stood)  # paused
    other = pl.col("wait_s") - pl.col("lost_wait_s").fill_null(pl.col("wait_s"))  # caused by a pause or a stop: kept
    kept = pl.when(own).then(0.0).otherwise((other - on_the_way).clip(0.0))
    wait = pl.max_horizontal(pl.min_horizontal(pl.col("ended_s").fill_null(0.0), stood), kept)
    split = (stood + on_the_way).is_not_null() & (own | ~pl.col("short").fill_null(value=True))
    lost = split & ~own & pl.col("lost_wait_s").is_not_null()
    named = pl.col("ended_by").is_not_null() & (own | split | (pl.col("wait_s") > MIN_S))
    return joined.with_columns(
        waited_for=pl.when(named).then("ended_by"),
        wait_s=pl.when(split).then(wait + on_the_way).otherwise("wait_s"),
        dwell_s=pl.when(split).then(stood - wait).otherwise("dwell_s"),
        lost_wait_s=pl.when(lost).then(wait + on_the_way - other).otherwise("lost_wait_s"),
    ).select(tasks.columns)


def _waits(
    course: ExecutionVisits, coupling: CouplingCard, tasks_at: Mapping[tuple[str, float], int]
) -> Iterator[_Wait]:
    """Yield the waits in one execution; `tasks_at`: numbers of the operator's tasks by place and arrival, s."""
    usual = {(gate.agent, gate.place): float(np.median(gate.own_s)) for gate in coupling.gates if gate.at == "leave"}
    for gate in coupling.gates:
        if not gate.conditions:
            continue
        agent: Agent = gate.agent
        first = -1 if agent == "robot" else 0  # the first visit is the starting place, without a task
        for index, ready_s, left_s, occurrence in _departures(course, gate, usual):
            found = [
                one for one in gate.conditions if (at := _opened(course, one, occurrence, left_s)) and at > ready_s
            ]
            if found and left_s - ready_s > MIN_S and index + first >= 0:
                last = max(found, key=lambda one: _opened(course, one, occurrence, left_s) or -np.inf)
                short = (
                    agent == "robot" and np.isfinite(course.visits[agent][index].reached_s) and gate.at == "approach"
                )
                task = index + first
                if agent == "operator":
                    visit = course.visits[agent][index]
                    spot = tasks_at.get((gate.wait_at, visit.reached_s), -1) if gate.wait_at else -1
                    task = next((number for number in (spot, visit.task) if number >= 0), task)
                yield _Wait(course.name, task, agent, left_s - ready_s, condition_text(last), bool(short))


def _departures(
    course: ExecutionVisits, gate: GateCard, usual: dict[tuple[Agent, str], float]
) -> Iterator[tuple[int, float, float, int]]:
    """Yield for each departure of a gate: number of the waiting visit, time ready, time of going on, its occurrence."""
    visits, occurrence = course.visits[gate.agent], 0
    for number, visit in enumerate(visits):
        if visit.place != gate.place:
            continue
        before = visits[number - 1] if number else None
        if gate.at == "approach" and np.isfinite(visit.reached_s):
            yield number, visit.reached_s, visit.went_on_s, occurrence
        elif gate.at == "leave" or _goes_there(before, visit):
            which, stands = (number, visit) if gate.at == "leave" or before is None else (number - 1, before)
            own_s = usual.get((gate.agent, stands.place), 0.0)
            if np.isfinite(stands.left_s) and np.isfinite(stands.arrived_s):
                yield which, stands.arrived_s + own_s, stands.left_s, occurrence
        occurrence += 1


def _goes_there(before: PlaceVisit | None, visit: PlaceVisit) -> TypeGuard[PlaceVisit]:
    """Return whether an agent comes from a known place, and is not at the place already."""
    return before is not None and (before.place != visit.place or before.left_s < visit.arrived_s)


def _opened(course: ExecutionVisits, condition: ConditionCard, occurrence: int, left_s: float) -> float | None:
    """Return when a condition let a departure go on, s; None if the condition did not decide it."""
    event = Event(condition.agent, condition.place, condition.event)
    number = condition.turns.event(occurrence, condition.back)
    least_s, most_s = condition.lag_s[0] - ABOUT_S, condition.lag_s[-1] + ABOUT_S
    kinds = [(event, most_s)]
    if condition.signal is not None:  # he may have stayed there after it; else he left a moment later
        kinds.append((event._replace(signal=condition.signal), most_s + WITHIN_S))
    for kind, latest_s in kinds:
        at = course.events.get(kind, np.empty(0))
        since = left_s - float(at[number]) if number is not None and number < len(at) else np.nan
        if least_s <= since <= latest_s:
            return left_s - since + float(np.median(condition.lag_s))
    return None


def condition_text(condition: ConditionCard, shown: Callable[[str], str] = str) -> str:
    """Return a condition as text: `operator leaves fixture (release set)`, `part set`; `shown` displays a place."""
    if condition.agent == "signal":
        return f"{condition.place} {condition.event}"
    signal = "" if condition.signal is None else f" ({condition.signal})"
    return f"{condition.agent} {condition.event} {shown(condition.place)}{signal}"
