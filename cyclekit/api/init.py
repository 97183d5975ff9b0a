"""`start_project`: the project file of a folder of logs; `first_sequence`: the order that was logged most often."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import polars as pl

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.config import Cell, cell_to_toml
from cyclekit.config.project import PROJECT_FILE, Project, load_project, project_to_toml
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.config.write import sequence_to_toml, toml_value
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import ConfigError, DatasetError, LogError, OutputError, command_line
from cyclekit.estimate.what_to_log import doubtful_places
from cyclekit.ingest.discover import CELL_FILE, cell_for, find_all, suggest_cell
from cyclekit.ingest.suggest_activities import with_activities
from cyclekit.inspect.describe import describe
from cyclekit.inspect.facts import LogsDescription
from cyclekit.storage.atomic import write_text
from cyclekit.storage.identify import MODEL_CARD
from cyclekit.storage.outputs import check_writable
from cyclekit.text.results import Result

READ_BYTES = 1_000_000_000
"""Maximum size of the logs that are read for their warnings."""


@dataclass(frozen=True, repr=False)
class StartedProject(Result):
    """A new project; as a frame one row per log.

    Attributes:
        file: The project file.
        project: Its content.
        logs: Name of each log found, and the adapter that reads it.
        not_read: Files that no adapter reads, with the reason.
        written: Every file that was written.
        unsure: Number of guessed lines in the cell file, marked `# ?`.
        warnings: Name of a log, and what reading it warned of; none if the logs are larger than READ_BYTES.
        unread_bytes: Size of logs that were too large to be read here; 0 otherwise.
    """

    file: Path
    project: Project
    logs: tuple[tuple[str, str], ...]
    not_read: tuple[tuple[str, str], ...]
    written: tuple[Path, ...]
    unsure: int
    warnings: tuple[tuple[str, str], ...] = ()
    unread_bytes: int = 0

    def _frame_rows(self) -> list[dict[str, object]]:
        return [{"log": log, "adapter": adapter} for log, adapter in self.logs]

    def _lines(self) -> list[str]:
        return [f"{self.file}: {len(self.logs)} logs in {', '.join(self.project.logs)}"]


@checked
def start_project(
    logs: Place = ".",
    folder: Place = ".",
    *,
    name: str = "",
    takt: str | None = None,
    follow_links: bool = False,
    progress: Progress | None = None,
) -> StartedProject:
    """Look at a folder of logs and write its project file, and a cell file if there is none.

    If `folder` already holds a dataset, the sequence file is written too: the order logged most often.

    Args:
        logs: Folder of logs.
        folder: Folder of the project file, and later of the dataset, the model and the results.
        name: Title of the report; empty: the name of the folder.
        takt: Takt time, such as `105s`.
        follow_links: Follow links that lead out of the folder of logs.
        progress: Called with the part done, 0 to 1, and a text.

    Raises:
        LogError: The path does not exist, or nothing there can be read.
        OutputError: There is a project file already.
        ConfigError: The takt time is no duration, or the cell file of the logs is invalid.
    """
    home, root = Path(folder), Path(logs)
    file = home / PROJECT_FILE
    if file.exists() or file.is_symlink():
        cure = f"Bring it up to date with `cyclekit run`; for a new one rename {file} first."
        raise OutputError(f"{file}: exists, and a project file is never replaced", cure=cure)
    check_writable(file)
    roots = _roots(root, home)
    written: list[Path] = []
    found, not_read, cell_file, unsure = _looked_at(roots, home, follow_links=follow_links)
    if cell_file is not None:
        write_text(home / CELL_FILE, cell_file)
        written.append(home / CELL_FILE)
    cell = CELL_FILE if (home / CELL_FILE).is_file() else None
    given = Project(tuple(_shown(each, home) for each in roots), name=name, cell=cell, takt=takt)
    write_text(file, project_to_toml(given))
    written.append(file)
    try:
        project = load_project(file)
    except Exception:
        file.unlink()
        raise
    if (Path(project.dataset) / CARD).is_file() and (made := first_sequences(Dataset.open(project.dataset), project)):
        written.append(made)
    warnings, left = _warnings(roots, home, follow_links=follow_links, progress=progress)
    return StartedProject(file, project, found, not_read, tuple(written), unsure, warnings, left)


def _roots(root: Path, home: Path) -> list[Path]:
    """Return the folders of logs: the given one, or its subfolders if the dataset would be in the same folder.

    Raises:
        LogError: There is no such folder, or the project would lie among the logs.
    """
    if not root.exists():
        raise LogError(root, "no such file or folder", cure="Give the folder that holds the logs.")
    if root.resolve() != home.resolve():
        return [root]
    inside = [each for each in sorted(root.iterdir()) if not each.name.startswith(".") and not _is_ours(each)]
    found = [each for each in inside if _holds_logs(each)]
    if not found:
        raise LogError(root, "holds no log that can be read", cure="Give the folder that holds the logs.")
    if all(each.is_dir() for each in found) and not (root / CELL_FILE).exists():
        return found
    begin = command_line("init", root.resolve().name)
    raise LogError(
        root, "is the folder of logs; the dataset must be outside", cure=f"Begin one folder up:\n  cd ..\n  {begin}"
    )


def _is_ours(path: Path) -> bool:
    return path.suffix == ".toml" or any((path / card).is_file() for card in (CARD, MODEL_CARD))


def _holds_logs(path: Path) -> bool:
    try:
        return bool(find_all([path], cell_for([path], None))[0])
    except LogError:
        return False


def _cell(roots: list[Path], home: Path) -> Cell:
    beside = home / CELL_FILE
    return cell_for(roots, beside if beside.is_file() else None)


def _looked_at(
    roots: list[Path], home: Path, *, follow_links: bool
) -> tuple[tuple[tuple[str, str], ...], tuple[tuple[str, str], ...], str | None, int]:
    """Return the logs with their adapters, the files not read, a new cell file if there is none, and its guesses.

    Raises:
        LogError: Nothing can be read.
    """
    has_cell = (home / CELL_FILE).is_file() or any((root / CELL_FILE).is_file() for root in roots)
    suggested = (
        None
        if has_cell
        else with_activities(suggest_cell(roots, follow_links=follow_links), roots, follow_links=follow_links)
    )
    drafts = suggested.drafts if suggested else {}
    try:
        logs, not_read = find_all(roots, _cell(roots, home), follow_links=follow_links)
    except LogError:
        if not drafts:
            raise
        logs, not_read = [], []
    text = cell_to_toml(suggested.cell, drafts) if suggested else None
    sources = suggested.cell.sources if suggested else ()
    mapped = {source.path: source.adapter for source in sources if source.path in drafts}
    by_map = {name: next((mapped[path] for path in mapped if fnmatch(name, path)), None) for name, _ in not_read}
    found = [(log.shown, log.adapter) for log in logs]
    found += [(name, f"{adapter}, by the map drafted in {CELL_FILE}") for name, adapter in by_map.items() if adapter]
    left = tuple((name, reason) for name, reason in not_read if not by_map[name])
    return tuple(found), left, text, sum(draft.unsure for draft in drafts.values())


def _warnings(
    roots: list[Path], home: Path, *, follow_links: bool, progress: Progress | None
) -> tuple[tuple[tuple[str, str], ...], int]:
    """Return what reading the logs warns of; if they are large, nothing, and how many bytes they have."""
    size = sum(file.stat().st_size for root in roots for file in root.rglob("*") if file.is_file())
    if size > READ_BYTES:
        return (), size
    cell = home / CELL_FILE
    found: list[tuple[str, str]] = []
    for root in roots:
        try:
            read = describe(root, cell=cell if cell.is_file() else None, follow_links=follow_links, progress=progress)
        except (ConfigError, LogError):  # a draft that cannot be read yet: `run` names what is wrong
            continue
        if isinstance(read, LogsDescription):
            found += [(_shown(log.path, root), text) for log in read.logs for text in log.warnings]
    return tuple(found), 0


def _shown(path: Path, home: Path) -> str:
    """Return a path as written in the project file: relative to its folder if it lies in it."""
    try:
        return path.resolve().relative_to(home.resolve()).as_posix()
    except ValueError:
        return str(path if path.is_absolute() else path.resolve())


def first_sequences(dataset: Dataset, project: Project) -> Path | None:
    """Write the sequence file of a project, with the order logged most often; None if there is one already.

    Raises:
        DatasetError: No complete execution was logged.
    """
    file = Path(project.sequences)
    if file.exists():
        return None
    sequence, count, of = first_sequence(dataset)
    head = f"# Written by cyclekit: order logged most often, in {count} of {of} complete executions. Add your own.\n"
    write_text(file, head + sequence_to_toml(sequence))
    return file


def first_jobs(dataset: Dataset, project: Project) -> Path | None:
    """Write the jobs file of a project: the work logged most often; None if there is one, or its order is not free.

    The order is taken as free if the robot did the same work in more than one: always from one place to another one,
    each visited once.
    """
    file = Path(project.jobs)
    if file.exists() or not dataset.positions:
        return None
    none = doubtful_places(dataset)
    logged = [one.places for one in dataset.card.executions if one.whole and not none & set(one.places)]
    works: dict[tuple[str, str, tuple[str, ...]], Counter[tuple[str, ...]]] = {}
    for places in logged:
        between, visits = set(places[1:-1:2]), places[2:-1:2]
        others = {*visits, places[0], places[-1]} if places else set()
        if len(between) == 1 and len(set(visits)) == len(visits) > 1 and not between & others:
            works.setdefault((places[0], places[-1], (*between, *sorted(visits))), Counter())[visits] += 1
    free = {work: orders for work, orders in works.items() if len(orders) > 1}
    if not free:
        return None
    start, end, (via, *slots) = most = max(free, key=lambda work: free[work].total())
    count = len(free[most])
    head = f"# Written by cyclekit: logged in {count} orders. Places that must come first: before = [[FIRST, THEN]]\n"
    lines = [f"{key} = {toml_value(value)}" for key, value in (("start", start), ("end", end), ("via", via))]
    write_text(file, head + "\n".join([*lines, f"visit = {toml_value(slots)}", ""]))
    return file


def first_sequence(dataset: Dataset) -> tuple[TaskSequence, int, int]:
    """Return the order of tasks logged most often, its count, and the number of complete executions.

    For a dataset of task lists alone the order is a plan for both agents.

    Raises:
        DatasetError: No complete execution was logged.
    """
    if dataset.holds_task_lists_alone:
        orders: list[Any] = _listed(dataset)
    else:
        orders = [one.places for one in dataset.card.executions if one.whole and len(one.places) > 1]
    if not orders:
        cure = "Log at least one execution from its start to its end."
        raise DatasetError(f"{dataset.place}: no complete execution in it, so no order was logged", cure=cure)
    none = doubtful_places(dataset) if dataset.positions else set[str]()
    ((order, count),) = Counter([order for order in orders if not none & set(order)] or orders).most_common(1)
    name = "usual order" if count > 1 else "a logged order"
    if dataset.holds_task_lists_alone:
        return TaskSequence.of_plan(name, [PlannedTask(agent, task) for agent, task in order]), count, len(orders)
    return TaskSequence(name, order), count, len(orders)


def _listed(dataset: Dataset) -> list[tuple[tuple[str, str], ...]]:
    """Return the tasks (agent, task) of each execution of a task list, ordered by start for each agent."""
    rows = dataset.every_task().drop_nulls("agent_name").sort("execution", "agent_name", "start_s")
    grouped = rows.group_by("execution", maintain_order=True).agg(pl.struct("agent_name", "task").alias("tasks"))
    return [tuple((one["agent_name"], one["task"]) for one in tasks) for tasks in grouped["tasks"].to_list()]
