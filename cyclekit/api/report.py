"""`write_report`: the page for the customer, with all results computed for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import (
    Sequences,
    place_of,
    refuse_baseline,
    refuse_options_of_positions,
    sequences_of,
    times_of,
    trained_of,
)
from cyclekit.api.page_content import ORDER, Asked, PageContent, TaskPageContent, of_tasks, part_of
from cyclekit.api.workbooks import need_workbook, sheets_of_estimates, sheets_of_logs
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.errors import ConfigError
from cyclekit.estimate.answers import CycleEstimates
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.plan.task_orders import TaskJobs
from cyclekit.estimate.whatif.change import Change, load_changes
from cyclekit.learning.evaluation.evaluate import Evaluation
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.task_times.saved import TaskTimesModel
from cyclekit.learning.unseen.model import UnseenOperator
from cyclekit.learning.unseen.saved import holds_unseen, load_unseen
from cyclekit.report import ReportFacts, Template, Tried, compose_report, load_tried, need_browser, write_pdf
from cyclekit.report.task_lists import report_tasks
from cyclekit.storage.scratch import Scratch
from cyclekit.storage.workbook import write_workbook

if TYPE_CHECKING:
    from cyclekit.dataset.guard import Kind

Format = Literal["html", "json", "csv", "md", "xlsx"]
_WRITTEN_AS: dict[Format, Kind] = {
    "html": "page",
    "md": "words",
    "json": "report-json",
    "csv": "report-csv",
    "xlsx": "workbook",
}
_ENDINGS: dict[str, Format] = {
    ".htm": "html",
    ".md": "md",
    ".markdown": "md",
    ".json": "json",
    ".csv": "csv",
    ".xlsx": "xlsx",
}


class Looks(TypedDict, total=False):
    """The look of a page, by the argument names of `write_report`."""

    takt_s: float | None
    baseline: str | None
    template: Path | None


class Searched(TypedDict, total=False):
    """The work whose order is searched and the changes that are priced, by the argument names of `write_report`."""

    jobs: Jobs | TaskJobs | Place | None
    what_if: Sequence[Place | Change | Tried]


class _Looks(Looks, total=False):
    """`Looks` with the title, which a fleet and a project set separately."""

    cell_name: str | None


@checked
def write_report(
    dataset: Dataset | Place,
    out: Place,
    *,
    model: TrainedModel | TaskTimesModel | UnseenOperator | Place | None = None,
    sequences: Sequences | None = None,
    what_if: Sequence[Place | Change | Tried] = (),
    jobs: Jobs | TaskJobs | Place | None = None,
    takt_s: float | None = None,
    baseline: str | None = None,
    kind: Format | None = None,
    pdf: Place | None = None,
    template: Place | None = None,
    cell_name: str | None = None,
    validate: bool = True,
    extrapolate: bool = False,
    other_cell: bool = False,
    play: bool = True,
    estimates: CycleEstimates | None = None,
    evaluation: Evaluation | None = None,
    progress: Progress | None = None,
) -> ReportFacts:
    """Write one self-contained file: cycle times, where the time goes, causes, possible gains, and reliability.

    Args:
        dataset: The logs: a dataset, its folder or its URL.
        out: The file; an existing one is replaced when the new one is complete.
        model: Trained model, also of an unseen operator; without it the page covers only the logs. A model of task
            times gives another page.
        sequences: The sequences to estimate, or the sequence file.
        what_if: Changes of the sequences, or files of changes (`CHANGES.toml`). Or earlier results: `FILE.json` of
            `what_if`, `LABEL=FILE.json` of `estimate_cycles`.
        jobs: Work whose fastest order is searched; it is estimated and changed like the sequences.
        takt_s: Takt time to compare the cycles with, s.
        baseline: Name of the sequence to compare the others with; default: the logged executions.
        kind: `html`, `json`, `csv`, `md` or `xlsx`; default: by the suffix of `out`.
        pdf: Also print the page here, with an installed browser.
        template: Folder with files that replace the page's own.
        cell_name: Title of the page; the dataset's name where not given.
        validate: Validate on logged executions, and correct the bias.
        extrapolate: Answer even if most of the cycle is outside logged positions.
        other_cell: Accept a model of another cell.
        play: Let the reader of the HTML page try other orders, thresholds, recovery rates and visits per hour.
        estimates: Earlier estimates of `sequences`, which are then not computed again, unless an order is found.
        evaluation: An earlier evaluation of the model.
        progress: Called with the fraction done and a text.

    A sequence, change or order search that the logs cannot answer is named on the page and in `refused` of the result,
    with the reason.

    Raises:
        ConfigError: Estimates without a model, or changes without sequences.
        EstimateError: No sequence can be answered, or not the baseline.
        CyclekitError: A requested part cannot be computed or read, or the file cannot be written.
    """
    file, printed = Path(out), None if pdf is None else Path(pdf)
    chosen: Format = kind or _ENDINGS.get(file.suffix.lower(), "html")
    given = [place_of(each) for each in (dataset, model, sequences, jobs, template)]
    read = [*given, *(str(each).rpartition("=")[2] for each in what_if if isinstance(each, str | Path))]
    check_output(file, _WRITTEN_AS[chosen], read)
    if chosen == "xlsx":
        need_workbook(file)
    check_output(printed, "pdf", [*read, file], option="--pdf", endings=(".pdf",))
    changes, tried = _tried(what_if)
    asked_for = [each.name for each in ([] if sequences is None else sequences_of(sequences))]
    refuse_baseline(baseline, [*asked_for, *([] if jobs is None else [ORDER])])
    if model is None and (sequences or jobs or changes):
        raise ConfigError("estimates need a model", cure="Give a model, or leave the sequences out.")
    if printed is not None:
        need_browser()
    folder = None if template is None else Path(template)
    Template(folder)
    tell = progress or (lambda _fraction, _text: None)
    data = Dataset.of(dataset)
    page: PageContent = {
        "estimates": estimates or (),
        "check": estimates.check if estimates else None,
        "what_if": tried,
    }
    looks: _Looks = {"takt_s": takt_s, "baseline": baseline, "template": folder, "cell_name": cell_name}
    times = times_of(model)
    if times is not None or (model is None and data.holds_task_lists_alone):
        if times is not None:
            chosen_options = {"extrapolate": extrapolate, "validate": not validate, "other_cell": other_cell}
            refuse_options_of_positions(**chosen_options, what_if=bool(tried), evaluation=evaluation is not None)
        parts: TaskPageContent = (
            {} if times is None else of_tasks(times, data, sequences, changes, jobs, takt_s, estimates)
        )
        if found := parts.get("estimates"):
            found.require(baseline)
        card = None if times is None else times.card
        if chosen == "xlsx":
            write = partial(report_tasks, card, data, kind="json", **parts, **looks)
            return _as_workbook(data, times, file, parts.get("estimates"), write)
        facts = report_tasks(card, data, file, kind=chosen, play=play, **parts, **looks)
        if printed is not None:
            write_pdf(file, printed)
        return replace(facts, pdf=printed)
    trained = None if model is None else _opened(model)  # type: ignore[arg-type]  # task times returned above
    if trained is not None:
        asked = Asked(trained, data, validate, extrapolate, other_cell, tell)
        asked.takt_s = takt_s
        page = asked.found(sequences, changes, tried, jobs, estimates, evaluation)
        if answered := page["estimates"]:
            answered.require(baseline)
    if chosen == "xlsx":
        write = partial(compose_report, data, trained, kind="json", **page, **looks)
        return _as_workbook(data, trained, file, page.get("estimates") or None, write)
    drawing = part_of(tell, 0.35, 1.0)
    facts = compose_report(data, trained, file, kind=chosen, play=play, progress=drawing, **page, **looks)
    if printed is not None:
        tell(1.0, "printing")
        write_pdf(file, printed)
    return replace(facts, pdf=printed)


def _opened(given: TrainedModel | UnseenOperator | Place) -> TrainedModel | UnseenOperator:
    if isinstance(given, str | Path) and holds_unseen(given):
        return load_unseen(given)
    return given if isinstance(given, UnseenOperator) else trained_of(given)


def _as_workbook(
    data: Dataset, model: object, file: Path, found: CycleEstimates | None, write: Callable[[Path], ReportFacts]
) -> ReportFacts:
    """Write the numbers of the page as a workbook; return the facts of the page (from `write`) for this file."""
    with Scratch() as scratch:
        facts = write(scratch.path / "report.json")
    write_workbook(file, sheets_of_estimates(found, data, model) if found else sheets_of_logs(data))
    return replace(facts, path=file, bytes=file.stat().st_size)


def _tried(what_if: Sequence[Place | Change | Tried]) -> tuple[list[Change], list[Tried]]:
    """Return the changes to estimate, and earlier results.

    Raises:
        ConfigError: A file is neither a file of changes nor one of results.
    """
    changes = [each for each in what_if if isinstance(each, Change)]
    tried = [each for each in what_if if isinstance(each, Tried)]
    for each in what_if:
        if not isinstance(each, str | Path):
            continue
        label, _, file = str(each).rpartition("=")
        if file.lower().endswith(".toml") and not label:
            changes += load_changes(Path(file))
        elif file.lower().endswith(".json"):
            tried += load_tried(Path(file), label.strip() or None)
        else:
            seen = f"{each}: neither a file of changes (.toml) nor answers (.json)"
            raise ConfigError(seen, cure="Give CHANGES.toml, FILE.json, or LABEL=FILE.json of estimates.")
    return changes, tried
