"""Derive samples and tasks from recordings: one clock, one base frame, executions, goals, scaling.

All of it can be computed again from the recordings, without the vendor files. Three passes go session by session, on
all cores of the engine (`first_pass`, `second_pass`, `last_pass`); large tables stay in files. Between the passes, all
sessions together give places, executions, speed references, usual dwells and levels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.dataset.signals import switches
from cyclekit.dataset.time_grid import stretches
from cyclekit.derive.causes.cause_samples import TwoStateSignal, joined, rows_of
from cyclekit.derive.causes.causes import NOTHING, Evidence, find_evidence
from cyclekit.derive.causes.stops_at_places import StopAtPlace, stops_at_places
from cyclekit.derive.first_pass import first_pass
from cyclekit.derive.found_slider import sliders_of, without_slider_loss
from cyclekit.derive.interruptions import interruption_notes, with_interruptions
from cyclekit.derive.last_pass import LastPassInput, last_pass
from cyclekit.derive.notes import empty_tracker_notes, input_notes, signal_notes, unseen_notes
from cyclekit.derive.operator_tasks import operator_tasks
from cyclekit.derive.over_sessions import Passes, is_much
from cyclekit.derive.reaction_time import reaction_time
from cyclekit.derive.robot import numbered, robot_of, with_standstills
from cyclekit.derive.robot_clocks import with_clocks_tested
from cyclekit.derive.sample_file import in_order, shared_files
from cyclekit.derive.second_pass import SecondPassResult, second_pass
from cyclekit.derive.set_override.moved import with_moved_overrides
from cyclekit.derive.signals.session_signals import (
    find_presence_signals,
    is_tracked,
    mixed_sources,
    restart_notes,
    some_executions,
)
from cyclekit.derive.tracker_frame import frame_notes
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.people.activity import operator_places
from cyclekit.people.hesitations import quick_places
from cyclekit.people.silence import absences
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
    from cyclekit.derive.robot import RobotInSessions
    from cyclekit.derive.second_pass import SessionToSample
    from cyclekit.derive.signals.session_signals import PresenceSignals
    from cyclekit.derive.stage_progress import StageProgress
    from cyclekit.people.silence import Absence
    from cyclekit.schema import Floats
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
    work: StageProgress,
    *,
    engine: Engine = LOCAL,
    by_logs: bool = False,
) -> Derived:
    """Compute samples and tasks.

    Args:
        groups: The logs of each session.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns) for reading by row ranges.
        cell: Places, execution rule, rates.
        folder: Folder for the files of samples.
        work: Told how far it is.
        engine: Runs the passes over the sessions; `read` and `stored` must work in its workers.
        by_logs: Align clocks by the logs also where that is not certain, and against what is stated.

    Raises:
        UnknownName: The home of the cell file is not among the places found.
        ConfigError: Executions begin by a register or output that was not logged, or the logs do not allow the given
            way to find a clock or frame.
        EstimateError: An execution is longer than plausible.
    """
    folder.mkdir(parents=True, exist_ok=True)
    passes = Passes(engine if is_much(groups) else LOCAL, work)
    first = partial(first_pass, sources=sources, read=read, stored=stored, cell=cell)
    work.begun(groups)
    first_results = passes.over(first, groups, "motion")
    work.found(groups, first_results)
    sessions = numbered(first_results)
    moved = partial(with_moved_overrides, sources=sources, read=read, stored=stored, cell=cell, by_logs=by_logs)
    first_results, told = moved(passes, first_results, sessions)
    robot = robot_of(first_results, sessions, cell, passes.engine, partial(work.at, "speed"))
    robot = robot._replace(warnings=[*told, *robot.warnings])
    sessions = with_clocks_tested(passes, sessions, robot.runs, sources, read, stored, asked=by_logs)
    to_sample, dwells = with_standstills(passes, sessions, robot)
    sample = partial(second_pass, places=robot.places, sources=sources, read=read, cell=cell, folder=folder)
    files = shared_files(sessions, cell.rate_hz)
    sampled = passes.over_files(partial(sample, dwells=dwells), to_sample, files, "samples")
    if is_much(groups) or any(run.is_inferred for run in robot.runs):
        forget()  # free the memory for samples and scaling of many hours
    found = _find_in_all_sessions(sampled, files, to_sample, cell, folder, read, stored)
    if stops := _stops(to_sample, sampled, files, dwells, found, folder):
        robot = robot.with_stops(stops, {key: one for work in to_sample for key, one in work.standstills.items()})
        to_sample, dwells = with_standstills(passes, sessions, robot)
        sampled = passes.over_files(partial(sample, dwells=dwells), to_sample, files, "samples", "samples again")
        found = _find_in_all_sessions(sampled, files, to_sample, cell, folder, read, stored, found.evidence)
    return _derived(passes, sampled, files, found, robot, cell, folder, sources, read)


class _FoundInAllSessions(NamedTuple):
    """Results of all sessions together: levels, signals of people, what is left to do, and causes of lost time."""

    human_places: Mapping[str, Place]
    staircase: Staircase
    sliders: Mapping[str, float]
    levels: tuple[float, ...]
    operator_absence: list[Absence]
    presence: PresenceSignals
    last_inputs: list[LastPassInput]
    evidence: Evidence


def _find_in_all_sessions(
    sampled: Sequence[SecondPassResult],
    files: Sequence[Sequence[int]],
    to_sample: Sequence[SessionToSample],
    cell: Cell,
    folder: Path,
    read: Read,
    stored: Stored,
    evidence: Evidence | None = None,
) -> _FoundInAllSessions:
    """Find the levels, the operator's places and, unless given, the evidence for causes of lost time."""
    runs = {work.session.name: list(work.runs.values()) for work in to_sample}
    human_places = operator_places([mine for one in sampled if one.samples for mine in one.operator_standstills], cell)
    quick = quick_places((mine for one in sampled for mine, _ in one.standstills_to_next), human_places)
    for one in sampled:
        one.drop_hesitations(human_places, quick)
    staircase, sliders = _staircase(sampled, files, cell, folder)
    labels = np.split(staircase.label, np.cumsum([one.samples for one in sampled])[:-1]) if sampled else []
    levels = tuple(round(float(level), 6) for level in staircase.levels)
    operator_absence = absences([one.silences for one in sampled])
    presence = find_presence_signals(sampled, runs, cell, levels, folder, read, stored)
    last_inputs = [
        LastPassInput(
            one.part,
            runs[one.session],
            label,
            one.operator_standstills,
            absence,
            switch or _two_state_signals(one, read),
            _task_times(one.executed_tasks),
        )
        for one, label, absence, switch in zip(sampled, labels, operator_absence, presence.switches, strict=True)
    ]
    evidence = evidence or _evidence(last_inputs, sampled, files, levels, folder, presence.names)
    return _FoundInAllSessions(
        human_places, staircase, sliders, levels, operator_absence, presence, last_inputs, evidence
    )


