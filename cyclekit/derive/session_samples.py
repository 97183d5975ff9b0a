"""Second pass over a session: the samples and tasks that need no other session, written to a file.

Short sessions share a file (`sample_file`). The last pass (`session_end`) adds what needs all sessions: the levels of
the scaling and the operator's places.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from cyclekit import schema
from cyclekit.dataset.cards import ExecutionCard, RecordingCard
from cyclekit.dataset.sessions import WITHOUT_PLACES, Session
from cyclekit.derive.sample_file import AT_ONCE, Coded, SampleRows, in_frames, write_samples
from cyclekit.derive.task_lists import listed_in, operator_rows
from cyclekit.errors import EstimateError
from cyclekit.people.activity import OperatorStandstills, Seen, SessionPeople
from cyclekit.segmentation.stored_run import Run, Sampled, sampled
from cyclekit.segmentation.time_account import ExecutedTask, time_account

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.dataset import Place
    from cyclekit.dataset.signals import Read
    from cyclekit.derive.sample_file import Column
    from cyclekit.people.silence import Silence
    from cyclekit.schema import Points, Vector
    from cyclekit.segmentation.arrivals import PlaceStandstills
    from cyclekit.segmentation.dwell import Dwell
    from cyclekit.segmentation.executions import Execution


_MOST_SAMPLES = 10_000_000
"""Maximum number of samples per execution: eleven days at 10 Hz. A wrong timestamp would need too much memory."""


@dataclass(frozen=True)
class SessionToSample:
    """Input of the second pass for one session.

    Attributes:
        session: The session.
        runs: Runs of its robot, by index.
        executions: Their executions, in order of time.
        standstills: Times of the robot's arrival and departure at each visit.
    """

    session: Session
    runs: Mapping[int, Run]
    executions: Sequence[Execution]
    standstills: PlaceStandstills


@dataclass
class Made:
    """Result of the second pass for one session; filled step by step.

    Attributes:
        session: Its name.
        recordings: Cards of its recordings, with operator coverage and notes on task lists.
        part: Name of its file of samples.
        samples: Number of samples.
        cards: Card of each execution.
        tasks: Rows of table TASKS.
        stays: The operator's standstills in each execution.
        later: The operator's standstills from the start of each execution to the next start, and the time up to
            which they are known.
        origins: Origins of the scaling: `logged`, `inferred`.
        silences: Start, end and pauses of each log of people.
        legs: The robot's tasks, in order of time.
    """

    session: str
    recordings: tuple[RecordingCard, ...]
    part: str
    samples: int = 0
    cards: list[ExecutionCard] = field(default_factory=list)
    tasks: list[tuple[object, ...]] = field(default_factory=list)
    stays: list[OperatorStandstills] = field(default_factory=list)
    later: list[tuple[OperatorStandstills, float]] = field(default_factory=list)
    origins: set[str] = field(default_factory=set)
    silences: list[Silence] = field(default_factory=list)
    legs: list[ExecutedTask] = field(default_factory=list)


def samples_of(
    works: Sequence[SessionToSample],
    *,
    places: Mapping[str, Place],
    dwells: Mapping[str, Dwell],
    sources: Mapping[str, Source | None],
    read: Read,
    cell: Cell,
    folder: Path,
) -> list[Made]:
    """Write the samples of sessions that share a file to `folder`; without executions, no file is written.

    Args:
        works: The sessions, their runs, executions and standstills; the file is named after the first session.
        places: All places.
        dwells: The usual dwell at each place, from all sessions.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        cell: Rates, frames, the operator's places.
        folder: Folder of the files of samples.

    Raises:
        EstimateError: An execution is longer than plausible.
    """
    part = works[0].session.name
    made = [Made(work.session.name, work.session.recordings, part) for work in works]

    def rows() -> Iterator[SampleRows]:
        for work, mine in zip(works, made, strict=True):
            session = work.session
            if not work.runs and (listed := listed_in(session, read, cell)):
                mine.cards.extend(one.card(session) for one in listed)
                mine.tasks.extend(row for one in listed for row in one.rows())
                continue
            if all(set(one.tables) <= WITHOUT_PLACES for one in session.recordings):
                continue
            courses = _courses(work, dwells, places, cell)
            if (first := next(courses, None)) is not None:
                people = SessionPeople(session, sources, read, cell)
                yield from _rows(session, chain([first], courses), people, mine)
                listed_rows, said = operator_rows(session, mine.cards, read)
                mine.tasks.extend(listed_rows)
                seen = people.cards()
                mine.recordings = tuple(
                    replace(one, operator=seen.get(one.id), listed=said if "task_list" in one.tables else ())
                    for one in session.recordings
                )
                mine.silences.extend(people.silences)

    frames = in_frames(rows(), AT_ONCE)
    if (begin := next(frames, None)) is not None:
        write_samples(chain([begin], frames), folder / f"{part}.parquet")
    return made


def _rows(session: Session, courses: Iterable[_Course], people: SessionPeople, made: Made) -> Iterator[SampleRows]:
    """Yield the samples of a session in parts, as an execution may be as long as its log; fill `made`."""
    before: tuple[Seen, Vector, Points] | None = None
    for course in courses:
        seen = people.during(course.t_s, course.tcp_m)
        if before is not None:
            made.later.append(people.standstills_until(float(course.t_s[0]), *before))
        before = seen, course.t_s, course.tcp_m
        for first in range(0, len(course.t_s), AT_ONCE):
            yield _columns(course, seen, slice(first, first + AT_ONCE))
        if course.robot is not None and np.isfinite(course.robot.scaling).any():
            made.origins.add("inferred" if course.inferred else "logged")
        made.samples += len(course.t_s)
        made.tasks.extend(_task_rows(course.name, course.legs))
        made.legs.extend(course.legs)
        made.cards.append(_card(session, course, made.part))
        made.stays.append(seen.standstills)
    if before is not None:
        made.later.append(people.standstills_until(np.inf, *before))


@dataclass(frozen=True)
class _Course:
    """Motion and tasks of the robot in one execution.

    Attributes:
        name: Name of the execution.
        complete: Whether the log covers all of it.
        t_s: Times of its samples, shape (T,).
        robot: State of the robot at these times; None without a robot log.
        inferred: Whether the scaling was inferred.
        legs: Its tasks.
        goals_m: Goal of each task, shape (L, 3), m.
    """

    name: str
    complete: bool
    t_s: Vector
    robot: Sampled | None
    inferred: bool
    legs: Sequence[ExecutedTask]
    goals_m: Points

    @property
    def tcp_m(self) -> Points:
        """The TCP at each sample, shape (T, 3), m, NaN = unknown."""
        return np.full((len(self.t_s), 3), np.nan) if self.robot is None else self.robot.xyz_m


def _courses(
    work: SessionToSample, dwells: Mapping[str, Dwell], places: Mapping[str, Place], cell: Cell
) -> Iterator[_Course]:
    """Yield the executions with at least one sample, one at a time to save memory."""
    session = work.session
    for number, execution in enumerate(work.executions if work.runs else [None], 1):
        name = f"{session.name}.{number:03d}"
        if execution is None:
            course = _Course(name, False, _times(name, *session.span_s, cell), None, False, [], np.empty((0, 3)))
        else:
            run = work.runs[execution.run]
            legs = time_account(run, execution, work.standstills, dwells) if execution.visits else []
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


def _columns(course: _Course, seen: Seen, rows: slice) -> SampleRows:
    t = course.t_s[rows]
    columns: dict[str, Column] = {"execution": [course.name] * len(t), "t_s": t}
    if course.robot is not None:
        columns |= {f"robot_{axis}_m": course.robot.xyz_m[rows, k] for k, axis in enumerate("xyz")}
        columns |= _scaling_columns(course.robot, rows, inferred=course.inferred)
    return SampleRows(len(t), {**columns, **_task_columns(t, course), **seen.columns(rows)})


def _scaling_columns(found: Sampled, rows: slice, *, inferred: bool) -> dict[str, Column]:
    scaling = found.scaling[rows]
    known = np.isfinite(scaling)
    return {
        "scaling": scaling,
        "scaling_sd": found.deviation[rows],
        "slider": found.slider[rows],
        "scaling_origin": Coded(np.where(known, 1 if inferred else 0, -1), ("logged", "inferred")),
        "scaling_gap": Coded(np.where(known, -1, found.gap[rows]), schema.SCALING_GAPS),
    }


def _task_columns(t: Vector, course: _Course) -> dict[str, Column]:
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
        "robot_task": Coded(index, tuple(names)),
        "robot_moving": (t < arrivals).tolist(),
    }


def _task_rows(name: str, legs: Sequence[ExecutedTask]) -> list[tuple[object, ...]]:
    return [
        (
            name, index, f"{leg.start_place}->{leg.goal_place}", leg.start_place, leg.goal_place, leg.start_s,
            leg.arrival_s, leg.end_s, leg.nominal_s, leg.safety_loss_s, leg.dwell_s, leg.wait_s,
            "robot", None, None, None, None, leg.reached_s, leg.went_on_s, None,
            None, leg.slider_loss_s, None, None, leg.wait_s - leg.pause_s, leg.pause_s, None, None,
        )
        for index, leg in enumerate(legs)
    ]  # fmt: skip


def _card(session: Session, course: _Course, part: str) -> ExecutionCard:
    legs = course.legs
    return ExecutionCard(
        execution=course.name,
        session=session.name,
        part=None if part == session.name else part,
        start_s=float(course.t_s[0]),
        end_s=float(legs[-1].end_s if legs else course.t_s[-1]),
        complete=course.complete,
        reference=session.reference,
        places=(legs[0].start_place, *(leg.goal_place for leg in legs)) if legs else (),
    )
