"""The samples and tasks of one session, as far as the session alone tells them, written to a file of its own.

What needs all sessions (the levels of the scaling, where the operator's places are) is filled in by `finish`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.account import account
from cyclekit.activity import watch
from cyclekit.atomic import write_parquet
from cyclekit.errors import EstimateError
from cyclekit.motion import sampled
from cyclekit.session import Grid

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.account import Leg
    from cyclekit.activity import Stays
    from cyclekit.config import Cell, Source
    from cyclekit.dataset import Place
    from cyclekit.motion import Run, Sampled
    from cyclekit.process import Dwell
    from cyclekit.segment import Execution
    from cyclekit.session import Session
    from cyclekit.signals import Read
    from cyclekit.stand import Stands

    Vector = NDArray[np.float64]

_MOST_SAMPLES = 10_000_000
"""Of one execution: eleven days at 10 Hz. A time that cannot be would ask for more memory than there is."""


@dataclass(frozen=True)
class Work:
    """One session, and what is known about it when all places are known.

    Attributes:
        session: The session.
        runs: Runs of its robot, by number.
        executions: Their executions, in the order of time.
        stands: When the robot arrived and left at every visit of them.
    """

    session: Session
    runs: Mapping[int, Run]
    executions: Sequence[Execution]
    stands: Stands


@dataclass(frozen=True)
class Made:
    """What was made of one session.

    Attributes:
        session: Its name, that of its file of samples too.
        entries: Entries of its recordings; it is noted there what was seen of the operator.
        samples: How many there are.
        cards: What the dataset's card says about each execution.
        tasks: Rows of table TASKS.
        stays: Where the operator stayed, of each execution.
        origins: Whence the scaling comes: `logged`, `inferred`.
    """

    session: str
    entries: list[dict[str, Any]]
    samples: int
    cards: list[dict[str, Any]]
    tasks: list[tuple[object, ...]]
    stays: list[Stays]
    origins: set[str]


def samples_of(
    work: Work,
    *,
    places: Mapping[str, Place],
    dwells: Mapping[str, Dwell],
    sources: Mapping[str, Source | None],
    read: Read,
    cell: Cell,
    folder: Path,
) -> Made:
    """Write the samples of one session to `folder`; without executions there is no file.

    Args:
        work: The session, its runs, their executions and stands.
        places: All places.
        dwells: The usual dwell at each, from all sessions.
        sources: What the cell file says about each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        cell: Rates, frames, the operator's places.
        folder: Where the files of samples lie.

    Raises:
        EstimateError: An execution cannot be so long.
    """
    session = work.session
    grids, tasks, cards = [], list[tuple[object, ...]](), []
    for number, (execution, legs) in enumerate(_executions(work, dwells), 1):
        name = f"{session.name}.{number:03d}"
        grid = _grid(session, name, execution, legs, work.runs, places, cell)
        if len(grid.t_s):
            grids.append(grid)
            tasks += _task_rows(name, legs)
            cards.append(_card(name, session, execution, legs, grid))
    if not grids:
        return Made(session.name, session.entries, 0, [], [], [], set())
    frames, stays = watch(session, grids, sources, read, cell)
    samples = schema.conform(pl.concat(frames), schema.SAMPLES)
    write_parquet(samples, folder / f"{session.name}.parquet")
    origins = set(samples["scaling_origin"].drop_nulls().unique().to_list())
    return Made(session.name, session.entries, samples.height, cards, tasks, stays, origins)


def _executions(work: Work, dwells: Mapping[str, Dwell]) -> list[tuple[Execution | None, list[Leg]]]:
    if not work.runs:
        return [(None, [])]
    return [(e, account(work.runs[e.run], e, work.stands, dwells) if e.visits else []) for e in work.executions]


def _grid(
    session: Session,
    name: str,
    execution: Execution | None,
    legs: list[Leg],
    runs: Mapping[int, Run],
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
    return Grid(name, t, schema.conform(pl.DataFrame(columns, nan_to_null=True, strict=False), schema.SAMPLES))


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


def _card(name: str, session: Session, execution: Execution | None, legs: Sequence[Leg], grid: Grid) -> dict[str, Any]:
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
