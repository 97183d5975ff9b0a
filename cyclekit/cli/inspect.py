"""`cyclekit inspect`: what a log, a folder of logs, a dataset or a model is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import FollowLinks, Json, Quiet
from cyclekit.cli.terminal import Terminal
from cyclekit.errors import OutputError, command_line

EXAMPLE = "cyclekit inspect logs --write-cell"


def inspect(
    path: Annotated[str, typer.Argument(help="A log, a folder of logs, a dataset or a model.", metavar="PATH")],
    cell_file: Annotated[
        Path | None, typer.Argument(help="With --write-cell: the new file to write it to.", metavar="[CELL.toml]")
    ] = None,
    cell: Annotated[
        Path | None, typer.Option(help="Cell file that says how logs are read; default: the one beside them.")
    ] = None,
    write_cell: Annotated[
        bool, typer.Option("--write-cell", help="Give the cell file that fits these logs; a draft for unknown tables.")
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
    from cyclekit.storage.remote.folders import local

    terminal = Terminal(json=json, quiet=quiet)
    if cell_file is not None and not write_cell:
        raise typer.BadParameter("CELL.toml goes with --write-cell")
    if write_cell:
        _give_cell(local(path), cell_file, terminal, follow_links=follow_links)
        return
    checked = _verified(path, terminal) if verify else None
    from cyclekit.cli.facts import page
    from cyclekit.inspect.describe import describe

    with terminal.progress("looking") as progress:
        found = describe(local(path), cell=cell, progress=progress, follow_links=follow_links)
    if checked is None:
        terminal.answer(found.to_json(), page(found))
    else:
        terminal.answer({**found.to_json(), "verified": checked}, page(found), f"{checked} files, all as written")


def _give_cell(path: Path, cell_file: Path | None, terminal: Terminal, *, follow_links: bool) -> None:
    """Print the cell file, or write it where none is, and say what to do next."""
    from cyclekit.config import cell_to_toml
    from cyclekit.ingest.discover import suggest_cell
    from cyclekit.storage.outputs import check_writable

    if cell_file is not None:
        _require_new(cell_file)
        check_writable(cell_file)
    suggested = suggest_cell([path], follow_links=follow_links)
    text = cell_to_toml(suggested.cell, suggested.drafts)
    unsure = sum(draft.unsure for draft in suggested.drafts.values())
    doubt = f'{unsure} lines are not sure: look for "# ?" in it, then type\n  ' if unsure else "to use it, type\n  "
    if cell_file is None:
        terminal.answer({"cell": text, "unsure": unsure}, text.rstrip("\n"))
        return
    from cyclekit.storage.atomic import write_text

    write_text(cell_file, text)
    then = command_line("ingest", path, "--cell", cell_file, "--out", "dataset")
    terminal.done({"cell": text, "unsure": unsure, "out": str(cell_file)}, f"{cell_file}: written; {doubt}{then}")


def _require_new(file: Path) -> None:
    if file.exists() or file.is_symlink():
        cure = "Give another name; what is in it may be of a person's hand."
        raise OutputError(f"{file}: exists, and a cell file is never replaced", cure=cure)


def _verified(path: str, terminal: Terminal) -> int:
    """Check a dataset, and return how many files it has."""
    from cyclekit.dataset.dataset import Dataset

    with terminal.progress("checking"):
        return Dataset.open(path).verify()
