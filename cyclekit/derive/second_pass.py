"""Second pass over a session: the samples and tasks that need no other session, written to a file.

Short sessions share a file (`sample_file`). The last pass (`last_pass`) adds what needs all sessions: the levels of
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
from cyclekit.people.hesitations import without_hesitations
from cyclekit.segmentation.stored_run import Run, Sampled, sampled
from cyclekit.segmentation.time_account import ExecutedTask, time_account
from cyclekit.text.numbers import count, fixed

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
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


_MAX_SAMPLES = 10_000_000
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
class SecondPassResult:
    """Result of the second pass for one session; filled step by step.

    Attributes:
        session: Its name.
        recordings: Cards of its recordings, with operator coverage and notes on task lists.
        part: Name of its file of samples.
        samples: Number of samples.
        cards: Card of each execution.
        tasks: Rows of table TASKS.
        operator_standstills: The operator's standstills in each execution.
        standstills_to_next: The operator's standstills from the start of each execution to the next start, and the
            time up to which they are known.
        origins: Origins of the scaling: `logged`, `inferred`.
        silences: Start, end and pauses of each log of people.
        executed_tasks: The robot's tasks, in order of time.
    """

    session: str
    recordings: tuple[RecordingCard, ...]
    part: str
    samples: int = 0
    cards: list[ExecutionCard] = field(default_factory=list)
    tasks: list[tuple[object, ...]] = field(default_factory=list)
    operator_standstills: list[OperatorStandstills] = field(default_factory=list)
    standstills_to_next: list[tuple[OperatorStandstills, float]] = field(default_factory=list)
    origins: set[str] = field(default_factory=set)
    silences: list[Silence] = field(default_factory=list)
    executed_tasks: list[ExecutedTask] = field(default_factory=list)

    def drop_hesitations(self, places: Mapping[str, Place], quick: Collection[str]) -> None:
        """Drop the operator's short standstills except at places where he is always quick."""
        self.operator_standstills = [without_hesitations(one, places, quick) for one in self.operator_standstills]
        self.standstills_to_next = [
            (without_hesitations(one, places, quick), until_s) for one, until_s in self.standstills_to_next
        ]


def second_pass(
    sessions: Sequence[SessionToSample],
    *,
    places: Mapping[str, Place],
    dwells: Mapping[str, Dwell],
    sources: Mapping[str, Source | None],
    read: Read,
    cell: Cell,
    folder: Path,
) -> list[SecondPassResult]:
    """Write the samples of sessions that share a file to `folder`; without executions, no file is written.

    Args:
        sessions: The sessions, their runs, executions and standstills; the file is named after the first session.
        places: All places.
        dwells: The usual dwell at each place, from all sessions.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        cell: Rates, frames, the operator's places.
        folder: Folder of the files of samples.

    Raises:
        EstimateError: An execution is longer than plausible.
    """
    part = sessions[0].session.name
    results = [SecondPassResult(work.session.name, work.session.recordings, part) for work in sessions]

    def rows() -> Iterator[SampleRows]:
        for work, mine in zip(sessions, results, strict=True):
            session = work.session
            if not work.runs and (listed := listed_in(session, read, cell)):
                mine.cards.extend(one.card(session) for one in listed)
                mine.tasks.extend(row for one in listed for row in one.rows())
                continue
            if all(set(one.tables) <= WITHOUT_PLACES for one in session.recordings):
                continue
            motions = _motions(work, dwells, places, cell)
            if (first := next(motions, None)) is not None:
                people = SessionPeople(session, sources, read, cell)
                yield from _rows(session, chain([first], motions), people, mine)
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
    return results


def _rows(
    session: Session, motions: Iterable[_RobotMotion], people: SessionPeople, result: SecondPassResult
) -> Iterator[SampleRows]:
    """Yield the samples of a session in parts, as an execution may be as long as its log; fill `result`."""
    before: tuple[Seen, Vector, Points] | None = None
    for motion in motions:
        seen = people.during(motion.t_s, motion.tcp_m)
        if before is not None:
            result.standstills_to_next.append(people.standstills_until(float(motion.t_s[0]), *before))
        before = seen, motion.t_s, motion.tcp_m
        for first in range(0, len(motion.t_s), AT_ONCE):
            yield _columns(motion, seen, slice(first, first + AT_ONCE))
        if motion.robot is not None and np.isfinite(motion.robot.scaling).any():
            result.origins.add("inferred" if motion.inferred else "logged")
        result.samples += len(motion.t_s)
        result.tasks.extend(_task_rows(motion.name, motion.executed_tasks))
        result.executed_tasks.extend(motion.executed_tasks)
        result.cards.append(_card(session, motion, result.part))
        result.operator_standstills.append(seen.standstills)
    if before is not None:
        result.standstills_to_next.append(people.standstills_until(np.inf, *before))