def _stops(
    to_sample: Sequence[SessionToSample],
    sampled: Sequence[SecondPassResult],
    files: Sequence[Sequence[int]],
    dwells: Mapping[str, Dwell],
    found: _FoundInAllSessions,
    folder: Path,
) -> list[StopAtPlace]:
    """Return when robots of inferred scaling were halted at places, as far as people tell."""
    if found.evidence.usual is None or not any(run.is_inferred for work in to_sample for run in work.runs.values()):
        return []
    samples = (one for numbers in files for one in _samples_of(numbers, sampled, folder))
    sessions = ((to_sample[number], rows_of(some, found.last_inputs[number].switches)) for number, some in samples)
    return stops_at_places(sessions, dwells, found.evidence)


def _samples_of(
    numbers: Sequence[int], sampled: Sequence[SecondPassResult], folder: Path
) -> Iterator[tuple[int, pl.DataFrame]]:
    """Yield the samples of each session in a file, with its number."""
    if any(sampled[number].samples for number in numbers):
        frame = pl.read_parquet(folder / f"{sampled[numbers[0]].part}.parquet", glob=False)
        begin = 0
        for number in numbers:
            count = sampled[number].samples
            if count:
                yield number, frame[begin : begin + count].with_columns(step=pl.lit(None, pl.Int32))
            begin += count


