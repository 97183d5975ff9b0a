"""What is done for one cell, stage by stage: a task of the engine, which gets places and returns a few words.

Each stage does what is new and leaves the rest. What it did, or why it failed, and the figures for the page of the
fleet stand in `cell.json` of the cell's folder; so a stage of today and one of last night make one page.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import cyclekit
from cyclekit.config.sequences import load_sequences
from cyclekit.dataset.cards import BadCard, CellLedger, checked, parse_json
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError, DatasetError, ModelError, StorageError
from cyclekit.estimate.rollout import estimate
from cyclekit.fleet.figures import figures_of
from cyclekit.fleet.months import days_of, since_last_month, since_training
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.networks.cell import fingerprint, other_cell_of
from cyclekit.learning.networks.metrics import large_error
from cyclekit.learning.networks.saved import TrainedModel, load_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import Training, train_at
from cyclekit.report import write_report
from cyclekit.storage.remote.folders import join, mirrored, read_text, write_text
from cyclekit.storage.scratch import Scratch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.fleet.read import FleetCell
    from cyclekit.learning.evaluation.evaluate import Evaluation

Found = TypeVar("Found")
LEDGER, REPORT = "cell.json", "report.html"
State = Literal["done", "unchanged", "failed", "skipped"]


@dataclass(frozen=True)
class Row:
    """What came of one stage of one cell.

    Attributes:
        cell: Its name.
        stage: One of `STAGES`.
        state: `done`, `unchanged` (nothing was new), `failed`, or `skipped` (what it needs is not there).
        text: What was done, or why not.
    """

    cell: str
    stage: str
    state: State
    text: str


def work_on(cell: FleetCell, *, stages: Sequence[str]) -> list[Row]:
    """Do stages of a cell, in order. What fails is told and ends no other stage that can do without it."""
    ledger, rows = read_ledger(cell), list[Row]()
    for stage in stages:
        try:
            state, text = STAGES[stage](cell, ledger)
        except CyclekitError as error:
            state, text = "failed", str(error)
        except Exception as error:  # a fault of ours in one cell must not end the night's work on the others
            state, text = "failed", f"a fault of cyclekit: {type(error).__name__}: {error}"
        row = Row(cell.name, stage, state, text)
        note(cell, ledger, row)
        rows.append(row)
    return rows


def read_ledger(cell: FleetCell) -> dict[str, Any]:
    """Return what is known of a cell; nothing where nothing was done, or it cannot be read."""
    try:
        found = parse_json((read_text(join(cell.folder, LEDGER)) or "{}").encode())
        checked(found, CellLedger)
    except (BadCard, StorageError, OSError, UnicodeError):
        found = {}
    return {"stages": {}, "days": {}, "figures": {}, **found, "cell": cell.name}


def note(cell: FleetCell, ledger: dict[str, Any], row: Row) -> None:
    """Write down what came of a stage."""
    now = dt.datetime.now(tz=dt.UTC).isoformat(timespec="seconds")
    ledger["stages"][row.stage] = {"state": row.state, "text": row.text, "at": now}
    write_text(join(cell.folder, LEDGER), json.dumps(ledger, indent=1, ensure_ascii=False) + "\n")


def _ingest(cell: FleetCell, ledger: dict[str, Any]) -> tuple[State, str]:
    logs = cell.logs()
    report = ingest(
        logs,
        cell.dataset,
        cell=None if cell.cell_file is None else mirrored(cell.cell_file),
        pseudonymise=cell.pseudonymise,
        checksums=cell.checksums,
        follow_links=cell.follow_links,
    )
    if cell.pseudonymise:
        ledger["days"] = {}  # nor those of before
    else:
        ledger["days"] = days_of(Dataset.open(report.dataset), [mirrored(place) for place in logs])
    told = f"{report.executions} executions, {report.recordings_new} recordings read"
    unread = [f"{path}: {reason}" for path, reason in report.not_read]
    told += f"; not read: {'; '.join(unread[:3])}" if unread else ""
    return ("unchanged" if report.unchanged else "done"), told + (f" and {len(unread) - 3} more" if unread[3:] else "")


def _train(cell: FleetCell, ledger: dict[str, Any]) -> tuple[State, str]:
    del ledger
    dataset = _dataset(cell)
    if dataset is None:
        return "skipped", "there is no dataset"
    model = _model(cell)
    if model is not None and (kept := _still_good(model, dataset)) is not None:
        return "unchanged", kept
    spec = ModelSpec.of(seed=cell.seed, epochs=cell.epochs)
    card = train_at(Training(cell.dataset, spec, cell.model))
    why = "first model" if model is None else "the safety function has changed, or its logs have gone"
    return "done", f"{why}: mean absolute error {card['metrics']['mae']:.4f} held out"


def _still_good(model: TrainedModel, dataset: Dataset) -> str | None:
    """Say why no new model is needed; None if one is."""
    if model.card.get("dataset_sha256") == fingerprint(dataset):
        return "trained on these logs"
    held_out = (model.card.get("split") or {}).get("test", ())
    if other_cell_of(model.card, dataset) is not None:
        return None
    if model.problem != "now" or not set(held_out) <= set(dataset.executions["execution"]):
        return None
    changed = since_training(model, dataset)
    if changed is None:
        return "trained on all but a few of these logs"
    if changed.safety_changed:
        return None
    return f"{changed.executions[1]} newer executions show the safety function that was learned"


def _report(cell: FleetCell, ledger: dict[str, Any]) -> tuple[State, str]:
    dataset, model = _dataset(cell), _model(cell)
    if dataset is None:
        return "skipped", "there is no dataset"
    wanted = [] if cell.sequences is None else load_sequences(mirrored(cell.sequences))
    asked = [[each.name, each.places, each.operator] for each in wanted]
    known = [cyclekit.__version__, fingerprint(dataset), None if model is None else model.card, asked, ledger["days"]]
    mark = hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()
    if ledger.get("reported") == mark:
        return "unchanged", "nothing is new"
    missing: list[str] = []
    judged = None if model is None else _or_missing(lambda: evaluate(model, dataset, boosting=False), missing)
    drift = "there is no model" if model is None else since_last_month(model, dataset, ledger["days"])
    # kept although the estimates may fail: what was asked for and cannot be answered is an error of this stage
    ledger["figures"] = asdict(figures_of(dataset, drift, ledger["days"], _doubt(model, judged)))
    found = estimate(model, dataset, wanted) if model is not None and wanted else []
    check = found[0].check if found else None
    with Scratch() as scratch:
        page = scratch.path / REPORT
        facts = write_report(
            dataset, model, page, estimates=found, evaluation=judged, check=check, missing=missing, cell_name=cell.name
        )
        write_text(join(cell.folder, REPORT), page.read_text(encoding="utf-8"))
    ledger["reported"] = mark
    return "done", facts.headline


def _or_missing(make: Callable[[], Found], missing: list[str]) -> Found | None:
    try:
        return make()
    except CyclekitError as error:
        missing.append(f"{error.seen}.")
        return None


def _doubt(model: TrainedModel | None, judged: Evaluation | None) -> str:
    """Say why the error of a cell's model is large, by all that can judge it now, else by what was held out."""
    if model is None:
        return ""
    metrics = judged.metrics.to_json() if judged else model.card.get("metrics")
    return large_error(metrics, model.levels) if metrics else ""


def _dataset(cell: FleetCell) -> Dataset | None:
    try:
        return Dataset.open(cell.dataset)
    except DatasetError:
        return None
    except StorageError as error:
        if "nothing is published" in str(error):
            return None
        raise


def _model(cell: FleetCell) -> TrainedModel | None:
    try:
        return load_model(cell.model)
    except ModelError:  # none, or one of an earlier version
        return None
    except StorageError as error:
        if "nothing is published" in str(error):
            return None
        raise


STAGES: dict[str, Callable[[FleetCell, dict[str, Any]], tuple[State, str]]] = {
    "ingest": _ingest,
    "train": _train,
    "report": _report,
}
"""What can be done for a cell, in the order in which one needs the other."""
