"""Derive samples and tasks from recordings: one clock, one base frame, executions, goals, scaling.

All of it can be computed again from the recordings, without the vendor files. `ingest` reads those files;
`segmentation` finds places and executions. Three passes go session by session, on all cores of the engine
(`session_look`, `session_samples`, `session_end`); large tables stay in files. Between the passes, all sessions
together give places, executions, speed references, usual dwells and levels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.dataset.cards import note
from cyclekit.dataset.signals import switches
from cyclekit.dataset.time_grid import stretches
from cyclekit.derive.causes import NOTHING, Evidence, find_evidence
from cyclekit.derive.halts import HaltAtPlace, stops_at_places
from cyclekit.derive.operator_tasks import operator_tasks
from cyclekit.derive.over_sessions import Passes, is_much
from cyclekit.derive.reaction_time import reaction_time
from cyclekit.derive.robot import numbered, robot_of, with_standstills
from cyclekit.derive.sample_file import in_order, shared_files
from cyclekit.derive.seen_slow import Switches, joined, rows_of
from cyclekit.derive.session_end import Finished, Left, finish
from cyclekit.derive.session_look import look_at
from cyclekit.derive.session_samples import Made, samples_of
from cyclekit.derive.session_signals import is_tracked, looked_for, mixed, some_executions
from cyclekit.derive.tracker_frame import frame_notes
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.people.activity import operator_places
from cyclekit.people.silence import absences, is_empty
from cyclekit.scaling.levels import Staircase, find_staircase
from cyclekit.scaling.response import MAX_CHANGES, SafetyResponse, read_response
from cyclekit.storage.parquet import forget

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.cards import ExecutionCard, Note, OperatorSignalCard, RecordingCard
    from cyclekit.dataset.dataset import Place
    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.derive.operator_signals import FoundSignals
    from cyclekit.derive.robot import RobotInSessions
    from cyclekit.derive.session_samples import SessionToSample
    from cyclekit.derive.session_signals import Watched
    from cyclekit.people.silence import Absence
    from cyclekit.schema import Floats, Progress
    from cyclekit.segmentation.dwell import Dwell
    from cyclekit.segmentation.time_account import ExecutedTask


@dataclass(frozen=True)
class Derived:
    """Everything derived except the samples, which are in files; `samples` is their number.

    `tasks_to_next`: `tasks`, with the operator's tasks extended from the end of each execution to the next start.
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
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns) for reading by row ranges.
        cell: Places, execution rule, rates.
        folder: Folder for the files of samples.
        progress: Called with fraction and text.
        engine: Runs the passes over the sessions; `read` and `stored` must work in its workers.
        coarse: If nothing else relates a clock to the robot's, align on the operator being near while the robot
            slows; this hides the reaction time.

    Raises:
        UnknownName: The home of the cell file is not among the places found.
        ConfigError: Executions begin by a register or output that was not logged, or the logs do not allow the given
            way to find a clock or frame.
        EstimateError: An execution is longer than plausible.
    """
    folder.mkdir(parents=True, exist_ok=True)
    passes = Passes(engine if is_much(groups) else LOCAL, progress)
    look = partial(look_at, sources=sources, read=read, stored=stored, cell=cell, coarse=coarse)
    looks = passes.over(look, groups, 0.0, 0.2, "motion")
    sessions = numbered(looks)
    robot = robot_of(looks, sessions, cell, passes.engine, lambda done, told: progress(0.2 + 0.3 * done, told))
    works, dwells = with_standstills(passes, sessions, robot)
    sample = partial(samples_of, places=robot.places, sources=sources, read=read, cell=cell, folder=folder)
    files = shared_files(sessions, cell.rate_hz)
    made = passes.over_files(partial(sample, dwells=dwells), works, files, 0.6, 0.85, "samples")
    if is_much(groups) or any(run.is_inferred for run in robot.runs):
        forget()  # free the memory for samples and scaling of many hours
    learnt = _learnt(made, files, works, cell, folder, read, stored)
    if halts := _halts(works, made, files, dwells, learnt, folder):
        robot = robot.halted(halts)
        works, dwells = with_standstills(passes, sessions, robot)
        made = passes.over_files(partial(sample, dwells=dwells), works, files, 0.6, 0.85, "samples again")
        learnt = _learnt(made, files, works, cell, folder, read, stored, learnt.evidence)
    return _finished(passes, made, files, learnt, robot, cell, folder, sources, read)


class _Learnt(NamedTuple):
    """What all sessions together tell: levels, signals of people, what is left to do, and causes of lost time."""

    spots: Mapping[str, Place]
    staircase: Staircase
    levels: tuple[float, ...]
    gone: list[Absence]
    watched: Watched
    left: list[Left]
    evidence: Evidence


def _learnt(
    made: Sequence[Made],
    files: Sequence[Sequence[int]],
    works: Sequence[SessionToSample],
    cell: Cell,
    folder: Path,
    read: Read,
    stored: Stored,
    evidence: Evidence | None = None,
) -> _Learnt:
    """Find the levels, the operator's places and, unless given, the evidence for causes of lost time."""
    runs = {work.session.name: list(work.runs.values()) for work in works}
    spots = operator_places([stays for one in made if one.samples for stays in one.stays], cell)
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
    evidence = evidence or _evidence(left, made, files, levels, folder, watched.names)
    return _Learnt(spots, staircase, levels, gone, watched, left, evidence)


