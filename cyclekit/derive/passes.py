"""From recordings to samples and tasks: one clock, one base frame, executions, goals, scaling.

Everything here can be computed again from the recordings, without the vendor files. Reading those is done in
`ingest`, finding places and executions in `segmentation`. What concerns one session is done session by session, on as
many cores as the engine has (`session_look`, `session_samples`, `session_end`), and large tables stay in files. Between
these passes is found what takes all sessions: places, executions, references of the speed, usual dwells, levels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.dataset.cards import note
from cyclekit.dataset.signals import switches
from cyclekit.dataset.time_grid import stretches
from cyclekit.derive.causes import NOTHING, Evidence, find_evidence
from cyclekit.derive.operator_tasks import operator_tasks
from cyclekit.derive.sample_file import in_order, shared_files
from cyclekit.derive.seen_slow import Switches, joined, rows_of
from cyclekit.derive.session_end import Finished, Left, finish
from cyclekit.derive.session_look import Look, look_at
from cyclekit.derive.session_samples import Made, SessionToSample, samples_of
from cyclekit.derive.session_signals import looked_for, mixed, some_executions
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.people.activity import operator_places
from cyclekit.people.silence import absences
from cyclekit.scaling.levels import Staircase, find_staircase
from cyclekit.scaling.of_runs import with_scaling
from cyclekit.scaling.response import MOST, SafetyResponse, read_response
from cyclekit.segmentation.arrivals import Stands, stands_of
from cyclekit.segmentation.dwell import Dwell, usual_dwells
from cyclekit.segmentation.executions import Execution, find_executions, find_visits
from cyclekit.segmentation.places import find_places, with_turns
from cyclekit.segmentation.waits import with_waits
from cyclekit.storage.parquet import forget, keeping

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.cards import ExecutionCard, Note, OperatorSignalCard, RecordingCard
    from cyclekit.dataset.dataset import Place
    from cyclekit.dataset.sessions import LogGroup, Session
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.schema import Floats, Progress
    from cyclekit.segmentation.standstills import Stop
    from cyclekit.segmentation.stored_run import Run
    from cyclekit.segmentation.time_account import Leg


__all__ = ["Derived", "derive"]

Item = TypeVar("Item")
Result = TypeVar("Result")

KEPT_BYTES = 160 << 20
"""Of decoded rows while the scaling is inferred: the fastest repetitions of each motion lie all over the log."""
SHARED_ROWS = 2_000_000
"""Of the robot, below which a pass takes less time than workers need to start."""
SESSION_ROWS = 1000
"""What a session costs besides its rows, in rows."""


@dataclass(frozen=True)
class Derived:
    """All that a dataset says beyond the samples, which lie in files; `samples`: how many.

    `tasks_to_next`: `tasks` with those of the operator from the end of each execution to the start of the next one.
    """

    recordings: list[RecordingCard]
    samples: int
    tasks: pl.DataFrame
    tasks_to_next: pl.DataFrame
    executions: list[ExecutionCard]
    places: Mapping[str, Place]
    human_places: Mapping[str, Place]
    levels: tuple[float, ...]
    origin: str | None
    dynamics: SafetyResponse
    operator_signals: tuple[OperatorSignalCard, ...]
    warnings: list[Note]


def derive(
    groups: Sequence[LogGroup],
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
    cell: Cell,
    folder: Path,
    progress: Progress,
    *,
    engine: Engine = LOCAL,
    coarse: bool = False,
) -> Derived:
    """Compute samples and tasks.

    Args:
        groups: The logs of each session.
        sources: What the cell file says about each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
        cell: Places, execution rule, rates.
        folder: Where the samples are written, a file a session.
        progress: Told fraction and text.
        engine: Who does the passes over the sessions; `read` and `stored` must work there.
        coarse: Where nothing says how a clock relates to the robot's, align on the operator being near while the
            robot slows; hides the reaction delay.

    Raises:
        UnknownName: The cell file's home is no place that was found.
        ConfigError: Executions are to begin by a register or output that was not logged, or a clock or frame is to be
            found in a way that these logs do not allow.
        EstimateError: An execution cannot be so long.
    """
    folder.mkdir(parents=True, exist_ok=True)
    passes = _Passes(engine if _is_much(groups) else LOCAL, progress)
    look = partial(look_at, sources=sources, read=read, stored=stored, cell=cell, coarse=coarse)
    looks = passes.over(look, groups, 0.0, 0.2, "motion")
    sessions = _numbered(looks)
    robot = _robot(looks, sessions, cell, passes.engine, lambda done, told: progress(0.2 + 0.3 * done, told))
    works, dwells = _with_stands(passes, sessions, robot)
    sample = partial(
        samples_of, places=robot.places, dwells=dwells, sources=sources, read=read, cell=cell, folder=folder
    )
    files = shared_files(sessions, cell.rate_hz)
    made = passes.over_files(sample, works, files, 0.6, 0.85, "samples")
    if _is_much(groups) or any(run.is_inferred for run in robot.runs):
        forget()  # samples and scaling of many hours take that memory
    runs = {work.session.name: list(work.runs.values()) for work in works}
    return _finished(passes, made, files, runs, robot, cell, folder, read, stored)


def _finished(
    passes: _Passes,
    made: Sequence[Made],
    files: Sequence[Sequence[int]],
    runs: Mapping[str, list[Run]],
    robot: _Robot,
    cell: Cell,
    folder: Path,
    read: Read,
    stored: Stored,
) -> Derived:
    """Find the levels and the operator's places, and have the samples completed."""
    some = [one for one in made if one.samples]
    spots = operator_places([stays for one in some for stays in one.stays], cell)
    staircase = _staircase(made, files, cell, folder)
    labels = np.split(staircase.label, np.cumsum([one.samples for one in made])[:-1]) if made else []
    levels = tuple(round(float(level), 6) for level in staircase.levels)
    gone = absences([one.silences for one in made])
    watched = looked_for(made, runs, cell, levels, folder, read, stored)
    left = [
        Left(
            one.part, runs[one.session], label, one.stays, absence, switch or _switches(one, read), _times_of(one.legs)
        )
        for one, label, absence, switch in zip(made, labels, gone, watched.switches, strict=True)
    ]
    evidence = _evidence(left, made, files, levels, folder, watched.names)
    most = max(20, MOST // max(len(some), 1))
    rest = partial(
        finish,
        spots=spots,
        levels=levels,
        evidence=evidence,
        signals=watched.names,
        most_changes=most,
        folder=folder,
    )
    finished = passes.over_files(rest, left, files, 0.85, 1.0, "levels")
    return Derived(
        recordings=[recording for one in made for recording in one.recordings],
        samples=sum(one.samples for one in some),
        tasks=_tasks(made, [one.lost_s for one in finished], spots),
        tasks_to_next=_tasks(made, [one.lost_s for one in finished], spots, to_next=True),
        executions=[card for one in made for card in one.cards],
        places=robot.places,
        human_places=spots,
        levels=levels,
        origin=" and ".join(sorted({name for one in some for name in one.origins}, reverse=True)) or None,
        dynamics=watched.response(read_response([one.changes for one in finished])),
        operator_signals=watched.found.cards,
        warnings=[
            *robot.warnings,
            *(staircase.warnings if some or not made else []),
            *_inputs(evidence),
            *_signals(watched.found.cards),
            *mixed(made, watched),
            *_unseen(finished),
        ],
    )


def _tasks(
    made: Sequence[Made], lost: Sequence[Floats], spots: Mapping[str, Place], *, to_next: bool = False
) -> pl.DataFrame:
    """Return table TASKS of both agents, with the seconds that each cause of a speed scaling below 1 took.

    Samples tell the shares, and the account of time, at the log's own rate, how much there is to be shared.
    """
    columns = {name: column.dtype for name, column in schema.TASKS.items()}
    rows = [row for one in made for row in (*one.tasks, *_of_operator(one, spots, to_next=to_next))]
    tasks = pl.DataFrame(rows, schema=columns, orient="row")
    mine = np.flatnonzero(tasks["start_place"].is_not_null().to_numpy())
    parts = np.concatenate([*lost, np.empty((0, len(schema.SCALING_CAUSES)))])
    total = parts.sum(axis=1, keepdims=True)
    parts = np.divide(parts, total, out=np.zeros_like(parts), where=total > 0.0)
    parts[total[:, 0] <= 0.0, -1] = 1.0
    seconds = np.full((tasks.height, parts.shape[1]), np.nan)
    seconds[mine] = parts * tasks["safety_loss_s"].fill_null(np.nan).to_numpy()[mine, None]
    named = zip(schema.SCALING_CAUSES, seconds.T, strict=True)
    return tasks.with_columns(pl.Series(f"lost_{cause}_s", column, nan_to_null=True) for cause, column in named)


def _of_operator(made: Made, spots: Mapping[str, Place], *, to_next: bool) -> list[tuple[object, ...]]:
    if not to_next:
        return operator_tasks(made.cards, made.stays, spots)
    return operator_tasks(made.cards, [s for s, _ in made.later], spots, [until_s for _, until_s in made.later])


def _inputs(evidence: Evidence) -> list[Note]:
    """Say which inputs slow the robot."""
    return [
        note("input-slows", signal=name, state="on" if how.on else "off", percent=round(100 * how.cap))
        for name, how in evidence.inputs.items()
    ]


def _signals(cards: Sequence[OperatorSignalCard]) -> list[Note]:
    """Say which signals were found to tell of people."""
    return [
        note(
            "operator-signal",
            signal=one.signal,
            occupied=one.occupied,
            delay_s=one.delay_s,
            explained=one.explained,
        )
        for one in cards
        if not one.told
    ]


def _unseen(finished: Sequence[Finished]) -> list[Note]:
    """Say how often a signal shows somebody whom the tracker does not."""
    samples, sessions = sum(one.unseen for one in finished), sum(one.unseen > 0 for one in finished)
    return [note("operator-unseen", samples=samples, sessions=sessions)] if samples else []


def _times_of(legs: Sequence[Leg]) -> Floats:
    never = (np.inf, -np.inf)
    times = [
        (leg.start_s, leg.arrival_s, leg.arrival_s + leg.dwell_s, leg.end_s)
        + (never if leg.reached_s is None or leg.went_on_s is None else (leg.reached_s, leg.went_on_s))
        for leg in legs
    ]
    return np.array(times).reshape(-1, 6)


def _switches(made: Made, read: Read) -> dict[str, Switches]:
    """Return the signals of two states of a session, session time."""
    return {
        name: Switches(times * entry.clock.rate + entry.clock.offset_s, on)
        for entry in made.recordings
        for name, (times, on) in switches(entry, read).items()
    }


def _evidence(
    left: Sequence[Left],
    made: Sequence[Made],
    files: Sequence[Sequence[int]],
    levels: Sequence[float],
    folder: Path,
    people: Sequence[str],
) -> Evidence:
    """Return what tells the causes of lost time, from every k-th execution of long logs."""
    chosen = some_executions(made)
    found = []
    for numbers in files:
        if not any(made[number].samples for number in numbers):
            continue
        file = folder / f"{made[numbers[0]].part}.parquet"
        rows = pl.scan_parquet(file, glob=False).with_row_index("row").filter(pl.col("execution").is_in(chosen))
        samples = rows.collect(engine="streaming")
        label = pl.Series(np.concatenate([left[number].label for number in numbers]))
        samples = samples.with_columns(step=label[samples["row"]])
        ends = np.cumsum([made[number].samples for number in numbers])
        which = np.searchsorted(ends, samples["row"].to_numpy(), side="right")
        found += [
            rows_of(samples.filter(pl.Series(which == i)), left[number].switches)
            for i, number in enumerate(numbers)
            if (which == i).any()
        ]
    return find_evidence(joined(found), levels, people) if found else NOTHING


def _numbered(looks: Sequence[Look]) -> list[Session]:
    """Return the sessions with the numbers of their runs in the list of all runs."""
    sessions: list[Session] = []
    count = 0
    for look in looks:
        sessions.append(replace(look.session, runs=tuple(range(count, count + len(look.runs)))))
        count += len(look.runs)
    return sessions


class _Robot(NamedTuple):
    """What the robot of all sessions was doing.

    Attributes:
        runs: All its runs; a session knows the numbers of its own.
        places: All its places.
        executions: Of each run, in the order of time.
        warnings: What is to be said about the scaling.
    """

    runs: Sequence[Run]
    places: Mapping[str, Place]
    executions: Sequence[Sequence[Execution]]
    warnings: list[Note]


def _robot(
    looks: Sequence[Look], sessions: Sequence[Session], cell: Cell, engine: Engine, progress: Progress
) -> _Robot:
    """Find places and executions in all sessions, and the scaling where it was not logged."""
    runs: list[Run] = []
    stops: list[Stop] = []
    for look in looks:
        stops += [replace(stop, run=stop.run + len(runs)) for stop in look.stops]
        runs += look.runs
    places = find_places(runs, stops, cell.places, all_named=cell.all_places_named)
    visits = find_visits(stops, places, runs)
    if all(len({visit.place for visit in seen}) < 2 for seen in visits):  # it rests at one place at most
        stops = with_turns(runs, stops)
        places = find_places(runs, stops, cell.places, all_named=cell.all_places_named)
        visits = find_visits(stops, places, runs)
    executions = find_executions(visits, places, cell.executions, [marks for look in looks for marks in look.marks])
    executions = with_waits(executions, stops, runs) + _whole_runs(runs, executions)
    with keeping(KEPT_BYTES):
        runs, warnings = with_scaling(runs, executions, places, sessions, progress, engine)
    by_run: list[list[Execution]] = [[] for _ in runs]
    for found in sorted(executions, key=lambda found: found.visits[0].first if found.visits else 0):
        by_run[found.run].append(found)
    return _Robot(runs, places, by_run, warnings)


def _whole_runs(runs: Sequence[Run], executions: Sequence[Execution]) -> list[Execution]:
    """A run in which no task was found is still an execution: it can be inspected and replayed."""
    covered = {execution.run for execution in executions}
    return [Execution(number, (), False) for number in range(len(runs)) if number not in covered]


def _with_stands(
    passes: _Passes, sessions: Sequence[Session], robot: _Robot
) -> tuple[list[SessionToSample], dict[str, Dwell]]:
    """Return the work that each session is, and the usual dwell at each place."""
    works = [
        SessionToSample(
            session,
            {number: robot.runs[number] for number in session.runs},
            [found for number in session.runs for found in robot.executions[number]],
            {},
        )
        for session in sessions
    ]
    stands = passes.over(partial(_stands, places=robot.places), works, 0.5, 0.6, "stands")
    every = {key: stand for mine in stands for key, stand in mine.items()}
    dwells = usual_dwells([found for mine in robot.executions for found in mine], every)
    return [replace(work, stands=mine) for work, mine in zip(works, stands, strict=True)], dwells


def _stands(work: SessionToSample, *, places: Mapping[str, Place]) -> Stands:
    return stands_of(work.runs, work.executions, places)


def _staircase(made: Sequence[Made], files: Sequence[Sequence[int]], cell: Cell, folder: Path) -> Staircase:
    """Find the levels of the scaling of all executions, or label them by those that the cell file fixes."""
    if not any(one.samples for one in made):
        return find_staircase(np.empty(0))
    frame = pl.concat(in_order((numbers, _scaling_of([made[n] for n in numbers], folder)) for numbers in files))
    run = stretches(frame, cell.rate_hz)
    scaling = frame["scaling"].fill_null(np.nan).to_numpy()
    return find_staircase(scaling, run=run, levels=cell.levels or None, rate_hz=cell.rate_hz)


def _scaling_of(made: Sequence[Made], folder: Path) -> list[pl.DataFrame]:
    """Return execution, time and scaling of the samples of each session in a file."""
    columns = ["execution", "t_s", "scaling"]
    counts = [one.samples for one in made]
    if not sum(counts):
        return [schema.empty(schema.SAMPLES).select(columns)] * len(made)
    frame = pl.read_parquet(folder / f"{made[0].part}.parquet", columns=columns, glob=False)
    begins = np.cumsum([0, *counts]).tolist()
    return [frame[begin : begin + count] for begin, count in zip(begins, counts, strict=False)]


def _is_much(groups: Sequence[LogGroup]) -> bool:
    """Tell whether a pass over the sessions takes longer than workers need to start."""
    rows = sum(log.rows.get("robot", 0) for group in groups for log in group.logs)
    return rows + SESSION_ROWS * len(groups) >= SHARED_ROWS


class _Passes:
    """Runs functions over all sessions on the engine: results in order, progress reported."""

    def __init__(self, engine: Engine, progress: Progress) -> None:
        self.engine, self.progress = engine, progress

    def over(
        self, function: Callable[[Item], Result], items: Sequence[Item], begin: float, end: float, what: str
    ) -> list[Result]:
        files = [[number] for number in range(len(items))]
        return self.over_files(partial(_one, function), items, files, begin, end, what)

    def over_files(
        self,
        function: Callable[[Sequence[Item]], Sequence[Result]],
        items: Sequence[Item],
        files: Sequence[Sequence[int]],
        begin: float,
        end: float,
        what: str,
    ) -> list[Result]:
        """Do a function for the items, those of each file together."""
        found, count = [], 0
        for done in self.engine.map(function, [[items[number] for number in numbers] for numbers in files]):
            found.append((files[done.number], done.get()))
            count += len(files[done.number])
            told = f"{what}, {count} of {len(items)} sessions"
            self.progress(begin + (end - begin) * count / len(items), told)
        return in_order(found)


def _one(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [function(item) for item in items]
