"""From recordings to samples and tasks: one clock, one base frame, executions, goals, scaling.

Everything here can be computed again from the recordings, without the vendor files. Reading those is the business of
`ingest`, finding places and executions that of `segment`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.account import Leg, account, usual_dwells
from cyclekit.activity import with_operator
from cyclekit.align import place_in_time
from cyclekit.dataset import Place
from cyclekit.dynamics import Change, Dynamics, changes_of, read_dynamics
from cyclekit.errors import EstimateError
from cyclekit.load_runs import load_runs
from cyclekit.motion import pieces, sampled
from cyclekit.samples import stretches
from cyclekit.scaling import with_scaling
from cyclekit.segment import Execution, find_executions, find_places, find_stops, find_visits
from cyclekit.session import Grid
from cyclekit.stand import stands_of
from cyclekit.steps import Staircase, find_staircase
from cyclekit.tables import forget, keeping
from cyclekit.turns import with_turns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.account import Dwell
    from cyclekit.config import Cell, Source
    from cyclekit.motion import Run, Sampled
    from cyclekit.session import Session
    from cyclekit.signals import Read, Stored
    from cyclekit.stand import Stands

    Vector = NDArray[np.float64]
    Rows = NDArray[np.int64]

_KEPT_BYTES = 160 << 20
"""Of decoded rows while the scaling is inferred: the fastest repetitions of each motion lie all over the log."""
_MOST_SAMPLES = 10_000_000
"""Of one execution: eleven days at 10 Hz. A time that cannot be would ask for more memory than there is."""


@dataclass(frozen=True)
class Derived:
    """All that a dataset says beyond its recordings; `samples` by session."""

    samples: Mapping[str, pl.DataFrame]
    tasks: pl.DataFrame
    executions: list[dict[str, Any]]
    places: Mapping[str, Place]
    human_places: Mapping[str, Place]
    levels: tuple[float, ...]
    origin: str | None
    dynamics: Dynamics
    warnings: list[str]


def derive(
    sessions: Sequence[Session],
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
    cell: Cell,
    progress: Callable[[float, str], None],
    *,
    coarse: bool = False,
) -> Derived:
    """Compute samples and tasks.

    Args:
        sessions: From `ingest`; their entries get `clock` and `frame` filled in.
        sources: What the cell file says about each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
        cell: Places, execution rule, rates.
        progress: Told fraction and text.
        coarse: Where nothing says how a clock relates to the robot's, align on the operator being near while the
            robot slows; hides the reaction delay.

    Raises:
        UnknownName: The cell file's home is no place that was found.
        ConfigError: Executions are to begin by a register or output that was not logged, or a clock or frame is to be
            found in a way that these logs do not allow.
    """
    for session in sessions:
        place_in_time(session, sources, read, stored, coarse_step_s=1.0 / cell.rate_hz if coarse else None)
        spans = [_session_span(entry) for entry in session.entries]
        session.span_s = (min(a for a, _ in spans), max(b for _, b in spans))
    runs, marks = load_runs(sessions, read, stored, cell, lambda done, told: progress(0.2 * done, told))
    stops = [stop for number, run in enumerate(runs) for stop in find_stops(run, number)]
    places = find_places(runs, stops, cell.places)
    visits = find_visits(stops, places, runs)
    if all(len({visit.place for visit in seen}) < 2 for seen in visits):  # it rests at one place at most
        stops = with_turns(runs, stops)
        places = find_places(runs, stops, cell.places)
        visits = find_visits(stops, places, runs)
    executions = find_executions(visits, places, cell.executions, marks)
    executions += _whole_runs(runs, executions)
    with keeping(_KEPT_BYTES):
        runs, warnings = with_scaling(
            runs, executions, places, sessions, lambda done, told: progress(0.2 + 0.4 * done, told)
        )
    stands = stands_of(runs, executions, places)
    dwells = usual_dwells(executions, stands)
    by_run: dict[int, list[Execution]] = {}
    for found in executions:
        by_run.setdefault(found.run, []).append(found)
    grids, rows, cards = [], [], []
    for number, session in enumerate(sessions):
        progress(0.6 + 0.3 * number / len(sessions), f"samples of {session.name}")
        for k, (execution, legs) in enumerate(_session_executions(session, runs, by_run, stands, dwells), 1):
            name = f"{session.name}.{k:03d}"
            grid = _grid(session, name, execution, legs, runs, places, cell)
            if len(grid.t_s):
                grids.append(grid)
                rows += _task_rows(name, legs)
                cards.append(_execution_card(name, session, execution, legs, grid))
    forget()  # the samples of many hours take that memory
    grids, human_places = with_operator(grids, sources, read, cell)
    staircase = _staircase(grids, cell)
    samples = _by_session(grids, staircase.label)
    levels = tuple(round(float(level), 6) for level in staircase.levels)
    tasks = pl.DataFrame(rows, schema={name: column.dtype for name, column in schema.TASKS.items()}, orient="row")
    dynamics = _dynamics(sessions, grids, runs, levels)
    said = [*warnings, *staircase.warnings]
    return Derived(samples, tasks, cards, places, human_places, levels, _origin(samples), dynamics, said)


def _dynamics(
    sessions: Sequence[Session], grids: Sequence[Grid], runs: Sequence[Run], levels: Sequence[float]
) -> Dynamics:
    """Read latency, ramps and hysteresis from the scaling at its native rate; sessions follow each other in time."""
    changes, times, distances, begin = list[Change](), [np.empty(0)], [np.empty(0)], 0.0
    for session in sessions:
        for number in session.runs:
            for _, part in pieces(runs[number]):
                found = changes_of(part.t_s, part.scaling, levels)
                changes += [change._replace(t_s=change.t_s + begin) for change in found]
        for grid in (grid for grid in grids if grid.session is session):
            tcp = grid.frame.select("robot_x_m", "robot_y_m", "robot_z_m").to_numpy()
            times.append(grid.t_s + begin)
            distances.append(np.linalg.norm(tcp - grid.human_m, axis=1))
        begin += session.span_s[1] - min(session.span_s[0], 0.0) + 1e4
    return read_dynamics(changes, np.concatenate(times), np.concatenate(distances))


def _staircase(grids: Sequence[Grid], cell: Cell) -> Staircase:
    """Find the levels of the scaling of all executions, or label them by those that the cell file fixes."""
    if not grids:
        return find_staircase(np.empty(0))
    frame = pl.concat([grid.frame.select("execution", "t_s", "scaling") for grid in grids])
    run = stretches(frame, cell.rate_hz)
    return find_staircase(frame["scaling"].fill_null(np.nan).to_numpy(), run=run, levels=cell.levels or None)


def _session_span(entry: Mapping[str, Any]) -> tuple[float, float]:
    clock = entry["clock"]
    return (
        entry["first_s"] * clock["rate"] + clock["offset_s"],
        entry["last_s"] * clock["rate"] + clock["offset_s"],
    )


def _whole_runs(runs: Sequence[Run], executions: Sequence[Execution]) -> list[Execution]:
    """A run in which no task was found is still an execution: it can be inspected and replayed."""
    covered = {execution.run for execution in executions}
    return [Execution(number, (), False) for number in range(len(runs)) if number not in covered]


def _session_executions(
    session: Session,
    runs: Sequence[Run],
    by_run: Mapping[int, list[Execution]],
    stands: Stands,
    dwells: Mapping[str, Dwell],
) -> list[tuple[Execution | None, list[Leg]]]:
    if not session.runs:
        return [(None, [])]
    mine = [execution for number in session.runs for execution in sorted(by_run.get(number, []), key=_first_row)]
    return [(e, account(runs[e.run], e, stands, dwells) if e.visits else []) for e in mine]


def _first_row(execution: Execution) -> int:
    return execution.visits[0].first if execution.visits else 0


def _grid(
    session: Session,
    name: str,
    execution: Execution | None,
    legs: list[Leg],
    runs: Sequence[Run],
    places: Mapping[str, Place],
    cell: Cell,
) -> Grid:
    if execution is None:
        start, end = session.span_s
    elif legs:
        start, end = legs[0].start_s, legs[-1].end_s
    else:
        run = runs[execution.run]
        start, end = run.time_at(0), run.time_at(run.rows - 1)
    if (end - start) * cell.rate_hz > _MOST_SAMPLES:
        msg = f"{name}: lasts {(end - start) / 86400:.0f} days, more than {_MOST_SAMPLES:,} samples"
        raise EstimateError(msg, cure="Look for a time that jumps ahead with `cyclekit inspect`, or cut the log.")
    t = start + np.arange(int((end - start) * cell.rate_hz + 1e-6) + 1) / cell.rate_hz
    columns: dict[str, Any] = {}
    if execution is not None:
        found = sampled(runs[execution.run], t)
        t = found.t_s
        columns |= {f"robot_{axis}_m": found.xyz_m[:, k] for k, axis in enumerate("xyz")}
        columns |= _scaling_columns(found, inferred=runs[execution.run].is_inferred)
    columns |= {"execution": [name] * len(t), "t_s": t, **_task_columns(t, legs, places)}
    frame = schema.conform(pl.DataFrame(columns, nan_to_null=True, strict=False), schema.SAMPLES)
    return Grid(session, name, t, frame, np.full((len(t), 3), np.nan))


def _scaling_columns(found: Sampled, *, inferred: bool) -> dict[str, Any]:
    known = np.isfinite(found.scaling)
    whence = pl.lit("inferred" if inferred else "logged")
    why = pl.Series(found.gap, dtype=pl.Int8)
    names = dict(enumerate(schema.SCALING_GAPS))
    said = pl.DataFrame({"known": known, "why": why}).select(
        scaling_origin=pl.when("known").then(whence),
        scaling_gap=pl.when(~pl.col("known")).then(pl.col("why").replace_strict(names, return_dtype=pl.String)),
    )
    columns = {"scaling": found.scaling, "scaling_sd": found.deviation, "slider": found.slider}
    return columns | {name: said[name] for name in said.columns}


def _origin(samples: Mapping[str, pl.DataFrame]) -> str | None:
    """Return whence the scaling of all samples comes: logged, inferred, or both."""
    seen = {name for frame in samples.values() for name in frame["scaling_origin"].drop_nulls().unique().to_list()}
    return " and ".join(sorted(seen, reverse=True)) or None


def _task_columns(t: Vector, legs: Sequence[Leg], places: Mapping[str, Place]) -> dict[str, Any]:
    if not legs:
        return {}
    starts = np.array([leg.start_s for leg in legs])
    index = np.clip(np.searchsorted(starts, t + 1e-9, side="right") - 1, 0, len(legs) - 1)
    goals = np.array([places[leg.goal_place].xyz_m for leg in legs])[index]
    arrivals = np.array([leg.arrival_s for leg in legs])[index]
    names = [f"{leg.start_place}->{leg.goal_place}" for leg in legs]
    return {
        **{f"robot_goal_{axis}_m": goals[:, k] for k, axis in enumerate("xyz")},
        "robot_task": [names[i] for i in index.tolist()],
        "robot_moving": t < arrivals,
    }


def _task_rows(name: str, legs: Sequence[Leg]) -> list[tuple[object, ...]]:
    return [
        (
            name, index, f"{leg.start_place}->{leg.goal_place}", leg.start_place, leg.goal_place, leg.start_s,
            leg.arrival_s, leg.end_s, leg.nominal_s, leg.slider_loss_s, leg.safety_loss_s, leg.dwell_s, leg.wait_s,
        )
        for index, leg in enumerate(legs)
    ]  # fmt: skip


def _execution_card(
    name: str, session: Session, execution: Execution | None, legs: Sequence[Leg], grid: Grid
) -> dict[str, Any]:
    end = legs[-1].end_s if legs else float(grid.t_s[-1])
    return {
        "execution": name,
        "session": session.name,
        "start_s": float(grid.t_s[0]),
        "end_s": float(end),
        "complete": bool(execution is not None and execution.complete),
        "reference": session.reference,
        "places": [legs[0].start_place, *(leg.goal_place for leg in legs)] if legs else [],
    }


def _by_session(grids: Sequence[Grid], labels: NDArray[np.int32]) -> dict[str, pl.DataFrame]:
    frames: dict[str, list[pl.DataFrame]] = {}
    begin = 0
    for grid in grids:
        label = labels[begin : begin + len(grid.t_s)]
        begin += len(grid.t_s)
        step = pl.Series("step", label, dtype=pl.Int32)
        frame = grid.frame.with_columns(step=pl.when(step >= 0).then(step))
        frames.setdefault(grid.session.name, []).append(frame)
    return {name: schema.conform(pl.concat(parts), schema.SAMPLES) for name, parts in frames.items()}
