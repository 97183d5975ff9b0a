"""Task lists of cells with waits of robot and operator: starts and ends of all tasks, nothing else.

A job is split into tasks where an agent may have to wait, and where something ends that the other agent waits for, so
every wait is between two tasks. Tasks before a gate are named `JOB to PLACE`, tasks that end with such a moment within
a job `JOB PLACE`, the last task of a job `JOB`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit_sim.coupled_program import (
    Order,
    Script,
    agents_of,
    operator_script,
    people_of,
    plan_all,
    robot_script,
)
from cyclekit_sim.coupled_run import coupled_runs
from cyclekit_sim.program import IDLE

if TYPE_CHECKING:
    from cyclekit_sim.coupled_scenes import Coupled
    from cyclekit_sim.session import Session

NAMES = {"robot": "arm", "operator": "worker", "helper": "helper"}
"""Names of the agents in the list."""
PART = "part"
"""What a task waits for that begins with a part of the conveyor."""
EPOCH_S = 1_700_000_000.0


class Listed(NamedTuple):
    """A task of the list: its name, first and last segment."""

    name: str
    first: int
    last: int


def task_list(session: Session, cell: Coupled) -> pl.DataFrame:
    """Return the tasks of a session's executions as logged: run, agent, task, t_start, t_end."""
    rows = []
    for trace, begin_s in coupled_runs(session):
        run = f"{trace.program.executions[0].index:04d}"
        for agent in ("robot", *people_of(cell)):
            ends_s, name = trace.done.ends_s[agent], NAMES[agent]
            for task in tasks_of(cell, agent, trace.done.cell.scripts[agent]):
                start_s = ends_s[task.first - 1] if task.first else 0.0
                at_s = EPOCH_S + 1e4 * session.index + begin_s
                rows.append((run, name, task.name, at_s + start_s, at_s + ends_s[task.last]))
    columns = ("run", "agent", "task", "t_start", "t_end")
    return pl.DataFrame(rows, schema=columns, orient="row").sort("t_start", "agent")


def tasks_of(cell: Coupled, agent: str, script: Script) -> list[Listed]:
    """Return the script of an agent split into tasks."""
    of_agent = {"robot": cell.robot_jobs, "operator": cell.operator_jobs, "helper": cell.helper_jobs}[agent]
    jobs = _jobs(of_agent, script.execution.places[1:])
    gates = {segment: gate for segment, gate, _ in script.gates}
    needs = {(gate.need.place, gate.need.moment) for gate in cell.gates if gate.need.agent == agent}
    closing = {segment for key in needs for segment in script.moments[key]}
    idle = {at for at, column in enumerate(script.columns) if column[0] == IDLE}
    idle |= set(_last_steps(script, jobs, closing))
    own = [at for at in range(len(script.columns)) if at not in idle]
    job_at = {at: jobs[script.columns[at][4]] for at in own}
    found, first = [], -1
    for at, after in zip(own, [*own[1:], -1], strict=True):
        job, number = job_at[at]
        last = after < 0 or job_at[after] != (job, number)
        if at in gates:
            if first >= 0:
                found.append(Listed(f"{job} to {gates[at].place}", first, at - 1))
            first = -1
            continue
        first = at if first < 0 else first
        if last or at in closing:
            found.append(Listed(job if last else f"{job} {script.goals[at]}", first, at))
            first = -1
    return found


def _jobs(jobs: Mapping[str, tuple[str, ...]], places: Sequence[str]) -> list[tuple[str, int]]:
    """Return for each visit its job, and the job's number in the order; a place without a job counts as one."""
    found: list[tuple[str, int]] = []
    number = 0
    while len(found) < len(places):
        rest = tuple(places[len(found) :])
        name, visits = next(((n, p) for n, p in jobs.items() if rest[: len(p)] == p), (rest[0], rest[:1]))
        found += [(name, number)] * len(visits)
        number += 1
    return found


def _last_steps(script: Script, jobs: Sequence[tuple[str, int]], done: set[int]) -> list[int]:
    """Return the segments in which an agent has finished a job that the other waits for, but has not left yet."""
    leaving = [at for (_, moment), some in script.moments.items() if moment == "leaves" for at in some]
    tasks = {at: script.columns[at][4] for at in leaving if at - 1 in done}
    return [at for at, task in tasks.items() if task + 1 == len(jobs) or jobs[task + 1] != jobs[task]]


def _scripts(cell: Coupled, order: Order) -> dict[str, Script]:
    rng = np.random.default_rng(0)
    table = plan_all(cell, [order])
    return {
        "robot": robot_script(cell, order["robot"], table, 0),
        **{who: operator_script(cell, order[who], 0, rng, who=who) for who in people_of(cell)},
    }


def task_plan(cell: Coupled, order: Order) -> list[tuple[str, str]]:
    """Return agent and task, as named in the list, of all tasks of an order."""
    scripts = _scripts(cell, order)
    return [(NAMES[agent], task.name) for agent in scripts for task in tasks_of(cell, agent, scripts[agent])]


def _every_job(cell: Coupled) -> Order:
    """Return an order with each job once, as a random one need not go to all fixtures."""
    return {
        agent: (end, *(place for places in jobs.values() for place in places), end)
        for agent, jobs, end in agents_of(cell)
    }


def listed_conditions(cell: Coupled) -> list[dict[str, object]]:
    """Return which task waits for the end of which other task, as JSON; `part` = for a part that comes by itself."""
    scripts = _scripts(cell, _every_job(cell))
    tasks = {agent: tasks_of(cell, agent, scripts[agent]) for agent in scripts}
    found: list[dict[str, object]] = []
    for gate in cell.gates:
        at = next(segment for segment, other, _ in scripts[gate.agent].gates if other is gate)
        waiting, needed = next(task.name for task in tasks[gate.agent] if task.first > at), PART
        if gate.need.agent != "source":
            ends = scripts[gate.need.agent].moments[gate.need.place, gate.need.moment]
            needed = next(task.name for task in tasks[gate.need.agent] if task.last == ends[0])
        found.append({"task": waiting, "needs": needed, "back": gate.need.back, "lag_s": list(gate.need.lag_s)})
    return found
