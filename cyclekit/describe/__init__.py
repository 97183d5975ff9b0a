"""What a log, a dataset or a model is, as facts a person checks before trusting an answer.

Rates, durations, gaps, what is known and what was set aside, counted out of the tables. Nothing is judged and nothing
is mended here; how the facts look on a screen is the command line's business.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from cyclekit.atomic import recover
from cyclekit.dataset import CARD, Dataset
from cyclekit.describe.facts import (
    DatasetDescription,
    Description,
    Gap,
    LogFacts,
    LogsDescription,
    ModelDescription,
    TableFacts,
)
from cyclekit.discover import cell_for, find_all, options_of
from cyclekit.errors import LogError
from cyclekit.models.saved import CARD as MODEL_CARD
from cyclekit.models.saved import load_model
from cyclekit.plausible import examined
from cyclekit.registry import adapter_named
from cyclekit.steps import find_staircase

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclekit.adapter import ReadOptions
    from cyclekit.registry import Registered

    Progress = Callable[[float, str], None]

__all__ = [
    "DatasetDescription",
    "Description",
    "Gap",
    "LogFacts",
    "LogsDescription",
    "ModelDescription",
    "TableFacts",
    "describe",
]

GAP_PERIODS, GAP_S = 5.0, 0.25
"""A silence is a gap when it is longer than both: five usual periods, and a quarter of a second."""


def describe(path: Path, *, progress: Progress | None = None) -> Description:
    """Return what is at `path`: logs, a dataset or a model, told apart by content.

    Args:
        path: A file or a folder.
        progress: Called with the fraction done and what is being looked at.

    Raises:
        LogError: There is nothing there, or nothing that can be read.
        DatasetError: The dataset is of another schema version.
        ModelError: The model is of another schema version, or damaged.
    """
    recover(path)
    if not path.exists():
        raise LogError(path, "no such file or folder", cure="Check the path.")
    if (path / CARD).is_file():
        return _describe_dataset(Dataset.open(path), progress)
    if (path / MODEL_CARD).is_file():
        return _describe_model(path)
    return _describe_logs(path, progress)


def _describe_model(path: Path) -> ModelDescription:
    model = load_model(path)
    count = sum(weight.size + bias.size for weight, bias in model.layers)
    return ModelDescription(path, model.problem, model.network, model.horizon_s, model.levels, count, model.card)


def _describe_logs(path: Path, progress: Progress | None) -> LogsDescription:
    found, passed_over = find_all([path], cell_for([path], None))
    logs, not_read, failed = [], [(Path(name), reason) for name, reason in passed_over], None
    for done, log in enumerate(found):
        if progress:
            progress(done / len(found), log.shown)
        try:
            logs.append(_describe_log(log.path, adapter_named(log.adapter), options_of(log.source)))
        except LogError as error:
            failed = error
            not_read.append((log.path, error.cause))
    if failed is not None and not logs:
        raise failed
    return LogsDescription(path, tuple(logs), tuple(not_read))


def _describe_log(path: Path, entry: Registered, options: ReadOptions) -> LogFacts:
    recording = examined(entry.adapter.read(path, options))
    tables = {"robot": recording.robot, "people": recording.people, "events": recording.events}
    levels, share = _levels(recording.robot)
    return LogFacts(
        path=path,
        adapter=entry.name,
        package=f"{entry.package} {entry.version}",
        clock=recording.clock,
        rows_read=recording.rows_read,
        tables={name: table_facts(table) for name, table in tables.items() if table is not None},
        set_aside=_reasons(recording.set_aside),
        levels=levels,
        level_share=share,
        warnings=recording.warnings,
        facts=dict(recording.facts),
    )


def _levels(robot: pl.DataFrame | None) -> tuple[tuple[float, ...], tuple[float, ...]]:
    scaling = None if robot is None or "scaling" not in robot.columns else robot["scaling"].drop_nulls()
    if scaling is None or scaling.is_empty():
        return (), ()
    staircase = find_staircase(scaling.to_numpy())
    return tuple(float(v) for v in staircase.levels), tuple(float(v) for v in staircase.share)


def table_facts(table: pl.DataFrame) -> TableFacts:
    """Return rate, duration, known columns and gaps of one table with a column `t_s`."""
    rows = table.height
    known = {name: 1 - table[name].null_count() / rows for name in table.columns} if rows else {}
    known = {name: share for name, share in known.items() if share > 0 and name not in ("t_s", "source_row")}
    times = table["t_s"].drop_nulls().unique().sort()
    steps = times.diff().drop_nulls()
    if steps.is_empty():
        return TableFacts(rows, None, 0.0, known, ())
    period_s = float(steps.median() or 0.0)  # type: ignore[arg-type]
    silent = steps > max(GAP_PERIODS * period_s, GAP_S)
    starts, lengths = times.slice(0, len(steps)).filter(silent), steps.filter(silent)
    gaps = tuple(Gap(float(at), float(length)) for at, length in zip(starts, lengths, strict=True))
    duration_s = float(times[-1] - times[0])
    return TableFacts(rows, 1 / period_s if period_s > 0 else None, duration_s, known, gaps)


def _reasons(set_aside: pl.DataFrame | None) -> dict[str, int]:
    if set_aside is None or set_aside.is_empty():
        return {}
    counted = set_aside.group_by("reason").len().sort("len", "reason", descending=[True, False])
    return {str(reason): int(count) for reason, count in counted.iter_rows()}


def _describe_dataset(dataset: Dataset, progress: Progress | None) -> DatasetDescription:
    executions, samples = dataset.executions, dataset.samples()
    scaling = samples["scaling"].drop_nulls()
    levelled = samples["step"].drop_nulls()
    share = [float((levelled == index).sum()) / max(1, len(levelled)) for index in range(len(dataset.levels))]
    rows = max(1, samples.height)
    inferred = (samples["scaling_origin"] == "inferred").sum()
    records = dataset.recordings
    return DatasetDescription(
        path=dataset.path,
        schema_version=int(dataset.card["schema_version"]),
        recordings=len(records),
        sources=sum(len(record.get("sources", [])) for record in records),
        set_aside=_set_aside(records),
        executions=executions.height,
        executions_complete=int(executions["complete"].sum()),
        duration_s=float(executions["duration_s"].sum()),
        samples=samples.height,
        places={
            name: {"xyz_m": p.xyz_m, "radius_m": p.radius_m, "inferred": p.inferred}
            for name, p in dataset.places.items()
        },
        human_places={
            name: {"xyz_m": p.xyz_m, "radius_m": p.radius_m, "inferred": p.inferred}
            for name, p in dataset.human_places.items()
        },
        tasks=tuple(_task_rows(dataset.tasks())),
        levels=dataset.levels,
        level_share=tuple(share),
        scaling_known=len(scaling) / rows,
        scaling_inferred=float(inferred) / max(1, len(scaling)),
        operator_seen=1 - samples["human_x_m"].null_count() / rows,
        gaps=_recording_gaps(dataset, progress),
        warnings=tuple(_warnings(dataset)),
        clocks={str(record["id"]): dict(record["clock"]) for record in records},
        operator={str(record["id"]): dict(record["operator"]) for record in records if "operator" in record},
    )


def _set_aside(records: list[dict[str, Any]]) -> dict[str, int]:
    total: dict[str, int] = {}
    for record in records:
        for entry in record.get("rows_set_aside", []):
            total[entry["reason"]] = total.get(entry["reason"], 0) + int(entry["count"])
    return total


def _warnings(dataset: Dataset) -> list[str]:
    own = list(dataset.card.get("warnings", []))
    return own + [f"{record['id']}: {text}" for record in dataset.recordings for text in record["warnings"]]


def _task_rows(tasks: pl.DataFrame) -> list[dict[str, Any]]:
    means = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
    grouped = tasks.group_by("task").agg(pl.len().alias("count"), *(pl.col(name).mean() for name in means))
    return grouped.sort("count", "task", descending=[True, False]).to_dicts()


def _recording_gaps(dataset: Dataset, progress: Progress | None) -> dict[str, tuple[Gap, ...]]:
    found, records = {}, dataset.recordings
    for done, record in enumerate(records):
        if progress:
            progress(done / len(records), str(record["id"]))
        for name in record["tables"]:
            table = dataset.recorded(record["id"], name) if name != "events" else None
            if table is not None and (gaps := table_facts(table).gaps):
                found[f"{record['id']}/{name}"] = gaps
    return found