def _derived(
    passes: Passes,
    sampled: Sequence[SecondPassResult],
    files: Sequence[Sequence[int]],
    found: _FoundInAllSessions,
    robot: RobotInSessions,
    cell: Cell,
    folder: Path,
    sources: Mapping[str, Source | None],
    read: Read,
) -> Derived:
    """Complete the samples."""
    some = [one for one in sampled if one.samples]
    human_places, staircase, sliders, levels, operator_absence, presence, last_inputs, evidence = found
    most_changes = max(20, MAX_CHANGES // max(len(some), 1))
    rest = partial(
        last_pass,
        human_places=human_places,
        levels=levels,
        evidence=evidence,
        signals=presence.names,
        most_changes=most_changes,
        folder=folder,
    )
    finished = passes.over_files(rest, last_inputs, files, "levels")
    response = presence.response(read_response([one.changes for one in finished]))
    if response.latency_s is None and response.changes and any(map(is_tracked, some)):
        response = replace(response, latency_s=reaction_time(some, levels, response, folder))
    tasks = partial(_tasks, sampled, [one.lost_s for one in finished], human_places)
    robot_tasks = tasks()
    cards = with_interruptions([card for one in sampled for card in one.cards], robot_tasks)
    return Derived(
        recordings=[recording for one in sampled for recording in one.recordings],
        samples=sum(one.samples for one in some),
        tasks=without_slider_loss(robot_tasks, sliders),
        tasks_to_next=without_slider_loss(tasks(to_next=True), sliders),
        executions=cards,
        places=robot.places,
        human_places=human_places,
        levels=levels,
        origin=" and ".join(sorted({name for one in some for name in one.origins}, reverse=True)) or None,
        dynamics=response,
        operator_signals=presence.found.cards,
        warnings=[
            *robot.warnings,
            *(staircase.warnings if some or not sampled else []),
            *interruption_notes(cards),
            *input_notes(evidence),
            *signal_notes(presence.found),
            *restart_notes(presence),
            *mixed_sources(sampled, presence),
            *empty_tracker_notes(sampled, operator_absence),
            *unseen_notes(finished),
            *frame_notes(sampled, [one.changes for one in finished], levels, folder, sources, read, cell),
        ],
    )


def _tasks(
    sampled: Sequence[SecondPassResult],
    lost: Sequence[Floats],
    human_places: Mapping[str, Place],
    *,
    to_next: bool = False,
) -> pl.DataFrame:
    """Return table TASKS of both agents, with the seconds lost to each cause of a speed scaling below 1.

    The shares of the causes come from the samples; the total comes from the time account, at the log's rate.
    """
    columns = {name: column.dtype for name, column in schema.TASKS.items()}
    rows = [row for one in sampled for row in (*one.tasks, *_operator_rows(one, human_places, to_next=to_next))]
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


def _operator_rows(
    session: SecondPassResult, human_places: Mapping[str, Place], *, to_next: bool
) -> list[tuple[object, ...]]:
    if not to_next:
        return operator_tasks(session.cards, session.operator_standstills, human_places)
    return operator_tasks(
        session.cards,
        [s for s, _ in session.standstills_to_next],
        human_places,
        [until_s for _, until_s in session.standstills_to_next],
    )


def _task_times(executed_tasks: Sequence[ExecutedTask]) -> Floats:
    never = (np.inf, -np.inf)
    times = [
        (task.start_s, task.moves_until_s, task.moves_until_s + task.dwell_s, task.end_s)
        + (never if task.reached_s is None or task.went_on_s is None else (task.reached_s, task.went_on_s))
        for task in executed_tasks
    ]
    return np.array(times).reshape(-1, 6)


def _two_state_signals(session: SecondPassResult, read: Read) -> dict[str, TwoStateSignal]:
    """Return the two-state signals of a session, session time."""
    return {
        name: TwoStateSignal(times * entry.clock.rate + entry.clock.offset_s, on)
        for entry in session.recordings
        for name, (times, on) in switches(entry, read).items()
    }


def _evidence(
    last_inputs: Sequence[LastPassInput],
    sampled: Sequence[SecondPassResult],
    files: Sequence[Sequence[int]],
    levels: Sequence[float],
    folder: Path,
    people: Sequence[str],
) -> Evidence:
    """Return the evidence on causes of lost time; from long logs, of every k-th execution."""
    chosen = some_executions(sampled)
    found = []
    for numbers in files:
        if not any(sampled[number].samples for number in numbers):
            continue
        file = folder / f"{sampled[numbers[0]].part}.parquet"
        rows = pl.scan_parquet(file, glob=False).with_row_index("row").filter(pl.col("execution").is_in(chosen))
        samples = rows.collect(engine="streaming")
        label = pl.Series(np.concatenate([last_inputs[number].label for number in numbers]))
        samples = samples.with_columns(step=label[samples["row"]])
        ends = np.cumsum([sampled[number].samples for number in numbers])
        which = np.searchsorted(ends, samples["row"].to_numpy(), side="right")
        found += [
            rows_of(samples.filter(pl.Series(which == i)), last_inputs[number].switches)
            for i, number in enumerate(numbers)
            if (which == i).any()
        ]
    return find_evidence(joined(found), levels, people) if found else NOTHING


def _staircase(
    sampled: Sequence[SecondPassResult], files: Sequence[Sequence[int]], cell: Cell, folder: Path
) -> tuple[Staircase, dict[str, float]]:
    """Find the levels of the scaling in all executions, or use those that the cell file fixes; sliders of executions.

    A slider that the log holds is not part of the scaling.
    """
    if not any(one.samples for one in sampled):
        return find_staircase(np.empty(0)), {}
    frame = pl.concat(in_order((numbers, _scaling_of([sampled[n] for n in numbers], folder)) for numbers in files))
    run = stretches(frame, cell.rate_hz)
    scaling = frame["scaling"].fill_null(np.nan).to_numpy()
    found = find_staircase(scaling, run=run, levels=cell.levels or None, rate_hz=cell.rate_hz)
    return found, sliders_of(frame["execution"].to_list(), found.slider)


def _scaling_of(sampled: Sequence[SecondPassResult], folder: Path) -> list[pl.DataFrame]:
    """Return execution, time and scaling of the samples of each session in a file."""
    columns = ["execution", "t_s", "scaling"]
    counts = [one.samples for one in sampled]
    if not sum(counts):
        return [schema.empty(schema.SAMPLES).select(columns)] * len(sampled)
    frame = pl.read_parquet(folder / f"{sampled[0].part}.parquet", columns=columns, glob=False)
    begins = np.cumsum([0, *counts]).tolist()
    return [frame[begin : begin + count] for begin, count in zip(begins, counts, strict=False)]
