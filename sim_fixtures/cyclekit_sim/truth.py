"""Ground truth of the logs, in the clock of the robot's log and in the base frame.

Times add up exactly: duration = nominal motion + safety loss + dwell + wait, for tasks and executions. A task is the
move to its goal with the wait and dwell there, so tasks follow each other without gaps. In a simulation with several
causes, `lost_CAUSE_s` separates them, and `safety_loss_s` is the total loss of the move, except slider and pause.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import polars as pl

from cyclekit_sim.arm import Array
from cyclekit_sim.causes import lost_parts
from cyclekit_sim.engine import Trace
from cyclekit_sim.program import DWELL, MOVE, WAIT, Execution
from cyclekit_sim.scenes import Scene
from cyclekit_sim.session import Session, robot_states

_TRUTH_HZ = 10.0
_SUMS = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")


def task_rows(trace: Trace, clock_s: float) -> Iterator[dict[str, object]]:
    """Yield a run's tasks in order; `clock_s` is the log's clock at the start of the run."""
    program = trace.program
    begins, lengths = trace.begins_s, trace.ends_s - trace.begins_s
    lost = {} if trace.caps is None else lost_parts(trace.caps, program.kind[trace.segment])
    for execution in program.executions:
        for index, (start, goal) in enumerate(zip(execution.places[:-1], execution.places[1:], strict=True)):
            mine = np.flatnonzero((program.execution == execution.index) & (program.task == index))
            kind = program.kind[mine]
            nominal = float(program.length_s[mine][kind == MOVE].sum())
            moved = float(lengths[mine][kind == MOVE].sum())
            here = np.isin(trace.segment, mine) if lost else np.empty(0, dtype=bool)
            causes = {f"lost_{name}_s": float(part[here].sum()) * trace.cycle_s for name, part in lost.items()}
            if lost:
                at = np.isin(trace.segment, mine[kind == MOVE])
                moved -= float((lost["slider"] + lost["pause"])[at].sum()) * trace.cycle_s
            yield {
                "execution": execution.index,
                "index": index,
                "start_place": start,
                "goal_place": goal,
                "start_s": clock_s + float(begins[mine[0]]),
                "end_s": clock_s + float(trace.ends_s[mine[-1]]),
                "nominal_s": nominal,
                "safety_loss_s": max(0.0, moved - nominal),
                "dwell_s": float(program.length_s[mine][kind == DWELL].sum()),
                "wait_s": float(program.length_s[mine][kind == WAIT].sum()),
                **causes,
            }


def task_table(session: Session, clock_s: float) -> pl.DataFrame:
    """Return a session's tasks; `clock_s` is the log's clock at session time 0."""
    runs = zip(session.traces, session.begins_s, strict=True)
    return pl.DataFrame([row for trace, begin in runs for row in task_rows(trace, clock_s + begin)])


def execution_table(tasks: pl.DataFrame, session: str, executions: dict[int, Execution]) -> pl.DataFrame:
    """Return one row per execution, summed over its tasks."""
    return (
        tasks.group_by("execution", maintain_order=True)
        .agg(pl.col("start_s").first(), pl.col("end_s").last(), pl.col(_SUMS).sum())
        .select(
            "execution",
            pl.lit(session).alias("session"),
            "start_s",
            "end_s",
            (pl.col("end_s") - pl.col("start_s")).alias("duration_s"),
            pl.Series(
                "sequence", [",".join(executions[i].places) for i in tasks["execution"].unique(maintain_order=True)]
            ),
            *_SUMS,
        )
    )


def sample_table(session: Session, scene: Scene, clock_s: float) -> pl.DataFrame:
    """Return the truth at 10 Hz, on control cycles (the cycle nearest to each tenth of a second)."""
    runs = zip(session.traces, session.begins_s, strict=True)
    return pl.concat([_samples(session, trace, begin, scene, clock_s) for trace, begin in runs])


def _samples(session: Session, trace: Trace, begin_s: float, scene: Scene, clock_s: float) -> pl.DataFrame:
    count = int(len(trace.scaling) * trace.cycle_s * _TRUTH_HZ) + 1
    cycles = np.rint(np.arange(count) / _TRUTH_HZ / trace.cycle_s).astype(np.int64)
    cycles = cycles[cycles < len(trace.scaling)]
    program, of = trace.program, trace.segment[cycles]
    cycles, of = cycles[program.execution[of] >= 0], of[program.execution[of] >= 0]
    robot = robot_states(trace, session.table, begin_s=begin_s, cycles=cycles)
    goals = np.array([scene.places[name] for name in program.goals])
    begun = trace.track.presses(trace.duration_s)
    times = np.asarray(cycles * trace.cycle_s, dtype=np.float64)
    task = np.searchsorted([press.t_s for press in begun], times, side="right") - 1
    human_goals = np.array([press.goal_m for press in begun] or [(np.nan,) * 3])
    human_tasks = [press.goal for press in begun]
    names = {
        (execution.index, i): f"{a}->{b}"
        for execution in program.executions
        for i, (a, b) in enumerate(zip(execution.places[:-1], execution.places[1:], strict=True))
    }
    robot_tasks = [names.get((int(e), int(t)), "") for e, t in zip(program.execution, program.task, strict=True)]
    table = {"execution": pl.Series(program.execution[of]), "t_s": pl.Series(clock_s + robot.t_s)}
    table |= _xyz("robot", robot.tcp_m) | _xyz("human", trace.track.at(times))
    table |= {"scaling": pl.Series(robot.scaling)}
    table |= _xyz("robot_goal", goals[of]) | _xyz("human_goal", human_goals[task])
    table["robot_task"] = pl.Series([robot_tasks[i] for i in of], dtype=pl.String)
    table["human_task"] = pl.Series([human_tasks[i] if human_tasks else None for i in task], dtype=pl.String)
    if trace.caps is not None:
        parts = lost_parts(trace.caps, program.kind[trace.segment])
        table |= {f"lost_{name}": pl.Series(part[cycles]) for name, part in parts.items()}
    return pl.DataFrame(table)


def _xyz(name: str, values: Array) -> dict[str, pl.Series]:
    return {f"{name}_{axis}_m": pl.Series(values[:, i]).fill_nan(None) for i, axis in enumerate("xyz")}
