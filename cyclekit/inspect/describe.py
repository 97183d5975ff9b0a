"""Collect facts about a log, a dataset or a model, to check before relying on results.

Rates, durations, gaps, shares of known values and rows set aside, counted in the tables, without judgement or repair.
The command line formats them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.adapter import Recording
from cyclekit.dataset import lost_time
from cyclekit.dataset.cards import plain, texts
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import LogError
from cyclekit.estimate.robot.work_dwells import of_kinds, said_of_places, standstills_by_work
from cyclekit.ingest.discover import cell_for, find_all, options_of
from cyclekit.ingest.read.tool_point import with_tool_point
from cyclekit.ingest.registry import adapter_named
from cyclekit.ingest.validate.validate import examined_parts
from cyclekit.inspect.facts import (
    DatasetDescription,
    Description,
    Gap,
    LogFacts,
    LogsDescription,
    ModelDescription,
    TaskTimesDescription,
)
from cyclekit.inspect.lists import SafetySurvey, task_list_facts
from cyclekit.inspect.response import response_facts
from cyclekit.inspect.survey import TableSurvey
from cyclekit.learning.coupling.learn import learn_coupling
from cyclekit.learning.networks.saved import CARD as MODEL_CARD
from cyclekit.learning.networks.saved import load_model
from cyclekit.learning.task_times.saved import holds_task_times, load_task_times
from cyclekit.learning.unseen.saved import holds_unseen, load_unseen
from cyclekit.storage.atomic import recover

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import ClockCard, OperatorCard, RecordingCard
    from cyclekit.ingest.discover import Log
    from cyclekit.inspect.facts import SafetyFacts, TaskListFacts
    from cyclekit.schema import Progress

_OF_SAMPLES = (*lost_time.COLUMNS, "scaling_sd", "scaling_gap", "scaling_origin")


def describe(
    path: Path, *, cell: Path | None = None, progress: Progress | None = None, follow_links: bool = False
) -> Description:
    """Return the description of `path`: logs, a dataset or a model, distinguished by content.

    The arguments are described at `cyclekit.inspect_logs`.

    Raises:
        LogError: There is nothing there, or nothing that can be read.
        ConfigError: The cell file is invalid.
        DatasetError: The dataset has another schema version.
        ModelError: The model has another schema version, or is damaged.
    """
    recover(path)
    if not path.exists():
        raise LogError(path, "no such file or folder", cure="Check the path.")
    if (path / CARD).is_file():
        return _describe_dataset(Dataset.open(path), progress)
    if holds_task_times(path):
        return TaskTimesDescription(path, load_task_times(path))
    if (path / MODEL_CARD).is_file():
        return _describe_model(path)
    return _describe_logs(path, cell, progress, follow_links=follow_links)


def _describe_model(path: Path) -> ModelDescription:
    if holds_unseen(path):
        unseen = load_unseen(path)
        count = np.array(unseen.unseen.shares).size
        return ModelDescription(path, unseen.problem, "unseen operator", 0.0, unseen.levels, count, unseen.card)
    model = load_model(path)
    count = model.weights.count
    return ModelDescription(path, model.problem, model.network, model.horizon_s, model.levels, count, model.card)


def _describe_logs(path: Path, cell: Path | None, progress: Progress | None, *, follow_links: bool) -> LogsDescription:
    found, passed_over = find_all([path], cell_for([path], cell), follow_links=follow_links)
    logs, not_read, failed = [], [(Path(name), reason) for name, reason in passed_over], None
    for done, log in enumerate(found):
        if progress:
            progress(done / len(found), log.shown)
        try:
            logs.append(_describe_log(log))
        except LogError as error:
            failed = error
            not_read.append((log.path, error.cause))
    if failed is not None and not logs:
        raise failed
    return LogsDescription(path, tuple(logs), tuple(not_read))


def _describe_log(log: Log) -> LogFacts:
    entry = adapter_named(log.adapter)
    surveys, set_aside, rows_read = dict[str, TableSurvey](), dict[str, int](), 0
    warnings: dict[str, None] = {}
    last, tasks, safety = Recording(), list[pl.DataFrame](), SafetySurvey()
    read = entry.parts(log.path, options_of(log.source), log.activities)
    for part in examined_parts(with_tool_point(read, log.robot)):
        last, rows_read = part, rows_read + part.rows_read
        for name, table in part.tables().items():
            surveys.setdefault(name, TableSurvey(rated=name not in schema.UNRATED)).add(table)
        tasks += [] if part.task_list is None else [part.task_list]
        if part.safety is not None:
            safety.add(part.safety)
        if part.set_aside is not None:
            for reason, count in part.set_aside.group_by("reason").len().iter_rows():
                set_aside[reason] = set_aside.get(reason, 0) + count
        warnings |= dict.fromkeys(part.said)
    levels, share = surveys["robot"].levels() if "robot" in surveys else ((), ())
    return LogFacts(
        path=log.path,
        adapter=entry.name,
        package=f"{entry.package} {entry.version}",
        clock=last.clock,
        rows_read=rows_read,
        tables={name: surveys[name].facts() for name in schema.MAIN if name in surveys},
        set_aside=dict(sorted(set_aside.items(), key=lambda item: (-item[1], item[0]))),
        levels=levels,
        level_share=share,
        warnings=tuple(warnings),
        facts=dict(last.facts),
        task_list=task_list_facts(pl.concat(tasks)) if tasks else None,
        safety=safety.facts() if last.safety is not None else None,
    )


def _describe_dataset(dataset: Dataset, progress: Progress | None) -> DatasetDescription:
    executions, samples = dataset.executions, dataset.samples(columns=_OF_SAMPLES)
    scaling = samples["scaling"].drop_nulls()
    levelled = samples["step"].drop_nulls()
    share = [float((levelled == index).sum()) / max(1, len(levelled)) for index in range(len(dataset.levels))]
    rows = max(1, samples.height)
    inferred = (samples["scaling_origin"] == "inferred").sum()
    deviation = samples.filter(pl.col("scaling_origin") == "inferred")["scaling_sd"].median()
    reasons = samples["scaling_gap"].drop_nulls().value_counts(sort=True, name="samples")
    moving = samples.filter("robot_moving")["scaling"]
    records, every = dataset.recordings, dataset.every_task()
    found, duration_s = every.filter(pl.col("start_place").is_not_null()), float(executions["duration_s"].sum())
    return DatasetDescription(
        path=dataset.path,
        schema_version=dataset.card.schema_version,
        recordings=len(records),
        sources=sum(len(record.sources) for record in records),
        set_aside=_set_aside(records),
        executions=executions.height,
        executions_complete=sum(one.complete for one in dataset.card.executions),
        duration_s=duration_s,
        samples=samples.height,
        rate_hz=dataset.rate_hz,
        places={
            name: {"xyz_m": p.xyz_m, "radius_m": p.radius_m, "inferred": p.inferred, "label": dataset.label(name)}
            for name, p in dataset.places.items()
        },
        human_places={
            name: {"xyz_m": p.xyz_m, "radius_m": p.radius_m, "inferred": p.inferred, "label": dataset.label(name)}
            for name, p in dataset.human_places.items()
        },
        tasks=tuple(_task_rows(found)),
        lost=lost_time.lost_time(found, samples, dataset.levels, dataset.rate_hz, duration_s),
        task_list=_listed(dataset, every),
        safety=_safety(dataset),
        positions=dataset.positions,
        coupling=learn_coupling(dataset),
        response=response_facts(dataset),
        levels=dataset.levels,
        level_share=tuple(share),
        on_level=len(levelled) / rows,
        scaling_known=len(scaling) / rows,
        scaling_inferred=float(inferred) / max(1, len(scaling)),
        operator_seen=samples["human_x_m"].count() / rows,
        gaps=_recording_gaps(dataset, progress),
        warnings=tuple(_warnings(dataset)),
        clocks={record.id: _without_warnings(record.clock) for record in records},
        operator={one.id: _counts(one.operator) for one in records if one.operator is not None},
        scaling_gaps=dict(reasons.iter_rows()),
        motion_covered=moving.count() / max(1, len(moving)),
        scaling_sd=deviation if isinstance(deviation, float) else None,
    )


def _listed(dataset: Dataset, tasks: pl.DataFrame) -> TaskListFacts | None:
    """Return the facts of the task lists in a dataset; None without any."""
    listed = tasks.drop_nulls("agent_name").rename({"start_s": "t_s"})
    if listed.is_empty():
        return None
    return task_list_facts(listed.join(dataset.executions.select("execution", "session"), on="execution", how="left"))


def _safety(dataset: Dataset) -> dict[str, SafetyFacts]:
    """Return the facts of each recording of a safety system's log."""
    found = {}
    for record in dataset.recordings:
        rows = dataset.recorded(record.id, "safety") if "safety" in record.tables else None
        if rows is not None:
            survey = SafetySurvey()
            survey.add(rows)
            found[record.id] = survey.facts()
    return found


