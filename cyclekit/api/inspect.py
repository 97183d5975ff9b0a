"""`inspect_logs`: a log, a folder of logs, a dataset or a model, described; `draft_cell`: the cell file that fits logs.

`plan_recordings` says what to log next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import Sequences, path_of, place_of, sequences_of
from cyclekit.config import cell_to_toml
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.dataset.history import history_of, kinds_of
from cyclekit.errors import ConfigError, DatasetError, OutputError
from cyclekit.estimate.what_to_log import WITHIN, RecordingPlan, what_to_log
from cyclekit.ingest.discover import suggest_cell
from cyclekit.ingest.suggest_activities import with_activities
from cyclekit.inspect.facts import DatasetDescription, Description
from cyclekit.storage.atomic import write_text
from cyclekit.storage.outputs import check_writable
from cyclekit.storage.remote.folders import local
from cyclekit.text.numbers import counted, given
from cyclekit.text.results import Result

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, repr=False)
class CellDraft(Result):
    """The cell file for some logs; as a frame, its lines and which are guesses.

    Attributes:
        cell: Its text (TOML).
        unsure: Number of guessed lines, marked `# ?`.
        out: Where it was written; None if not written.
    """

    cell: str
    unsure: int
    out: Path | None = None

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"cell": self.cell, "unsure": self.unsure, **({"out": str(self.out)} if self.out else {})}

    def _frame_rows(self) -> list[dict[str, object]]:
        return [{"line": line, "unsure": "# ?" in line} for line in self.cell.splitlines()]

    def _lines(self) -> list[str]:
        return [f"{len(self.cell.splitlines())} lines, {self.unsure} of them not sure"]


@dataclass(frozen=True, repr=False)
class LoggedHistory(Result):
    """What each agent did in logged executions, and when each signal was on.

    Attributes:
        rows: Table HISTORY; times since the start of the execution, s.
        executions: Number of executions in the dataset.
        gantt: File of the time chart; None if not drawn.
    """

    rows: pl.DataFrame
    executions: int
    gantt: Path | None = None

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        written = {"gantt": str(self.gantt)} if self.gantt else {}
        return {"executions": self.executions, "rows": self._frame_rows(), **written}

    def _frame_rows(self) -> list[dict[str, object]]:
        return self.rows.to_dicts()

    def _lines(self) -> list[str]:
        shown = self.rows["execution"].n_unique()
        return [f"{counted(self.rows.height, 'row')}, {shown} of {counted(self.executions, 'execution')}"]


@checked
def logged_history(
    dataset: Dataset | Place, *, executions: Sequence[str] = (), gantt: Place | None = None
) -> LoggedHistory:
    """Return what each agent did in logged executions: tasks of robot and operator, task lists and signals alike.

    Args:
        dataset: A dataset, its folder or its URL.
        executions: Names of executions; default: all.
        gantt: Also draw the first executions as a time chart: a .svg, .png or .pdf file.

    Raises:
        UnknownName: There is no such execution.
        DatasetError: There is no dataset.
        OutputError: The chart would replace the dataset, or a file that is not a picture of cyclekit.
    """
    file = path_of(gantt)
    check_output(file, "picture", [place_of(dataset)], option="--gantt", endings=(".svg", ".png", ".pdf"))
    opened = Dataset.of(dataset)
    rows = history_of(opened, list(executions) or None)
    if file is not None:
        from cyclekit.plots.history import draw_history  # local, as importing matplotlib takes long

        draw_history(file, rows, kinds_of(opened))
    return LoggedHistory(rows, opened.executions.height, file)


@checked
def inspect_logs(
    path: Place,
    *,
    cell: Place | None = None,
    sequences: Sequences = (),
    follow_links: bool = False,
    verify: bool = False,
    progress: Progress | None = None,
) -> Description:
    """Describe what is at `path`: logs, a dataset or a model, recognised by content.

    Args:
        path: A file, a folder, or the URL of a dataset or model.
        cell: Cell file with settings for reading the logs; default: the one in their folder.
        sequences: For a dataset: say what to log next to estimate these.
        follow_links: Follow links that lead out of a folder of logs.
        verify: Also check that every file of a dataset is unchanged.
        progress: Called with the fraction done and the file being read.

    Raises:
        LogError: The path does not exist, or nothing there can be read.
        ConfigError: The cell file is invalid.
        DatasetError: The dataset is of another schema version, or one of its files was changed.
        ModelError: The model is of another schema version, or damaged.
    """
    from cyclekit.inspect.describe import describe  # local: `estimate` needs only `plan_recordings`

    count = Dataset.open(path).verify() if verify else None
    found = describe(local(path), cell=path_of(cell), progress=progress, follow_links=follow_links)
    if not isinstance(found, DatasetDescription):
        return found
    try:
        plan = plan_recordings(path, sequences) if found.tasks else None
    except DatasetError:  # no complete task of the robot is known
        plan = None
    return replace(found, verified=count, to_log=plan)


@checked
def plan_recordings(dataset: Dataset | Place, sequences: Sequences = (), *, within: float = WITHIN) -> RecordingPlan:
    """Return what to log next: orders with missing and rare tasks, and the number of executions needed.

    Args:
        dataset: The logs so far: a dataset, its folder or its URL.
        sequences: The sequences to estimate, or the sequence file; default: the logged tasks.
        within: Requested half-width of the 95 % interval of the mean cycle time, as a share of the mean.

    Raises:
        DatasetError: The dataset holds no robot tasks.
        ConfigError: `within` is not between 0 and 1, or the sequence file cannot be read.
    """
    if not 0.0 < within < 1.0:
        raise ConfigError(f"within = {given(within)} is not between 0 and 1", cure="Give 0.01 for ± 1 %, say.")
    return what_to_log(Dataset.of(dataset), sequences_of(sequences), within=within)


@checked
def draft_cell(logs: Place, out: Place | None = None, *, follow_links: bool = False) -> CellDraft:
    """Return the cell file for logs; a draft if a table is unknown.

    Args:
        logs: A log or a folder of logs.
        out: Also write it here; an existing file is never replaced.
        follow_links: Follow links that lead out of the folder.

    Raises:
        LogError: The path does not exist, or nothing there can be read.
        OutputError: `out` exists.
        CyclekitError: It cannot be written.
    """
    file = path_of(out)
    if file is not None:
        if file.exists() or file.is_symlink():
            cure = "Give another name; the file may contain edits by hand."
            raise OutputError(f"{file}: exists, and a cell file is never replaced", cure=cure)
        check_writable(file)
    suggested = suggest_cell([local(logs)], follow_links=follow_links)
    suggested = with_activities(suggested, [local(logs)], follow_links=follow_links)
    text = cell_to_toml(suggested.cell, suggested.drafts)
    if file is not None:
        write_text(file, text)
    return CellDraft(text, sum(draft.unsure for draft in suggested.drafts.values()), file)
