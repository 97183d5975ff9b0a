"""`cyclekit run`: brings a project up to date."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.groups import regrouped
from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, table

if TYPE_CHECKING:
    from cyclekit.fleet.project import ProjectRun

EXAMPLE = "cyclekit run"
SHOWN = 8
"""Maximum number of warnings in the terminal."""


def run(
    project: Annotated[Path, typer.Argument(help="Project file, or its folder.", metavar="cyclekit.toml")] = Path(
        "cyclekit.toml"
    ),
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Bring a project up to date: ingest, train, estimate, report.

    Repeats only the steps whose inputs changed. A failed step is reported, and the others continue if possible; the
    exit code is then 1.
    """
    from cyclekit.fleet.project import run_project

    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("running") as progress:
        found = run_project(project, progress=progress)
    warned = regrouped(found.warnings)
    terminal.warnings(warned[:SHOWN])
    if len(warned) > SHOWN:
        terminal.remark(f"{len(warned) - SHOWN} more warnings: cyclekit inspect {found.project.dataset}")
    for row in found.failed:
        terminal.remark(f"failed: {row.stage}: {row.text}")
    terminal.done(found.to_dict(), _said(found))
    return 1 if found.failed else 0


def _said(found: ProjectRun) -> str:
    rows = [[row.stage, row.state, row.text.partition("\n")[0]] for row in found.rows]
    page = "" if found.failed else f"\n{found.project.report}: open it in any browser"
    return table(["step ", "state ", "what and why "], rows) + page
