"""Run the stages of one cell: a task of the engine, which gets paths and returns short texts.

Each stage processes only what is new. Its result or error, and the figures for the page of the fleet, are recorded in
`cell.json` in the cell's folder, so that stages run at different times appear on one page.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from msgspec.structs import replace

from cyclekit.api.evaluate import evaluate_model
from cyclekit.api.ingest import ingest_logs
from cyclekit.api.report import write_report
from cyclekit.api.train import train_model
from cyclekit.config import Cell
from cyclekit.config.sequences import load_sequences
from cyclekit.config.write import toml_value
from cyclekit.dataset.cards import BadCard, CellLedger, StageCard, checked, parse_json, plain
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, CyclekitError, DatasetError, ModelError, NothingPublished, StorageError
from cyclekit.estimate.finding import doubts_of, worst
from cyclekit.fleet.figures import figures_of
from cyclekit.fleet.months import days_of, since_last_month, since_training
from cyclekit.fleet.read import REPORT
from cyclekit.learning.networks.cell import fingerprint, other_cell_of
from cyclekit.learning.networks.metrics import large_error
from cyclekit.learning.networks.saved import TrainedModel, load_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.storage.remote.folders import is_url, mirrored, read_text, write_text
from cyclekit.storage.scratch import Scratch
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit.api.arguments import Progress
    from cyclekit.config.sequences import TaskSequence
    from cyclekit.estimate.answers import CycleEstimates
    from cyclekit.fleet.read import FleetCell
    from cyclekit.learning.evaluation.evaluate import Evaluation
    from cyclekit.report import ReportFacts

SHOWN = 3
"""Maximum number of unreadable logs, or of estimates, named in a result."""
State = Literal["done", "unchanged", "failed", "skipped"]


@dataclass(frozen=True)
class StageResult:
    """Result of one stage of one cell.

    Attributes:
        cell: Name of the cell.
        stage: One of `STAGES`.
        state: `done`, `unchanged` (nothing was new), `failed`, or `skipped` (an input is missing).
        text: Result, or reason.
    """

    cell: str
    stage: str
    state: State
    text: str


@dataclass
class CellAtWork:
    """A cell in progress, with its ledger, which stages replace.

    `estimates` returns the estimates of an earlier stage for the report; None if the report makes them.
    """

    cell: FleetCell
    ledger: CellLedger
    estimates: Callable[[], CycleEstimates | None] = lambda: None
    tell: Progress = lambda _fraction, _text: None


def run_stages(
    cell: FleetCell,
    *,
    stages: Sequence[str],
    known: Mapping[str, Stage] | None = None,
    progress: Progress | None = None,
) -> list[StageResult]:
    """Run stages of a cell, in order; a failed stage is recorded, and the others still run.

    Args:
        cell: The cell.
        stages: Names of stages.
        known: Available stages, by name; by default `STAGES`.
        progress: Called with fraction and text.
    """
    work, rows = CellAtWork(cell, read_ledger(cell)), list[StageResult]()
    tell = progress or work.tell
    for at, stage in enumerate(stages):
        work.tell = partial(_tell_part, tell, stage, at, len(stages))
        try:
            state, text = (known or STAGES)[stage](work)
        except CyclekitError as error:
            state, text = "failed", str(error)
        except Exception as error:  # a bug in one cell must not stop the others
            state, text = "failed", f"internal error: {type(error).__name__}: {error}"
        row = StageResult(cell.name, stage, state, text)
        work.ledger = record_stage(cell, work.ledger, row)
        rows.append(row)
    return rows


def _tell_part(tell: Progress, stage: str, at: int, count: int, fraction: float, text: str) -> None:
    tell((at + min(fraction, 1.0)) / count, f"{stage}: {text}")


def read_ledger(cell: FleetCell) -> CellLedger:
    """Return the ledger of a cell; empty if it does not exist or cannot be read."""
    try:
        found = checked(parse_json((read_text(cell.ledger) or "{}").encode()), CellLedger)
    except (BadCard, StorageError, OSError, UnicodeError):
        found = CellLedger()
    return replace(found, cell=cell.name)


def record_stage(cell: FleetCell, ledger: CellLedger, row: StageResult) -> CellLedger:
    """Record the result of a stage, and return the updated ledger."""
    now = dt.datetime.now(tz=dt.UTC).isoformat(timespec="seconds")
    done = StageCard(state=row.state, text=row.text, at=now)
    ledger = replace(ledger, stages={**ledger.stages, row.stage: done})
    text = json.dumps(plain(ledger, nulls=True), indent=1, ensure_ascii=False)
    write_text(cell.ledger, text + "\n")
    return ledger


def _ingest(work: CellAtWork) -> tuple[State, str]:
    cell, logs, before = work.cell, work.cell.logs(), dataset_of(work.cell)
    if before is not None and before.card.pseudonymised and not cell.pseudonymise:
        msg = f"{cell.dataset}: names and times of day were taken out of it, and would be read again"
        cure = "Keep them out: pseudonymise = true in the project or fleet file; or remove the dataset."
        raise ConfigError(msg, cure=cure)
    work.ledger = replace(work.ledger, not_read=(), not_read_more=0)
    report = ingest_logs(
        logs,
        cell.dataset,
        cell=None if cell.cell_file is None else mirrored(cell.cell_file),
        pseudonymise=cell.pseudonymise,
        keep_skeletons=before is not None and before.card.skeletons,
        align_clocks=cell.align_clocks,
        checksums=cell.checksums,
        follow_links=cell.follow_links,
        progress=work.tell,
    )
    days: dict[str, dt.date] = {}  # drops earlier ones too
    made = Dataset.open(report.dataset)
    if not cell.pseudonymise:
        days = days_of(made, [mirrored(place) for place in logs])
    unread = tuple(f"{path}: {reason}" for path, reason in report.not_read)
    work.ledger = replace(work.ledger, days=days, not_read=unread[:SHOWN], not_read_more=max(0, len(unread) - SHOWN))
    told = f"{report.executions} executions, {report.recordings_new} recordings read"
    told += f"; not read: {work.ledger.unread}" if unread else ""
    return ("unchanged" if report.unchanged else "done"), "; ".join([told, *(_undone(before, made) if before else ())])


def _undone(before: Dataset, made: Dataset) -> Iterator[str]:
    """Yield a sentence for each setting of the last dataset, such as a typed option, that no file states."""
    then, now = before.card.settings, made.card.settings
    for name in ("align_clocks", "rate_hz", "accept_bad_logs"):
        if getattr(now, name) == getattr(Cell(), name) != getattr(then, name):
            was = toml_value(getattr(then, name))
            yield f"the last dataset had {name} = {was}: to keep it, write that into the cell file"


def _train(work: CellAtWork) -> tuple[State, str]:
    cell, dataset = work.cell, dataset_of(work.cell)
    if dataset is None:
        return "skipped", "there is no dataset"
    model = _trained_model(cell)
    if model is not None and (kept := _still_good(model, dataset)) is not None:
        return "unchanged", kept
    spec = ModelSpec.of(seed=cell.seed, epochs=cell.epochs)
    card = train_model(cell.dataset, spec, out=cell.model, progress=work.tell).card
    why = "first model" if model is None else "the safety function has changed, or logs of the model are missing"
    error = f": mean absolute error {fixed(card.metrics.mae, 4)} held out" if card.metrics is not None else ""
    return "done", why + error


def _still_good(model: TrainedModel, dataset: Dataset) -> str | None:
    """Return why no new model is needed; None if one is needed."""
    if model.card.dataset_sha256 == fingerprint(dataset):
        return "trained on these logs"
    held_out = model.card.held_out
    if other_cell_of(model.card, dataset) is not None:
        return None
    if model.problem != "now" or not set(held_out) <= set(dataset.executions["execution"]):
        return None
    changed = since_training(model, dataset)
    if changed is None:
        return "trained on nearly all of these logs"
    if changed.safety_changed:
        return None
    return f"the safety function is unchanged in {changed.executions[1]} newer executions"


def _report(work: CellAtWork) -> tuple[State, str]:
    cell, days = work.cell, work.ledger.days
    dataset, model = dataset_of(cell), _trained_model(cell)
    if dataset is None:
        return "skipped", "there is no dataset"
    wanted = [] if cell.sequences is None else load_sequences(mirrored(cell.sequences))
    dated = {session: day.isoformat() for session, day in days.items()}
    card = None if model is None else plain(model.card)
    searched = cell.searched if model is not None and wanted else {}
    mark = fingerprint_of(dataset, card, asked_for(wanted), dated, cell.looks, searched)
    if work.ledger.reported == mark and output_exists(cell.report):
        return "unchanged", "nothing is new"
    judged = None if model is None else _judged(model, dataset)
    drift = "there is no model" if model is None else since_last_month(model, dataset, days)
    # recorded before the estimates, which may fail: if no sequence can be answered, this stage fails
    work.ledger = replace(work.ledger, figures=figures_of(dataset, drift, days, _doubt(model, judged)))
    asked, estimates = wanted if model is not None and wanted else None, work.estimates()
    with Scratch() as scratch:
        file = scratch.path / REPORT if is_url(cell.report) else Path(cell.report)
        facts = write_report(
            dataset, file, model=model, sequences=asked, evaluation=judged, estimates=estimates, cell_name=cell.name,
            progress=work.tell, **cell.looks, **searched,
        )  # fmt: skip
        if is_url(cell.report):
            write_text(cell.report, file.read_text(encoding="utf-8"))
    lit = replace(work.ledger.figures, light=worst(facts.findings), light_why=doubts_of(facts.findings))
    work.ledger = replace(work.ledger, reported=mark, figures=lit if facts.findings else work.ledger.figures)
    return "done", told_of(facts)


def told_of(facts: ReportFacts) -> str:
    """Return the result of a report in a line: its answer, and what the logs cannot answer."""
    return "; ".join([facts.headline, *(f"not answered: {each.error.seen}" for each in facts.refused)])


def asked_for(sequences: Sequence[TaskSequence]) -> list[object]:
    """Return the content of sequences as plain values."""
    return [
        [each.name, each.places, each.operator, each.allowance, [vars(task) for task in each.plan]]
        for each in sequences
    ]


def fingerprint_of(dataset: Dataset, *others: object) -> str:
    """Return a hash of the version, the dataset and other plain values, to detect changes."""
    known = [version("cyclekit"), fingerprint(dataset), *others]
    return hashlib.sha256(json.dumps(known, sort_keys=True, default=str).encode()).hexdigest()


def output_exists(place: str) -> bool:
    """Return whether an output still exists; assumed for a URL."""
    return is_url(place) or Path(place).exists()


def _judged(model: TrainedModel, dataset: Dataset) -> Evaluation | None:
    """Return the evaluation of the model on these logs; None if it fails, which the report states."""
    try:
        return evaluate_model(model, dataset, boosting=False)
    except CyclekitError:
        return None


def _doubt(model: TrainedModel | None, judged: Evaluation | None) -> str:
    """Return the reason for a large model error, from the evaluation on these logs, else from training; else empty."""
    if model is None:
        return ""
    metrics = judged.metrics if judged else model.card.metrics
    return large_error(metrics, model.levels) if metrics is not None else ""


def dataset_of(cell: FleetCell) -> Dataset | None:
    """Return the dataset of a cell; None if there is none."""
    try:
        return Dataset.open(cell.dataset)
    except (DatasetError, NothingPublished):
        return None


def _trained_model(cell: FleetCell) -> TrainedModel | None:
    try:
        return load_model(cell.model)
    except (ModelError, NothingPublished):  # none, or one of an earlier version
        return None


Stage = Callable[[CellAtWork], tuple[State, str]]
STAGES: dict[str, Stage] = {
    "ingest": _ingest,
    "train": _train,
    "report": _report,
}
"""Stages of a cell, in order of dependency."""
