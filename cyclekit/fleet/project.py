"""Update a project of one cell: the stages of a fleet's cell, and its estimates; only what changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as dataclass_replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

from msgspec.structs import replace

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.estimate import estimate_cycles
from cyclekit.api.init import first_jobs, first_sequences
from cyclekit.api.report import write_report
from cyclekit.api.train import train_task_times
from cyclekit.config.project import PROJECT_FILE, Project, load_project
from cyclekit.config.sequences import load_sequences
from cyclekit.config.toml_file import read_toml
from cyclekit.dataset.cards import plain, texts
from cyclekit.dataset.guard import check_output
from cyclekit.errors import ModelError, NothingPublished, UnknownName
from cyclekit.estimate.finding import MARKS, worst
from cyclekit.estimate.plan.jobs import Jobs, load_jobs
from cyclekit.estimate.plan.task_orders import TaskJobs, load_task_jobs
from cyclekit.estimate.whatif.change import load_changes
from cyclekit.fleet.read import FleetCell
from cyclekit.fleet.stages import (
    SHOWN,
    STAGES,
    CellAtWork,
    Stage,
    StageResult,
    State,
    asked_for,
    dataset_of,
    fingerprint_of,
    output_exists,
    run_stages,
    told_of,
)
from cyclekit.learning.networks.saved import TrainedModel, load_model
from cyclekit.learning.task_times.saved import TaskTimesModel, holds_task_times, load_task_times
from cyclekit.learning.unseen.saved import holds_unseen, load_unseen
from cyclekit.storage.remote.folders import is_url, join
from cyclekit.text.numbers import fixed
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from cyclekit.api.report import Looks, Searched
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.dataset.guard import Kind
    from cyclekit.learning.unseen.model import UnseenOperator

LEDGER = "cyclekit.json"


@dataclass(frozen=True)
class ProjectCell(FleetCell):
    """The cell of a project, with the paths of the project file.

    Attributes:
        project: The project.
    """

    project: Project = field(default_factory=lambda: Project(()))

    @property
    def dataset(self) -> str:
        """Path or URL of its dataset."""
        return self.project.dataset

    @property
    def model(self) -> str:
        """Path or URL of its model."""
        return self.project.model

    @property
    def report(self) -> str:
        """Path or URL of its report."""
        return self.project.report

    @property
    def ledger(self) -> str:
        """Path or URL of the ledger with the results of its stages."""
        return join(self.folder, LEDGER)

    @property
    def looks(self) -> Looks:
        """Further arguments of `write_report` for its report."""
        project = self.project
        template = None if project.template is None else Path(project.template)
        return {"takt_s": project.takt_s, "baseline": project.baseline, "template": template}

    @property
    def searched(self) -> Searched:
        """The work that its report orders and the changes that it prices, if these files exist."""
        changes = Path(self.project.changes)
        return {
            "jobs": _jobs_in(Path(self.project.jobs)),
            "what_if": load_changes(changes) if changes.is_file() else (),
        }


def _jobs_in(file: Path) -> Jobs | TaskJobs | None:
    """Return the work to order, as places or as tasks of both agents; None without the file."""
    if not file.is_file():
        return None
    return load_task_jobs(file) if "task" in read_toml(file) else load_jobs(file)


@dataclass(frozen=True, repr=False)
class ProjectRun(Result):
    """Results of the stages of a project; as a frame, one row per stage.

    Attributes:
        file: The project file.
        project: The project.
        rows: Result of each stage, in order.
        warnings: Limits of the dataset and the model that a user must know.
    """

    file: Path
    project: Project
    rows: tuple[StageResult, ...]
    warnings: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[StageResult, ...]:
        """The stages that failed."""
        return tuple(row for row in self.rows if row.state == "failed")

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "project": str(self.file),
            "failed": len(self.failed),
            "rows": self._frame_rows(),
            "warnings": list(self.warnings),
        }

    def _frame_rows(self) -> list[dict[str, object]]:
        return [{"stage": row.stage, "state": row.state, "text": row.text} for row in self.rows]

    def _lines(self) -> list[str]:
        return [str(self.file), *(f"{row.stage}: {row.state}: {row.text}" for row in self.rows)]


@checked
def run_project(
    project: Place = PROJECT_FILE,
    *,
    stages: Sequence[str] = ("ingest", "train", "estimate", "report"),
    progress: Progress | None = None,
) -> ProjectRun:
    """Update a project: ingest, train, estimate, report; only what changed since the last run.

    The results are recorded in `cyclekit.json` in the folder of the project file. If there is no sequence file, one is
    written with the order logged most often.

    Args:
        project: The project file, or its folder.
        stages: Stages to run, in order.
        progress: Called with fraction and text.

    Returns:
        The result of each stage, including failures; stages that do not need a failed one still run.

    Raises:
        ConfigError: The project file is invalid.
        UnknownName: A stage does not exist.
        OutputError: A file that cyclekit did not write would be replaced.
    """
    file = Path(project) / PROJECT_FILE if Path(project).is_dir() else Path(project)
    told = load_project(file)
    for stage in stages:
        if stage not in PROJECT_STAGES:
            raise UnknownName("run_project()", "stage", stage, PROJECT_STAGES)
    cell = ProjectCell(
        told.name, told.logs, str(file.parent), told.cell, told.sequences, told.pseudonymise,
        follow_links=told.follow_links, align_clocks=told.align_clocks, project=told,
    )  # fmt: skip
    inputs = [*told.logs, file, told.cell, told.sequences, told.template]
    check_output(cell.ledger, "cell", inputs, option=f"{file}")
    page: Kind = "workbook" if told.report.endswith(".xlsx") else "page"
    places: dict[Kind, str] = {"dataset": told.dataset, "model": told.model, page: told.report}
    for kind, place in places.items():
        check_output(place, kind, inputs, option=f"{file}")
    rows = run_stages(cell, stages=tuple(stages), known=PROJECT_STAGES, progress=progress)
    return ProjectRun(file, told, tuple(rows), _warnings(cell))


def _warnings(cell: FleetCell) -> tuple[str, ...]:
    """Return the warnings of dataset, recordings and model, each once."""
    dataset, model = dataset_of(cell), _model_of_any_kind(cell)
    found = []
    if dataset is not None:
        found += texts(dataset.card.warnings)
        found += [f"{one.shown}: {text}" for one in dataset.card.recordings for text in one.said]
    if isinstance(model, TrainedModel):
        found += texts(model.card.warnings)
    return tuple(dict.fromkeys(found))


def _project(work: CellAtWork) -> Project:
    return cast("ProjectCell", work.cell).project


def _train(work: CellAtWork) -> tuple[State, str]:
    """Learn the safety function or, from a dataset of task lists only, the times of tasks."""
    cell, dataset = work.cell, dataset_of(work.cell)
    if dataset is None:
        return STAGES["train"](work)
    lists, mark = dataset.holds_task_lists_alone, fingerprint_of(dataset)
    known = holds_task_times(cell.model) if lists else holds_unseen(cell.model)
    if known and work.ledger.marks.get("train") == mark and _model_of_any_kind(cell) is not None:
        return "unchanged", f"learned from these {'task lists' if lists else 'logs'}"
    if lists:
        found = train_task_times(dataset, out=cell.model, progress=work.tell)
        done: tuple[State, str]
        done = "done", f"times of {len(found.card.tasks)} tasks from {found.card.executions} executions"
    else:
        done = STAGES["train"](work)
    work.ledger = replace(work.ledger, marks={**work.ledger.marks, "train": mark})
    return done


def _estimate(work: CellAtWork) -> tuple[State, str]:
    """Estimate the sequences if dataset, model, sequences or takt time changed."""
    project, dataset, model = _project(work), dataset_of(work.cell), _model_of_any_kind(work.cell)
    if dataset is None or model is None:
        return "skipped", "there is no dataset" if dataset is None else "there is no model"
    drafted = [file for file in (first_sequences(dataset, project), first_jobs(dataset, project)) if file is not None]
    wanted = load_sequences(Path(project.sequences))
    mark = fingerprint_of(dataset, plain(model.card), asked_for(wanted), project.takt_s)
    ask = partial(estimate_cycles, model, dataset, wanted, out=project.estimates)
    work.estimates = cache(partial(ask, takt_s=project.takt_s, progress=work.tell))
    if work.ledger.marks.get("estimate") == mark and output_exists(project.estimates):
        known = work.ledger.marks.get("light", "")
        return "unchanged", "; ".join(part for part in (known, "same dataset, model, sequences and takt") if part)
    found = work.estimates()
    red = [f"RED: {one.shown}" for one in found.findings if one.level == "red"]
    light = "; ".join(red) or worst(found.findings)
    work.ledger = replace(work.ledger, marks={**work.ledger.marks, "estimate": mark, "light": light})
    means = [light, *(f"{one.name} {fixed(one.expected_s, 1)} s{MARKS[one.level]}" for one in found)]
    told = [f"wrote {' and '.join(map(str, drafted))}"] if drafted else []
    refused = [f"not answered: {one.error.seen}" for one in found.refused]
    return "done", "; ".join([*told, *means[: SHOWN + 1], *refused])


def _report(work: CellAtWork) -> tuple[State, str]:
    """Write the report; without estimates if there are none."""
    done = work.ledger.stages.get("estimate")
    if done is None or done.state in ("failed", "skipped"):
        work.cell, work.estimates = dataclass_replace(work.cell, sequences=None), lambda: None
    model, dataset = _model_of_any_kind(work.cell), dataset_of(work.cell)
    if isinstance(model, TaskTimesModel) and dataset is not None and not is_url(work.cell.report):
        return _report_lists(work, model, dataset)
    return STAGES["report"](work)


def _report_lists(work: CellAtWork, model: TaskTimesModel, dataset: Dataset) -> tuple[State, str]:
    """Write the report of a dataset of task lists."""
    cell = work.cell
    wanted = [] if cell.sequences is None else load_sequences(Path(cell.sequences))
    searched = cell.searched if wanted else {}
    mark = fingerprint_of(dataset, plain(model.card), asked_for(wanted), cell.looks, searched)
    if work.ledger.reported == mark and output_exists(cell.report):
        return "unchanged", "nothing is new"
    facts = write_report(
        dataset, cell.report, model=model, sequences=wanted or None, estimates=work.estimates(), progress=work.tell,
        cell_name=cell.name, **cell.looks, **searched,
    )  # fmt: skip
    work.ledger = replace(work.ledger, reported=mark)
    return "done", told_of(facts)


def _model_of_any_kind(cell: FleetCell) -> TrainedModel | TaskTimesModel | UnseenOperator | None:
    try:
        if holds_unseen(cell.model):
            return load_unseen(cell.model)
        return load_task_times(cell.model) if holds_task_times(cell.model) else load_model(cell.model)
    except (ModelError, NothingPublished):
        return None


PROJECT_STAGES: Mapping[str, Stage] = {
    "ingest": STAGES["ingest"],
    "train": _train,
    "estimate": _estimate,
    "report": _report,
}
"""Stages of a project, in order of dependency."""
