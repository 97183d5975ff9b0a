"""`cyclekit fleet`: many cells, from logs to reports, by one command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cyclekit.cli.options import EngineName, Jobs, Json, Quiet, RayAddress, engine_of
from cyclekit.cli.terminal import Terminal, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.fleet import Row

EXAMPLE = "cyclekit fleet all fleet.toml --jobs 4"
MOST = 20
"""Cells named one by one; of more, only what failed is."""


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
    """Work on what is new of every cell of a fleet.

    WHAT is ingest, train, report or all. What fails in a cell is told and the others go on; then the exit code is 1.
    """
    from cyclekit.dataset.guard import check_output
    from cyclekit.fleet import STAGES, load_fleet, run_fleet
    from cyclekit.learning.training import need_torch
    from cyclekit.storage.remote.folders import join

    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    wanted, stages = load_fleet(file), tuple(STAGES) if what == "all" else (what,)
    check_output(wanted.out, "folder", [file])
    if "train" in stages:
        need_torch()
    with terminal.progress(f"fleet {what}") as progress:
        rows = run_fleet(wanted, stages, engine=work, progress=progress)
    failed = [row for row in rows if row.state == "failed"]
    for row in failed:
        terminal.remark(f"failed: {row.cell}: {row.stage}: {row.text}")
    page = join(wanted.out, "index.html") if "report" in stages else None
    document = {"fleet": wanted.name, "failed": len(failed), "page": page, "rows": [vars(row) for row in rows]}
    terminal.done(document, summary(rows, stages, page))
    return 1 if failed else 0


def summary(rows: Sequence[Row], stages: Sequence[str], page: str | None) -> str:
    """Return how many cells went through each stage, and where the page is."""
    states = ("done", "unchanged", "skipped", "failed")
    counts = [
        [stage, *(str(sum((row.stage, row.state) == (stage, state) for row in rows)) for state in states)]
        for stage in stages
    ]
    parts = [table(["cells ", *states], counts)]
    if len({row.cell for row in rows}) <= MOST:
        parts.insert(0, "\n".join(f"{row.cell}: {row.stage} {row.state}: {_short(row.text)}" for row in rows))
    return "\n\n".join([*parts, *([f"{page}: open it in any browser"] if page else [])])


def _short(text: str) -> str:
    return text.partition("\n")[0]
