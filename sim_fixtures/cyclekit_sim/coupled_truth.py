"""Truth of cells with waits of robot and operator: tasks of both, what ended each wait, and all conditions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import cast

import numpy as np
import polars as pl

from cyclekit_sim.coupled_program import people_of
from cyclekit_sim.coupled_run import CoupledTrace, Waited, coupled_runs, realised
from cyclekit_sim.coupled_scenes import Coupled, Gate, Moment
from cyclekit_sim.engine import Trace
from cyclekit_sim.session import Session
from cyclekit_sim.truth import task_rows
from cyclekit_sim.walking import Nobody

_SHORTEST_S = 1e-6  # s; shorter ones are no waits


def coupled_tasks(session: Session, cell: Coupled, clock_s: float) -> pl.DataFrame:
    """Return the tasks of all agents, grouped by execution, the robot's first."""
    rows: list[dict[str, object]] = []
    for trace, begin_s in coupled_runs(session):
        rows += _rows(trace, cell, clock_s + begin_s)
    return pl.DataFrame(rows, schema_overrides={"wait_ended_by": pl.String})


def _rows(trace: CoupledTrace, cell: Coupled, clock_s: float) -> Iterator[dict[str, object]]:
    done = trace.done
    nothing = np.empty(0)
    people = {
        who: Trace(
            realised(done, who),
            Nobody(),
            nothing,
            nothing,
            np.empty(0, dtype=np.int64),
            done.ends_s[who],
            trace.cycle_s,
        )
        for who in people_of(cell)
    }
    for agent, each in {"robot": trace, **people}.items():
        ended: dict[int, list[str]] = defaultdict(list)
        for wait in done.waits(agent):
            if wait.end_s - wait.begin_s > _SHORTEST_S:
                ended[wait.task].append(ended_by(wait, cell.signals))
        for row in task_rows(each, clock_s):
            yield {"agent": agent, **row, "wait_ended_by": "; ".join(ended[cast(int, row["index"])]) or None}


def ended_by(wait: Waited, signals: Mapping[tuple[str, str, Moment], str]) -> str:
    """Return what ended a wait: agent, moment and place, and the signal that shows it."""
    need = cast(Gate, wait.opening.gate).need
    signal = signals.get((need.agent, need.place, need.moment))
    return f"{need.agent} {need.moment} {need.place}" + (f" ({signal})" if signal else "")


def coupled_executions(tasks: pl.DataFrame, session: Session) -> pl.DataFrame:
    """Return one row per execution: from first start to last end, with times of the robot's tasks, waits, orders."""
    rows = []
    for trace, _ in coupled_runs(session):
        index, done = trace.program.executions[0].index, trace.done
        mine = tasks.filter(pl.col("execution") == index, pl.col("agent") == "robot")
        start_s = float(mine["start_s"].to_numpy()[0])
        sums = {name: float(mine[name].sum()) for name in ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")}
        scripts = done.cell.scripts
        orders = {agent: ",".join(scripts[agent].execution.places) for agent in ("robot", "operator")}
        rows.append(
            {
                "execution": index,
                "session": session.name,
                "start_s": start_s,
                "end_s": start_s + done.duration_s,
                "duration_s": done.duration_s,
                "sequence": orders["robot"],
                "operator_sequence": orders["operator"],
                **sums,
                "operator_wait_s": done.waited_s("operator"),
            }
        )
    return pl.DataFrame(rows)


def conditions(cell: Coupled) -> list[dict[str, object]]:
    """Return all wait conditions, as JSON."""
    return [
        {
            "agent": gate.agent,
            "at": gate.at,
            "place": gate.place,
            "needs": {
                "agent": gate.need.agent,
                "place": gate.need.place,
                "event": gate.need.moment,
                "back": gate.need.back,
            },
            "signal": cell.signals.get((gate.need.agent, gate.need.place, gate.need.moment)),
            "lag_s": list(gate.need.lag_s),
        }
        for gate in cell.gates
    ]
