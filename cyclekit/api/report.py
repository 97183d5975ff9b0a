"""`write_report`: the page for the customer, with all results computed for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict, cast

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.estimate import estimate_cycles
from cyclekit.api.evaluate import evaluate_model
from cyclekit.api.given import (
    Sequences,
    estimator_model,
    jobs_of,
    place_of,
    refuse_baseline,
    sequences_of,
    times_of,
    trained_of,
)
from cyclekit.api.plan import plan_order
from cyclekit.api.whatif import changed_cycles
from cyclekit.api.workbooks import need_workbook, sheets_of_estimates, sheets_of_logs
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.errors import ConfigError, CyclekitError, EstimateError
from cyclekit.estimate.answers import CycleEstimates, Refusal
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.whatif.change import Change, load_changes
from cyclekit.learning.evaluation.evaluate import Evaluation
from cyclekit.learning.networks.cell import refuse_other_cell
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
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.plan.answer import OrderPlan
    from cyclekit.estimate.plan.task_orders import TaskOrderPlan
    from cyclekit.estimate.whatif.answer import WhatIf
    from cyclekit.estimate.whatif.answers import WhatIfAnswers

Format = Literal["html", "json", "csv", "md", "xlsx"]
ORDER = "order found"
"""Name of the order found, among the sequences."""
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


class _Looks(Looks, total=False):
    """`Looks` with the title, which a fleet and a project set separately."""

    cell_name: str | None


class _Page(TypedDict, total=False):
    """Content of a page besides the logs, by the argument names of `compose_report`."""

    estimates: CycleEstimates | tuple[()]
    evaluation: Evaluation | None
    check: Check | None
    what_if: Sequence[Tried]
    planned: OrderPlan | None
    missing: Sequence[str]
    refused: Sequence[Refusal]


class _TaskPage(TypedDict, total=False):
    """Content of a page of task lists besides the logs, by the argument names of `report_tasks`."""

    estimates: CycleEstimates | None
    planned: TaskOrderPlan | None
    changed: Sequence[WhatIf]
    refused: Sequence[Refusal]


class _Given(TypedDict):
    """Options of a model's estimates, by the argument names of `estimate_cycles`."""

    validate: bool
    other_cell: bool