def _set_aside(records: Sequence[RecordingCard]) -> dict[str, int]:
    total: dict[str, int] = {}
    for record in records:
        for part in record.rows_set_aside:
            total[part.reason] = total.get(part.reason, 0) + part.count
    return total


def _warnings(dataset: Dataset) -> list[str]:
    of_recordings = [f"{record.id}: {text}" for record in dataset.recordings for text in record.said]
    by_work = standstills_by_work(dataset)
    kinds = {task for task, stands in by_work.items() if of_kinds(stands)}
    of_work = [
        f"{said}; an estimate takes those of the order's own work"
        for said in said_of_places({task: stands for task, stands in by_work.items() if task not in kinds})
    ]
    of_work += [
        f"{said} (another product, or a wait): an estimate takes all of them together, or that with which its order "
        "was logged"
        for said in said_of_places({task: stands for task, stands in by_work.items() if task in kinds})
    ]
    return texts(dataset.card.warnings) + of_recordings + of_work


def _without_warnings(card: ClockCard) -> dict[str, object]:
    """Return a card as JSON values without its warnings, which are listed with all others."""
    return {name: value for name, value in plain(card).items() if name != "warnings"}


def _counts(card: OperatorCard) -> dict[str, int]:
    return {name: value for name, value in plain(card).items() if name != "warnings"}


def _task_rows(tasks: pl.DataFrame) -> list[dict[str, object]]:
    means = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
    grouped = tasks.group_by("task").agg(pl.len().alias("count"), *(pl.col(name).mean() for name in means))
    return grouped.sort("count", "task", descending=[True, False]).to_dicts()


def _recording_gaps(dataset: Dataset, progress: Progress | None) -> dict[str, tuple[Gap, ...]]:
    found, records = {}, dataset.recordings
    for done, record in enumerate(records):
        if progress:
            progress(done / len(records), record.id)
        for name in record.tables:
            if name not in ("robot", "people"):
                continue
            survey = TableSurvey()
            for part in dataset.times(record.id, name):
                survey.add(part)
            if gaps := survey.facts().gaps:
                found[f"{record.id}/{name}"] = gaps
    return found
