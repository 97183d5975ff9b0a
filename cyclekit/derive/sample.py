"""The samples and tasks of one session, as far as the session alone tells them, written to a file of its own.

What needs all sessions (the levels of the scaling, where the operator's places are) is filled in by `finish`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.account import account
from cyclekit.activity import Watch
from cyclekit.derive.listed import listed_in, operator_rows
from cyclekit.derive.sample_file import AT_ONCE, write_samples
from cyclekit.errors import EstimateError
from cyclekit.motion import sampled
from cyclekit.session import WITHOUT_PLACES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.account import Leg
    from cyclekit.activity import Seen, Stays
    from cyclekit.config import Cell, Source
    from cyclekit.dataset import Place
    from cyclekit.motion import Run, Sampled
    from cyclekit.process import Dwell
    from cyclekit.segment import Execution
    from cyclekit.session import Session
    from cyclekit.signals import Read
    from cyclekit.silence import Silence
    from cyclekit.stand import Stands

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]

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
        silences: How each of its logs of people begins, ends and pauses.
    """

    session: str
    entries: list[dict[str, Any]]
    samples: int
    cards: list[dict[str, Any]]
    tasks: list[tuple[object, ...]]
    stays: list[Stays]
    origins: set[str]
    silences: list[Silence] = field(default_factory=list)


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
    made = Made(session.name, session.entries, 0, [], [], [], set())
    courses = _courses(work, dwells, places, cell)
    if not work.runs and (listed := listed_in(session, read, cell)):
        rows = [row for one in listed for row in one.rows()]
        return replace(made, cards=[one.card(session) for one in listed], tasks=rows)
    if all(set(entry["tables"]) <= WITHOUT_PLACES for entry in session.entries):
        return made
    if (first := next(courses, None)) is None:
        return made
    watch = Watch(session, sources, read, cell)
    frames = _frames(session, chain([first], courses), watch, made)
    samples = write_samples(frames, folder / f"{session.name}.parquet")
    watch.note()
    made.tasks.extend(operator_rows(session, made.cards, read))
    return replace(made, samples=samples, silences=watch.silences)


def _frames(session: Session, courses: Iterable[_Course], watch: Watch, made: Made) -> Iterator[pl.DataFrame]:
    """Yield the samples of a session, in parts, since an execution may last as long as its log; fill in the rest."""
    for course in courses:
        seen = watch.during(course.t_s, course.tcp_m)
        for first in range(0, len(course.t_s), AT_ONCE):
            frame = _frame(course, seen, slice(first, first + AT_ONCE))
            made.origins.update(frame["scaling_origin"].drop_nulls().unique())
            yield frame
        made.tasks.extend(_task_rows(course.name, course.legs))
        made.cards.append(_card(session, course))
        made.stays.append(seen.stays)


@dataclass(frozen=True)
class _Course:
    """What the robot did in one execution.

    Attributes:
        name: Of the execution.
        complete: The log shows all of it.
        t_s: Times of its samples, shape (T,).
        robot: The robot there; None without a robot log.
        inferred: Its scaling was inferred and not logged.
        legs: Its tasks.
        goals_m: Where each of them ends, shape (L, 3), metres.
    """

    name: str
    complete: bool
    t_s: Vector
    robot: Sampled | None
    inferred: bool
    legs: Sequence[Leg]
    goals_m: Points

    @property
    def tcp_m(self) -> Points:
        """The TCP at each sample, shape (T, 3), NaN = unknown."""
        return np.full((len(self.t_s), 3), np.nan) if self.robot is None else self.robot.xyz_m


def _courses(work: Work, dwells: Mapping[str, Dwell], places: Mapping[str, Place], cell: Cell) -> Iterator[_Course]:
    """Yield the executions that last long enough for a sample, one at a time: all of them may be large."""
    session = work.session
    for number, execution in enumerate(work.executions if work.runs else [None], 1):
        name = f"{session.name}.{number:03d}"
        if execution is None:
            course = _Course(name, False, _times(name, *session.span_s, cell), None, False, [], np.empty((0, 3)))
        else:
            run = work.runs[execution.run]
            legs = account(run, execution, work.stands, dwells) if execution.visits else []
            ends = (legs[0].start_s, legs[-1].end_s) if legs else (run.time_at(0), run.time_at(run.rows - 1))
            robot = sampled(run, _times(name, *ends, cell))
            goals_m = np.array([places[leg.goal_place].xyz_m for leg in legs]).reshape(-1, 3)
            course = _Course(name, execution.complete, robot.t_s, robot, run.is_inferred, legs, goals_m)
        if len(course.t_s):
            yield course


def _times(name: str, start: float, end: float, cell: Cell) -> Vector:
    if (end - start) * cell.rate_hz > _MOST_SAMPLES:
        msg = f"{name}: lasts {(end - start) / 86400:.0f} days, more than {_MOST_SAMPLES:,} samples"
        raise EstimateError(msg, cure="Look for a time that jumps ahead with `cyclekit inspect`, or cut the log.")
    return np.asarray(start + np.arange(int((end - start) * cell.rate_hz + 1e-6) + 1) / cell.rate_hz)


def _frame(course: _Course, seen: Seen, rows: slice) -> pl.DataFrame:
    t = course.t_s[rows]
    columns: dict[str, Any] = {"execution": [course.name] * len(t), "t_s": t}
    if course.robot is not None:
        columns |= {f"robot_{axis}_m": course.robot.xyz_m[rows, k] for k, axis in enumerate("xyz")}
        columns |= _scaling_columns(course.robot, rows, inferred=course.inferred)
    columns |= _task_columns(t, course) | seen.columns(rows)
    return schema.conform(pl.DataFrame(columns, nan_to_null=True, strict=False), schema.SAMPLES)


def _scaling_columns(found: Sampled, rows: slice, *, inferred: bool) -> dict[str, Any]:
    known = np.isfinite(found.scaling[rows])
    whence = pl.lit("inferred" if inferred else "logged")
    why = pl.Series(found.gap[rows], dtype=pl.Int8)
    names = dict(enumerate(schema.SCALING_GAPS))
    said = pl.DataFrame({"known": known, "why": why}).select(
        scaling_origin=pl.when("known").then(whence),
        scaling_gap=pl.when(~pl.col("known")).then(pl.col("why").replace_strict(names, return_dtype=pl.String)),
    )
    columns = {"scaling": found.scaling[rows], "scaling_sd": found.deviation[rows], "slider": found.slider[rows]}
    return columns | {name: said[name] for name in said.columns}


def _task_columns(t: Vector, course: _Course) -> dict[str, Any]:
    legs = course.legs
    if not legs:
        return {}
    starts = np.array([leg.start_s for leg in legs])
    index = np.clip(np.searchsorted(starts, t + 1e-9, side="right") - 1, 0, len(legs) - 1)
    goals = course.goals_m[index]
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
            "robot", None, None, None, None,
        )
        for index, leg in enumerate(legs)
    ]  # fmt: skip


def _card(session: Session, course: _Course) -> dict[str, Any]:
    legs = course.legs
    return {
        "execution": course.name,
        "session": session.name,
        "start_s": float(course.t_s[0]),
        "end_s": float(legs[-1].end_s if legs else course.t_s[-1]),
        "complete": course.complete,
        "reference": session.reference,
        "places": [legs[0].start_place, *(leg.goal_place for leg in legs)] if legs else [],
    }