def _halts(
    works: Sequence[SessionToSample],
    made: Sequence[Made],
    files: Sequence[Sequence[int]],
    dwells: Mapping[str, Dwell],
    learnt: _Learnt,
    folder: Path,
) -> list[HaltAtPlace]:
    """Return when robots of inferred scaling were halted at places, as far as people tell."""
    if learnt.evidence.usual is None or not any(run.is_inferred for work in works for run in work.runs.values()):
        return []
    samples = (found for numbers in files for found in _samples_of(numbers, made, folder))
    sessions = ((works[number], rows_of(some, learnt.left[number].switches)) for number, some in samples)
    return stops_at_places(sessions, dwells, learnt.evidence)


def _samples_of(numbers: Sequence[int], made: Sequence[Made], folder: Path) -> Iterator[tuple[int, pl.DataFrame]]:
    """Yield the samples of each session in a file, with its number."""
    if any(made[number].samples for number in numbers):
        frame = pl.read_parquet(folder / f"{made[numbers[0]].part}.parquet", glob=False)
        begin = 0
        for number in numbers:
            count = made[number].samples
            if count:
                yield number, frame[begin : begin + count].with_columns(step=pl.lit(None, pl.Int32))
            begin += count


def _finished(
    passes: Passes,
    made: Sequence[Made],
    files: Sequence[Sequence[int]],
    learnt: _Learnt,
    robot: RobotInSessions,
    cell: Cell,
    folder: Path,
    sources: Mapping[str, Source | None],
    read: Read,
) -> Derived:
    """Complete the samples."""
    some = [one for one in made if one.samples]
    spots, staircase, levels, gone, watched, left, evidence = learnt
    most = max(20, MAX_CHANGES // max(len(some), 1))
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
    response = watched.response(read_response([one.changes for one in finished]))
    if response.latency_s is None and response.changes and any(map(is_tracked, some)):
        response = replace(response, latency_s=reaction_time(some, levels, response, folder))
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
        dynamics=response,
        operator_signals=watched.found.cards,
        warnings=[
            *robot.warnings,
            *(staircase.warnings if some or not made else []),
            *_inputs(evidence),
            *_signals(watched.found),
            *mixed(made, watched),
            *_empty_trackers(made, gone),
            *_unseen(finished),
            *frame_notes(made, [one.changes for one in finished], levels, folder, sources, read, cell),
        ],
    )


def _tasks(
    made: Sequence[Made], lost: Sequence[Floats], spots: Mapping[str, Place], *, to_next: bool = False
) -> pl.DataFrame:
    """Return table TASKS of both agents, with the seconds lost to each cause of a speed scaling below 1.

    The shares of the causes come from the samples; the total comes from the time account, at the log's rate.
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


def _empty_trackers(made: Sequence[Made], gone: Sequence[Absence]) -> list[Note]:
    """Return a note: in how many sessions an empty tracker log means no operator, and in how many unknown."""
    empty = [absence for one, absence in zip(made, gone, strict=True) if one.silences and is_empty(one.silences)]
    absent = sum(absence.until_s == np.inf for absence in empty)
    return [note("tracker-empty", absent=absent, unknown=len(empty) - absent)] if empty else []


def _of_operator(made: Made, spots: Mapping[str, Place], *, to_next: bool) -> list[tuple[object, ...]]:
    if not to_next:
        return operator_tasks(made.cards, made.stays, spots)
    return operator_tasks(made.cards, [s for s, _ in made.later], spots, [until_s for _, until_s in made.later])


def _inputs(evidence: Evidence) -> list[Note]:
    """Return a note for each input that slows the robot."""
    return [
        note("input-slows", signal=name, state="on" if how.on else "off", percent=round(100 * how.cap))
        for name, how in evidence.inputs.items()
    ]


def _signals(found: FoundSignals) -> list[Note]:
    """Return notes: signals that were found to show people, or signals that follow the speed."""
    if found.follow:
        names, late_s = zip(*found.follow, strict=True)
        return [note("signals-follow", signals=", ".join(names), late_s=max(late_s))]
    return [
        note(
            "operator-signal",
            signal=one.signal,
            occupied=one.occupied,
            delay_s=one.delay_s,
            explained=one.explained,
        )
        for one in found.cards
        if not one.told
    ]


def _unseen(finished: Sequence[Finished]) -> list[Note]:
    """Return a note: how often a signal shows a person whom the tracker misses."""
    samples, sessions = sum(one.unseen for one in finished), sum(one.unseen > 0 for one in finished)
    return [note("operator-unseen", samples=samples, sessions=sessions)] if samples else []


def _times_of(legs: Sequence[ExecutedTask]) -> Floats:
    never = (np.inf, -np.inf)
    times = [
        (leg.start_s, leg.arrival_s, leg.arrival_s + leg.dwell_s, leg.end_s)
        + (never if leg.reached_s is None or leg.went_on_s is None else (leg.reached_s, leg.went_on_s))
        for leg in legs
    ]
    return np.array(times).reshape(-1, 6)


def _switches(made: Made, read: Read) -> dict[str, Switches]:
    """Return the two-state signals of a session, session time."""
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
    """Return the evidence on causes of lost time; from long logs, of every k-th execution."""
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


def _staircase(made: Sequence[Made], files: Sequence[Sequence[int]], cell: Cell, folder: Path) -> Staircase:
    """Find the levels of the scaling in all executions, or use those that the cell file fixes."""
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
