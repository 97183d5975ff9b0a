"""The project file (cyclekit.toml): paths of the logs, the dataset, the model and the results of one cell.

Commands run in its folder take missing arguments from it; `cyclekit run` updates all of it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from cyclekit.config.cells import AlignClocks
from cyclekit.config.toml_file import read_toml, to_dataclass
from cyclekit.config.write import toml_value
from cyclekit.errors import ConfigError
from cyclekit.storage.files import resolved
from cyclekit.storage.remote.folders import from_folder
from cyclekit.text.durations import seconds_in

PROJECT_FILE = "cyclekit.toml"
_Text = Annotated[str, Meta(min_length=1)]


@dataclass(frozen=True)
class Project:
    """One cell: its logs and its results; paths are relative to the folder of the file, or URLs.

    Attributes:
        logs: Files and folders of logs.
        name: Title of the report; empty: the name of the folder.
        cell: Cell file; None: the one in the folder of the logs.
        align_clocks: As in the cell file, which it overrides.
        pseudonymise, follow_links: As the options of `ingest`.
        dataset: Folder of the dataset.
        model: Folder of the model.
        sequences: Sequence file to estimate.
        jobs: Jobs file for `plan`, and for the report if it exists.
        changes: File of changes that the report prices, if it exists.
        takt: Takt time, such as `105s`.
        baseline: Name of the sequence with which the others are compared.
        estimates: File of the estimates, `.json`, `.csv` or `.xlsx`.
        report: File of the report.
        template: Folder with the template of the report.
    """

    logs: Annotated[tuple[_Text, ...], Meta(min_length=1, examples=[["logs"]])]
    name: str = ""
    cell: _Text | None = None
    align_clocks: AlignClocks | None = None
    pseudonymise: bool = False
    follow_links: bool = False
    dataset: _Text = "dataset"
    model: _Text = "model"
    sequences: _Text = "sequences.toml"
    jobs: _Text = "jobs.toml"
    changes: _Text = "changes.toml"
    takt: Annotated[str | None, Meta(examples=["105s"])] = None
    baseline: _Text | None = None
    estimates: _Text = "estimates.json"
    report: _Text = "report.html"
    template: _Text | None = None

    @property
    def takt_s(self) -> float | None:
        """The takt time in seconds; None without one."""
        return None if self.takt is None else seconds_in(self.takt)


def load_project(path: Path) -> Project:
    """Read a project file; its paths are returned relative to the working directory.

    Args:
        path: The file, or its folder.

    Raises:
        ConfigError: The file cannot be read, a value is of the wrong type, or the takt time is not a duration.
        UnknownName: A key is unknown.
    """
    file = path / PROJECT_FILE if path.is_dir() else path
    if not file.exists():
        raise ConfigError(f"{file}: no such project file", cure="Make one: cyclekit init FOLDER_OF_LOGS")
    told = to_dataclass(str(file), read_toml(file), Project)
    try:
        _ = told.takt_s
    except ValueError as error:
        raise ConfigError(f"{file}: takt: {error}", cure='takt = "105s"') from error
    places = {key: from_folder(file.parent, getattr(told, key)) for key in _PLACES if getattr(told, key) is not None}
    name = told.name or resolved(file).parent.name
    logs = tuple(from_folder(file.parent, each) for each in told.logs)
    return replace(told, **places, name=name, logs=logs)  # type: ignore[arg-type]  # the names are those of the fields


_PLACES = ("cell", "dataset", "model", "sequences", "jobs", "changes", "estimates", "report", "template")
_SAID = {
    "logs": "files and folders of logs",
    "name": "title of the report; else the name of this folder",
    "cell": "what the logs do not contain; default: cell.toml in the folder of the logs, if it exists",
    "align_clocks": "align clocks by what the logs show, also in doubt and against what is stated (docs/clocks.md)",
    "pseudonymise": "keep no track ids and no wall-clock time (docs/privacy.md)",
    "dataset": "made by ingest",
    "model": "made by train",
    "sequences": "the orders whose cycle time is estimated",
    "jobs": "the work whose order plan and report search; run drafts it where the logs show that the order is free",
    "changes": "changes of the cell that the report prices, if this file exists (docs/commands.md)",
    "takt": "takt time: the time in which a part is needed",
    "baseline": "the sequence that others are compared with; else the logged executions",
    "estimates": ".json, .csv or .xlsx",
    "report": "the page for the customer",
    "template": "folder with your logo and look (docs/report.md)",
}


def project_to_toml(project: Project) -> str:
    """Return the text of a project file for this project, with a comment on each key; unset keys are commented out."""
    lines = ["# Written by cyclekit init; paths are relative to this folder. Update all results: cyclekit run"]
    for each in fields(project):
        value = getattr(project, each.name)
        told = f"  # {_SAID[each.name]}" if each.name in _SAID else ""
        if value:
            lines.append(f"{each.name} = {toml_value(list(value) if isinstance(value, tuple) else value)}{told}")
        elif each.name in _SAID:
            lines.append(f"# {each.name} = {toml_value(_EXAMPLES[each.name])}{told}")
    return "\n".join(lines) + "\n"


_EXAMPLES = {
    "name": "cell 4",
    "cell": "cell.toml",
    "align_clocks": "logs",
    "pseudonymise": True,
    "takt": "105s",
    "baseline": "left table first",
    "template": "look",
}
