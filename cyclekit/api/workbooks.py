"""The sheets of a workbook: light, answer, tasks, levels, provenance."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING

from cyclekit.dataset.cards import texts
from cyclekit.extras import need
from cyclekit.learning.networks.cell import fingerprint
from cyclekit.learning.rules.words import sentences

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import polars as pl

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.answers import CycleEstimates
    from cyclekit.estimate.finding import Finding
    from cyclekit.estimate.plan.answer import OrderPlan

    Rows = list[list[object]]
    Sheets = dict[str, Rows]

_MAX_LOGS = 1000
"""Maximum number of logs listed one by one."""
_SPLIT = ("expected_s", "nominal_s", "safety_loss_s", "dwell_s", "wait_s")


def need_workbook(file: Path | None) -> None:
    """Fail early if a workbook is wanted and cannot be written.

    Raises:
        MissingExtra: XlsxWriter is not installed.
    """
    if file is not None and file.suffix.lower() == ".xlsx":
        need(f"{file}: writing an Excel workbook", "excel")


def sheets_of_estimates(found: CycleEstimates, dataset: Dataset, model: object) -> Sheets:
    """Return the sheets of estimates, all times in seconds."""
    frame = found.to_frame()
    shares = [one.takt_probability or (None, None, None) for one in found]
    takt = [[one.takt_s, *share, " | ".join(one.doubts)] for one, share in zip(found, shares, strict=True)]
    heads = [*frame.columns, "takt_s", "within_takt", "within_takt_low", "within_takt_high", "doubts"]
    answer = [[*row, *more] for row, more in zip(frame.rows(), takt, strict=True)]
    more: Rows = [[f"estimate of {one.name}", f"{one.estimator}: {one.why}"] for one in found]
    more += [["not answered", f"{one.name}: {one.error.seen}"] for one in found.refused]
    return {
        "light": _light(found.findings),
        "answer": [heads, *answer],
        "tasks": _tasks(found, dataset),
        "levels": _levels(dataset, model),
        "provenance": _provenance(dataset, model, more),
    }


def sheets_of_plan(found: OrderPlan, dataset: Dataset, model: object) -> Sheets:
    """Return the sheets of an order search, all times in seconds."""
    single = {name: value for name, value in found.to_dict().items() if not isinstance(value, list)}
    saved: dict[str, object] = dict(zip(("saves_s", "saves_low_s", "saves_high_s"), found.saves_s, strict=True))
    saved["saves"] = found.saving_in_words
    listed: Rows = [["note", text] for text in found.notes]
    listed += [["never logged", task] for task in found.unlogged]
    return {
        "light": _light(found.findings),
        "answer": [
            ["what", "value"],
            ["order", ", ".join(found.order)],
            *map(list, (single | saved).items()),
        ],
        "tasks": _of_frame(found.to_frame()),
        "levels": _levels(dataset, model),
        "provenance": _provenance(dataset, model, listed),
    }


def sheets_of_logs(dataset: Dataset) -> Sheets:
    """Return the sheets of the logs only: all executions and tasks, times in seconds."""
    return {
        "answer": _of_frame(dataset.executions),
        "tasks": _of_frame(dataset.every_task()),
        "levels": _levels(dataset, None),
        "provenance": _provenance(dataset, None, []),
    }


def _light(findings: Sequence[Finding]) -> Rows:
    rows: Rows = [[one.level, one.code, one.text, one.cure] for one in findings]
    return [["level", "about", "finding", "cure"], *rows]


def _of_frame(frame: pl.DataFrame) -> Rows:
    return [list(frame.columns), *map(list, frame.rows())]


def _tasks(found: CycleEstimates, dataset: Dataset) -> Rows:
    """Return one row per task of each sequence, in order; for a plan of both agents, with agent and times."""
    if any(one.plan for one in found):
        names = ("agent", "task", "start_s", "end_s", "wait_s")
        rows = [[one.name, *(getattr(task, name) for name in names)] for one in found for task in one.plan]
        return [["sequence", *names], *rows]
    rows = [
        [one.name, at, task.task, dataset.task_label(task.task), *(getattr(task, name) for name in _SPLIT)]
        for one in found
        for at, task in enumerate(one.tasks, start=1)
    ]
    return [["sequence", "order", "task", "label", *_SPLIT], *rows]


def _levels(dataset: Dataset, model: object) -> Rows:
    """Return the levels with their share of the samples on a level, followed by the rule of the model in words."""
    rows: Rows = [["level", "share of samples"]]
    if dataset.levels:
        steps = dataset.samples(columns=["step"])["step"].drop_nulls()
        rows += [[level, float((steps == at).sum()) / max(1, len(steps))] for at, level in enumerate(dataset.levels)]
    rule = getattr(getattr(model, "card", None), "rule", None)
    rows += [[text] for text in (sentences(rule) if rule is not None else ())]
    return rows


def _provenance(dataset: Dataset, model: object, more: Rows) -> Rows:
    rows: Rows = [
        ["what", "value"],
        ["cyclekit", version("cyclekit")],
        ["dataset", dataset.place],
        ["dataset SHA-256", fingerprint(dataset)],
        ["executions", dataset.executions.height],
        ["complete executions", int(dataset.executions["complete"].sum())],
    ]
    card = getattr(model, "card", None)
    rows += [
        [f"model {name}", value]
        for name in ("network", "problem", "dataset", "dataset_sha256", "seed", "cyclekit", "executions")
        if isinstance(value := getattr(card, name, None), str | int)
    ]
    rows += more
    rows += [["warning", text] for text in texts(dataset.card.warnings)]
    logs = [source for record in dataset.recordings for source in record.sources]
    rows += [["log", f"{one.path} {one.checksum or ''}".rstrip()] for one in logs[:_MAX_LOGS]]
    rows += [["log", f"and {len(logs) - _MAX_LOGS} more"]] if len(logs) > _MAX_LOGS else []
    rows += [["not read", f"{one.path}: {one.reason}"] for one in dataset.card.not_read]
    return rows