@checked
def write_report(
    dataset: Dataset | Place,
    out: Place,
    *,
    model: TrainedModel | TaskTimesModel | UnseenOperator | Place | None = None,
    sequences: Sequences | None = None,
    what_if: Sequence[Place | Change | Tried] = (),
    jobs: Jobs | Place | None = None,
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
        estimates: Earlier estimates of `sequences`, which are then not computed again.
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
    page: _Page = {"estimates": estimates or (), "check": estimates.check if estimates else None, "what_if": tried}
    looks: _Looks = {"takt_s": takt_s, "baseline": baseline, "template": folder, "cell_name": cell_name}
    times = times_of(model)
    if times is not None or (model is None and data.holds_task_lists_alone):
        parts: _TaskPage = {} if times is None else _of_tasks(times, data, sequences, changes, jobs, takt_s, estimates)
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
        asked = _Asked(trained, data, validate, extrapolate, other_cell, tell)
        asked.takt_s = takt_s
        page = asked.found(sequences, changes, tried, jobs, estimates, evaluation)
        if answered := page["estimates"]:
            answered.require(baseline)
    if chosen == "xlsx":
        write = partial(compose_report, data, trained, kind="json", **page, **looks)
        return _as_workbook(data, trained, file, page.get("estimates") or None, write)
    drawing = _part(tell, 0.35, 1.0)
    facts = compose_report(data, trained, file, kind=chosen, play=play, progress=drawing, **page, **looks)
    if printed is not None:
        tell(1.0, "printing")
        write_pdf(file, printed)
    return replace(facts, pdf=printed)


def _opened(given: TrainedModel | UnseenOperator | Place) -> TrainedModel | UnseenOperator:
    if isinstance(given, str | Path) and holds_unseen(given):
        return load_unseen(given)
    return given if isinstance(given, UnseenOperator) else trained_of(given)


def _of_tasks(
    model: TaskTimesModel,
    data: Dataset,
    sequences: Sequences | None,
    changes: list[Change],
    jobs: Jobs | Place | None,
    takt_s: float | None,
    earlier: CycleEstimates | None,
) -> _TaskPage:
    """Return the content of the report of a model of task times, by the argument names of `report_tasks`."""
    wanted = [] if sequences is None else sequences_of(sequences)
    refused = list[Refusal]()
    planned = None
    if jobs is not None:
        order = partial(plan_order, model, data, jobs)
        planned = cast("TaskOrderPlan | None", _searched(order, refused, needed=not wanted))
    asked = [*wanted, *([TaskSequence.of_plan(ORDER, planned.tasks)] if planned else [])]
    if changes and not asked:
        raise ConfigError("changes are tried on sequences, and none are given", cure="Give sequences or jobs.")
    found = earlier
    if asked and (found is None or planned):
        found = estimate_cycles(model, data, asked, takt_s=takt_s)
    changed = changed_cycles(model, data, _answered(asked, found), changes) if changes else None
    refused = [*(found.refused if found else ()), *refused, *(changed.refused if changed else ())]
    return {"estimates": found, "planned": planned, "changed": list(changed or ()), "refused": refused}


def _searched(
    search: Callable[[], OrderPlan | TaskOrderPlan], refused: list[Refusal], *, needed: bool
) -> OrderPlan | TaskOrderPlan | None:
    """Return the result of an order search; None if the logs cannot answer it and something else is asked for."""
    try:
        return search()
    except EstimateError as error:
        if needed:
            raise
        refused.append(Refusal(ORDER, error, "order"))
    return None


def _answered(asked: list[TaskSequence], found: CycleEstimates | None) -> list[TaskSequence]:
    """Return the sequences that have an estimate."""
    names = {each.name for each in found or ()}
    return [each for each in asked if each.name in names]


def _as_workbook(
    data: Dataset, model: object, file: Path, found: CycleEstimates | None, write: Callable[[Path], ReportFacts]
) -> ReportFacts:
    """Write the numbers of the page as a workbook; return the facts of the page (from `write`) for this file."""
    with Scratch() as scratch:
        facts = write(scratch.path / "report.json")
    write_workbook(file, sheets_of_estimates(found, data, model) if found else sheets_of_logs(data))
    return replace(facts, path=file, bytes=file.stat().st_size)


class _Asked:
    """Common inputs of the parts of one page."""

    def __init__(
        self,
        model: TrainedModel | UnseenOperator,
        data: Dataset,
        validate: bool,
        extrapolate: bool,
        other_cell: bool,
        tell: Progress,
    ) -> None:
        refuse_other_cell(model.card, data, other_cell=other_cell)
        self.model, self.data, self.extrapolate, self.tell = model, data, extrapolate, tell
        self.takt_s: float | None = None
        self.given: _Given = {"validate": validate, "other_cell": other_cell}

    def found(
        self,
        sequences: Sequences | None,
        changes: list[Change],
        tried: list[Tried],
        jobs: Jobs | Place | None,
        estimates: CycleEstimates | None,
        evaluation: Evaluation | None,
    ) -> _Page:
        """Return the content of the page besides the logs, by the argument names of `compose_report`.

        Raises:
            CyclekitError: A requested part cannot be computed.
        """
        given = [] if sequences is None else sequences_of(sequences)
        refused, planned = list[Refusal](), None
        if jobs is not None:
            planned = cast("OrderPlan | None", _searched(partial(self._planned, jobs), refused, needed=not given))
        wanted = _with_order(given, planned)
        if wanted and estimates is None:
            estimates = self._estimated(wanted)
        check = estimates.check if estimates else None
        refused = [*(estimates.refused if estimates else ()), *refused]
        if changes:
            if not wanted:
                raise ConfigError("changes are tried on sequences, and none are given", cure="Give sequences or jobs.")
            changed = self._changed(_answered(wanted, estimates), changes, check)
            tried += [Tried.of(each, self.takt_s) for each in changed]
            refused += changed.refused
        missing: list[str] = []
        if evaluation is None and isinstance(self.model, TrainedModel):
            try:
                evaluation = self._evaluated(self.model)
            except CyclekitError as error:  # the evaluation was not requested
                missing.append(f"The model could not be evaluated: {error.seen}.")
        return {
            "estimates": estimates or (),
            "evaluation": evaluation,
            "check": check,
            "what_if": tried,
            "planned": planned,
            "missing": missing,
            "refused": refused,
        }

    def _planned(self, jobs: Jobs | Place) -> OrderPlan:
        found = plan_order(self.model, self.data, jobs_of(jobs), progress=_part(self.tell, 0.0, 0.1), **self.given)
        return cast("OrderPlan", found)  # the jobs are places

    def _estimated(self, wanted: list[TaskSequence]) -> CycleEstimates:
        tell = _part(self.tell, 0.1, 0.2)
        return estimate_cycles(
            self.model, self.data, wanted, takt_s=self.takt_s, extrapolate=self.extrapolate, progress=tell, **self.given
        )

    def _changed(self, wanted: list[TaskSequence], changes: list[Change], check: Check | None) -> WhatIfAnswers:
        tell = _part(self.tell, 0.2, 0.3)
        return changed_cycles(
            estimator_model(self.model), self.data, wanted, changes, check=check, extrapolate=self.extrapolate,
            progress=tell, **self.given,
        )  # fmt: skip

    def _evaluated(self, model: TrainedModel) -> Evaluation:
        foreign, tell = self.given["other_cell"], _part(self.tell, 0.3, 0.35)
        return evaluate_model(model, self.data, boosting=False, other_cell=foreign, progress=tell)


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


def _part(tell: Progress, begin: float, end: float) -> Callable[[float, str], None]:
    """Return a progress function that covers a part of another."""
    return lambda fraction, text: tell(begin + (end - begin) * min(fraction, 1.0), text)


def _with_order(sequences: list[TaskSequence], planned: OrderPlan | None) -> list[TaskSequence]:
    """Return the sequences with the order found, unless it is one of them."""
    if planned is None:
        return sequences
    order = planned.sequence(ORDER)
    if any(each.places == order.places and each.operator is None for each in sequences):
        return sequences
    names = {each.name for each in sequences}
    name = next(name for n in count(1) if (name := ORDER if n == 1 else f"{ORDER} {n}") not in names)
    return [*sequences, replace(order, name=name)]
