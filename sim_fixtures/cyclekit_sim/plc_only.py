"""Cells of which only the PLC writes a log: bits, steps or words that say where the robot is, and what is around it.

The cells are those with fields; their robot moves as ever, but its own log is not written. Between two executions it
stands at home until the start button is pressed.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl

from cyclekit_sim.arm import Array
from cyclekit_sim.fields import Field
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.plan import prepare, run_sessions
from cyclekit_sim.program import HOME, MOVE, Ints
from cyclekit_sim.scenes import Scene
from cyclekit_sim.session import Session
from cyclekit_sim.simulate import set_up

Program = Literal["stations", "steps", "words"]
Form = Literal["sampled", "changes"]
SCAN_S, BEFORE_S, PRESSED_S = 0.1, 3.0, 0.4
"""Time between two samples; length of the log before the first and after the last execution; how long the start button
is pressed, s."""
STATION = "Rob_an_{}"
"""Bit of a station."""
_DAY = datetime(2025, 6, 2, 8, 0, 0)


def plc_cell(scene: str, *, executions: int, seed: int) -> tuple[Scene, Session]:
    """Return a cell with fields in motion: all executions in one session; the same seed gives the same motion."""
    cell, options = set_up(scene, SimulationOptions(people="signals", executions_per_session=executions))
    (session,) = run_sessions(prepare(cell, seed, options, executions=executions))
    return cell, session


def write_plc_only(path: Path, cell: Scene, session: Session, program: Program, form: Form) -> None:
    """Write the trace of a cell.

    Args:
        path: The file.
        cell: The cell.
        session: Its motion, from `plc_cell`.
        program: `stations`: a bit for each, and a start button. `steps`: the step of a chain: 0 at home, 5 on the way
            there, ten times the number of another place on the way to it, one more there. `words`: its place, or
            `Fahrt`.
        form: A row every SCAN_S, or one for each change of any column.
    """
    names = [HOME, *(name for name in cell.places if name != HOME)]
    end_s = session.end_s + BEFORE_S
    t_s = np.arange(-BEFORE_S, end_s, 0.01)
    at, toward = _where(session, names, t_s)
    columns = _states(program, names, at, toward) | _around(session, cell.fields, t_s)
    if program == "stations":
        pressed = [(t_s >= begin - PRESSED_S) & (t_s < begin) for begin in session.begins_s]
        columns["Taste_Start"] = np.where(np.any(pressed, axis=0), "1", "0")
    if form == "sampled":
        kept = np.arange(0, len(t_s), round(SCAN_S / 0.01))
    else:
        kept = np.flatnonzero(np.any([np.append(True, each[1:] != each[:-1]) for each in columns.values()], axis=0))
    time = {"Zeit [ms]" if program == "stations" else "Zeit": _times(program, t_s[kept])}
    rows = pl.DataFrame(time | {name: values[kept] for name, values in columns.items()})
    path.parent.mkdir(parents=True, exist_ok=True)
    rows.write_csv(path, separator=";", line_terminator="\r\n")


def _where(session: Session, names: list[str], t_s: Array) -> tuple[Ints, Ints]:
    """Return the number of the place where the robot is, -1 on its way, and the one that it goes to; shape (N,)."""
    at, toward = np.zeros(len(t_s), dtype=np.int64), np.zeros(len(t_s), dtype=np.int64)
    for trace, begin_s in zip(session.traces, session.begins_s, strict=True):
        for kind, goal, first_s, last_s in zip(
            trace.program.kind, trace.program.goals, trace.begins_s, trace.ends_s, strict=True
        ):
            here = (t_s >= begin_s + first_s) & (t_s < begin_s + last_s)
            toward[here] = names.index(goal)
            at[here] = -1 if kind == MOVE else names.index(goal)
    return at, toward


def _states(program: Program, names: list[str], at: Ints, toward: Ints) -> dict[str, Array]:
    if program == "stations":
        return {STATION.format(name): np.where(at == n, "1", "0") for n, name in enumerate(names) if name != HOME}
    if program == "steps":
        return {"Schritt": np.select([at == 0, toward == 0], [0, 5], 10 * toward + (at >= 0)).astype(str)}
    return {"Zustand": np.where(at < 0, "Fahrt", np.array(names)[at])}


def _around(session: Session, fields: Sequence[Field], t_s: Array) -> dict[str, Array]:
    """Return the columns of gripper, fields, door, program and override."""
    robot = session.robot
    row = np.clip(np.searchsorted(robot.t_s, t_s, side="right") - 1, 0, len(robot.t_s) - 1)
    moving = np.any(
        [(t_s >= b) & (t_s < b + t.duration_s) for t, b in zip(session.traces, session.begins_s, strict=True)], axis=0
    )
    percent = np.where(moving, np.round(100.0 * robot.scaling[row], 1), 100.0)
    found = {"Greifer_zu": np.where(robot.closed[row] == 1, "1", "0")}
    found |= {one.name: ((robot.inputs[row] >> one.bit) & 1).astype(str) for one in fields}
    found |= {"Tuer_zu": np.full(len(t_s), "1"), "Programm": np.where(moving, "3", "0")}
    return found | {"Override_Prozent": np.char.replace(np.char.mod("%.1f", percent), ".", ",")}


def _times(program: Program, t_s: Array) -> list[str]:
    if program == "stations":
        return [f"{1e3 * (t + 41.3):.1f}".replace(".", ",") for t in t_s.tolist()]
    form = "%d.%m.%Y %H:%M:%S.%f" if program == "steps" else "%Y-%m-%dT%H:%M:%S.%f"
    return [(_DAY + timedelta(seconds=t + 41.3)).strftime(form)[:-3] for t in t_s.tolist()]
