"""What a log, a dataset or a model is, as facts a person checks before trusting an answer.

Rates, durations, gaps, what is known and what was set aside, counted out of the tables. Nothing is judged and nothing
is mended here; how the facts look on a screen is the command line's business.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from cyclekit.dataset import CARD, Dataset, recover
from cyclekit.discover import cell_for, find_all, options_of
from cyclekit.errors import LogError
from cyclekit.models.saved import CARD as MODEL_CARD
from cyclekit.models.saved import load_model
from cyclekit.registry import adapter_named
from cyclekit.steps import find_staircase

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cyclekit.adapter import ReadOptions
    from cyclekit.registry import Registered

    Progress = Callable[[float, str], None]

GAP_PERIODS, GAP_S = 5.0, 0.25
"""A silence is a gap when it is longer than both: five usual periods, and a quarter of a second."""


@dataclass(frozen=True)
class Gap:
    """A silence in a log: from `at_s` on, `length_s` long, seconds of the log's own clock."""

    at_s: float
    length_s: float


@dataclass(frozen=True)
class TableFacts:
    """One table of a log.

    Attributes:
        rows: Number of rows.
        rate_hz: One over the median period; None below two instants.
        duration_s: From the first instant to the last.
        known: Fraction of rows that hold a value, per column that holds any.
        gaps: Silences, in order of time.
    """

    rows: int
    rate_hz: float | None
    duration_s: float
    known: Mapping[str, float]
    gaps: tuple[Gap, ...]


@dataclass(frozen=True)
class LogFacts:
    """One log file (or one folder that is a log).

    Attributes:
        rows_read: Data rows or messages looked at.
        set_aside: Rows not used, by reason.
        tables: Facts of `robot`, `people`, `events`, where the log has them.
        levels: Levels of the logged speed scaling, ascending; `level_share`: fraction of its rows on each.
        facts: What the log states about itself.
    """

    path: Path
    adapter: str
    package: str
    clock: str
    rows_read: int
    tables: Mapping[str, TableFacts]
    set_aside: Mapping[str, int]
    levels: tuple[float, ...]
    level_share: tuple[float, ...]
    warnings: tuple[str, ...]
    facts: Mapping[str, str]


@dataclass(frozen=True)
class LogsDescription:
    """Logs, one or a folder of them.

    Attributes:
        not_read: Path and reason of each file that is no usable log.
    """

    path: Path
    logs: tuple[LogFacts, ...]
    not_read: tuple[tuple[Path, str], ...] = ()
    kind: str = "logs"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return _plain(asdict(self))


@dataclass(frozen=True)
class DatasetDescription:
    """A dataset.

    Attributes:
        sources: Source files that went in; rows set aside from them, by reason.
        robot_place: Centre and radius per robot place, metres; `human_place` likewise.
        tasks: Per task: how often, mean seconds of motion at full speed, of safety loss, of dwell and wait.
        level_share: Fraction of the samples per staircase level.
        scaling_known: Fraction of the samples whose scaling is known; `scaling_inferred`: of those, not logged.
        operator_seen: Fraction of the samples in which the operator's position is known.
        gaps: Silences per recording and table (`id/robot`), where there are any.
    """

    path: Path
    schema_version: int
    recordings: int
    sources: int
    set_aside: Mapping[str, int]
    executions: int
    executions_complete: int
    duration_s: float
    samples: int
    places: Mapping[str, Mapping[str, Any]]
    human_places: Mapping[str, Mapping[str, Any]]
    tasks: tuple[Mapping[str, Any], ...]
    levels: tuple[float, ...]
    level_share: tuple[float, ...]
    scaling_known: float
    scaling_inferred: float
    operator_seen: float
    gaps: Mapping[str, tuple[Gap, ...]]
    warnings: tuple[str, ...]
    kind: str = "dataset"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return _plain(asdict(self))


@dataclass(frozen=True)
class ModelDescription:
    """A model.

    Attributes:
        horizon_s: How far ahead the target lies or reaches.
        levels: Staircase levels that it knows.
        parameters: How many numbers the network has.
        card: How it came about, as written when it was trained.
    """

    path: Path
    problem: str
    network: str
    horizon_s: float
    levels: tuple[float, ...]
    parameters: int
    card: Mapping[str, Any]
    kind: str = "model"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return _plain(asdict(self))


Description = LogsDescription | DatasetDescription | ModelDescription


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
    recording = entry.adapter.read(path, options)
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


def _plain(value: dict[str, Any]) -> dict[str, Any]:
    """Return the value with paths as text, ready for JSON."""
    plain: dict[str, Any] = json.loads(json.dumps(value, default=str))
    return plain
