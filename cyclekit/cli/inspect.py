"""`cyclekit inspect`: what a log, a folder of logs, a dataset or a model is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import FollowLinks, Json, Quiet
from cyclekit.cli.terminal import Terminal

EXAMPLE = "cyclekit inspect logs --write-cell"


def inspect(
    path: Annotated[str, typer.Argument(help="A log, a folder of logs, a dataset or a model.", metavar="PATH")],
    cell: Annotated[
        Path | None, typer.Option(help="Cell file that says how logs are read; default: the one beside them.")
    ] = None,
    write_cell: Annotated[
        bool, typer.Option("--write-cell", help="Print the cell file that fits these logs, and nothing else.")
    ] = False,
    follow_links: FollowLinks = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="Check that every file of a dataset is as it was written.")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say what a log, a folder of logs, a dataset or a model is.

    Adapter, rate, duration, columns, executions, places and tasks found, scaling levels, gaps, warnings.
    """
    from cyclekit.storage import local

    terminal = Terminal(json=json, quiet=quiet)
    if write_cell:
        from cyclekit.config import cell_to_toml
        from cyclekit.discover import suggest_cell

        text = cell_to_toml(suggest_cell([local(path)], follow_links=follow_links))
        terminal.answer({"cell": text}, text.rstrip("\n"))
        return
    checked = _verified(path, terminal) if verify else None
    from cyclekit.cli.facts import page
    from cyclekit.describe import describe

    with terminal.progress("looking") as progress:
        found = describe(local(path), cell=cell, progress=progress, follow_links=follow_links)
    if checked is None:
        terminal.answer(found.to_json(), page(found))
    else:
        terminal.answer({**found.to_json(), "verified": checked}, page(found), f"{checked} files, all as written")


def _verified(path: str, terminal: Terminal) -> int:
    """Check a dataset, and return how many files it has."""
    from cyclekit.dataset import Dataset

    with terminal.progress("checking"):
        return Dataset.open(path).verify()