@dataclass(frozen=True)
class _RobotMotion:
    """Motion and tasks of the robot in one execution.

    Attributes:
        name: Name of the execution.
        complete: Whether the log covers all of it.
        t_s: Times of its samples, shape (T,).
        robot: State of the robot at these times; None without a robot log.
        inferred: Whether the scaling was inferred.
        executed_tasks: Its tasks.
        goals_m: Goal of each task, shape (L, 3), m.
    """

    name: str
    complete: bool
    t_s: Vector
    robot: Sampled | None
    inferred: bool
    executed_tasks: Sequence[ExecutedTask]
    goals_m: Points

    @property
    def tcp_m(self) -> Points:
        """The TCP at each sample, shape (T, 3), m, NaN = unknown."""
        return np.full((len(self.t_s), 3), np.nan) if self.robot is None else self.robot.xyz_m


def _motions(
    work: SessionToSample, dwells: Mapping[str, Dwell], places: Mapping[str, Place], cell: Cell
) -> Iterator[_RobotMotion]:
    """Yield the executions with at least one sample, one at a time to save memory."""
    session = work.session
    mine = [log for log in session.recordings if log.rows.get("robot") or not work.runs]
    longest = max(mine, key=lambda log: log.duration_s).sources[0].path
    for number, execution in enumerate(work.executions if work.runs else [None], 1):
        name = f"{session.name}.{number:03d}"
        if execution is None:
            motion = _RobotMotion(
                name, False, _times(longest, *session.span_s, cell), None, False, [], np.empty((0, 3))
            )
        else:
            run = work.runs[execution.run]
            tasks = time_account(run, execution, work.standstills, dwells) if execution.visits else []
            ends = (tasks[0].start_s, tasks[-1].end_s) if tasks else (run.time_at(0), run.time_at(run.rows - 1))
            robot = sampled(run, _times(longest, *ends, cell))
            goals_m = np.array([places[task.goal_place].xyz_m for task in tasks]).reshape(-1, 3)
            motion = _RobotMotion(name, execution.complete, robot.t_s, robot, run.is_inferred, tasks, goals_m)
        if len(motion.t_s):
            yield motion


def _times(log: str, start: float, end: float, cell: Cell) -> Vector:
    if (end - start) * cell.rate_hz > _MAX_SAMPLES:
        msg = f"{log}: lasts {fixed((end - start) / 86400, 0)} days, more than {count(_MAX_SAMPLES)} samples"
        raise EstimateError(msg, cure="Look for a time that jumps ahead with `cyclekit inspect`, or cut the log.")
    return np.asarray(start + np.arange(int((end - start) * cell.rate_hz + 1e-6) + 1) / cell.rate_hz)


def _columns(motion: _RobotMotion, seen: Seen, rows: slice) -> SampleRows:
    t = motion.t_s[rows]
    columns: dict[str, Column] = {"execution": [motion.name] * len(t), "t_s": t}
    if motion.robot is not None:
        columns |= {f"robot_{axis}_m": motion.robot.xyz_m[rows, k] for k, axis in enumerate("xyz")}
        columns |= _scaling_columns(motion.robot, rows, inferred=motion.inferred)
    return SampleRows(len(t), {**columns, **_task_columns(t, motion), **seen.columns(rows)})


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


def _task_columns(t: Vector, motion: _RobotMotion) -> dict[str, Column]:
    tasks = motion.executed_tasks
    if not tasks:
        return {}
    starts = np.array([task.start_s for task in tasks])
    index = np.clip(np.searchsorted(starts, t + 1e-9, side="right") - 1, 0, len(tasks) - 1)
    goals = motion.goals_m[index]
    arrivals = np.array([task.moves_until_s for task in tasks])[index]
    names = [f"{task.start_place}->{task.goal_place}" for task in tasks]
    return {
        **{f"robot_goal_{axis}_m": goals[:, k] for k, axis in enumerate("xyz")},
        "robot_task": Coded(index, tuple(names)),
        "robot_moving": (t < arrivals).tolist(),
    }


def _task_rows(name: str, tasks: Sequence[ExecutedTask]) -> list[tuple[object, ...]]:
    return [
        (
            name, index, f"{task.start_place}->{task.goal_place}", task.start_place, task.goal_place, task.start_s,
            task.arrival_s, task.end_s, task.nominal_s, task.safety_loss_s, task.dwell_s, task.wait_s,
            "robot", None, None, None, None, task.reached_s, task.went_on_s, None,
            None, task.slider_loss_s, None, None, task.wait_s - task.pause_s, task.pause_s, None, None, task.cut,
        )
        for index, task in enumerate(tasks)
    ]  # fmt: skip


def _card(session: Session, motion: _RobotMotion, part: str) -> ExecutionCard:
    tasks = motion.executed_tasks
    return ExecutionCard(
        execution=motion.name,
        session=session.name,
        part=None if part == session.name else part,
        start_s=float(motion.t_s[0]),
        end_s=float(tasks[-1].end_s if tasks else motion.t_s[-1]),
        complete=motion.complete,
        reference=session.reference,
        places=(tasks[0].start_place, *(task.goal_place for task in tasks if task.arrival_s is not None))
        if tasks
        else (),
    )
