"""`cyclekit fleet`: processes many cells, from logs to reports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cyclekit.cli.options import EngineName, Jobs, Json, Quiet, RayAddress, engine_of
from cyclekit.cli.terminal import Terminal, table

if TYPE_CHECKING:
    from cyclekit.fleet import FleetRun

EXAMPLE = "cyclekit fleet all fleet.toml --jobs 4"
MAX_LISTED = 20
"""Maximum number of cells listed one by one; of more, only failures are listed."""


def fleet(
    what: Annotated[
        Literal["ingest", "train", "report", "all"], typer.Argument(help="Which step, or all of them.", metavar="WHAT")
    ],
    file: Annotated[Path, typer.Argument(help="Fleet file: cells with their sources.", metavar="FLEET.toml")],
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Process the new logs of every cell of a fleet.

    WHAT is ingest, train, report or all. A failed cell is reported and the others continue; the exit code is then 1.
    """
    from cyclekit.fleet import run_fleet

    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    with terminal.progress(f"fleet {what}") as progress:
        found = run_fleet(file, what, engine=work, progress=progress)
    for row in found.failed:
        terminal.remark(f"failed: {row.cell}: {row.stage}: {row.text}")
    terminal.done(found.to_dict(), summary(found))
    return 1 if found.failed else 0


def summary(found: FleetRun) -> str:
    """Return the number of cells that passed each stage, and the path of the page."""
    rows, page = found.rows, found.page
    stages = list(dict.fromkeys(row.stage for row in rows))
    states = ("done", "unchanged", "skipped", "failed")
    counts = [
        [stage, *(str(sum((row.stage, row.state) == (stage, state) for row in rows)) for state in states)]
        for stage in stages
    ]
    parts = [table(["cells ", *states], counts)]
    if len({row.cell for row in rows}) <= MAX_LISTED:
        parts.insert(0, "\n".join(f"{row.cell}: {row.stage} {row.state}: {_short(row.text)}" for row in rows))
    return "\n\n".join([*parts, *([f"{page}: open it in any browser"] if page else [])])


def _short(text: str) -> str:
    return text.partition("\n")[0]
