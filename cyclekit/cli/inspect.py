"""`cyclekit inspect`: describes a log, a folder of logs, a dataset or a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import FollowLinks, Json, Quiet
from cyclekit.cli.terminal import Terminal
from cyclekit.errors import command_line

EXAMPLE = "cyclekit inspect logs --write-cell"


def inspect(
    path: Annotated[str, typer.Argument(help="A log, a folder of logs, a dataset or a model.", metavar="PATH")],
    cell_file: Annotated[
        Path | None, typer.Argument(help="With --write-cell: the new file to write it to.", metavar="CELL.toml")
    ] = None,
    cell: Annotated[
        Path | None, typer.Option(help="Cell file with settings for the logs; default: cell.toml next to them.")
    ] = None,
    write_cell: Annotated[
        bool, typer.Option("--write-cell", help="Print a cell file for these logs; a draft for unknown tables.")
    ] = False,
    sequences: Annotated[
        Path | None,
        typer.Option(
            metavar="SEQUENCES.toml", help="Of a dataset: also what to log so that these sequences can be estimated."
        ),
    ] = None,
    follow_links: FollowLinks = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="Check that every file of a dataset is as it was written.")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Describe a log, a folder of logs, a dataset or a model.

    Logs: format, columns, rate, duration, gaps, warnings. Dataset: executions, places, tasks, where the time goes.
    Model: how it was trained and how well it predicts.
    """
    terminal = Terminal(json=json, quiet=quiet)
    if cell_file is not None and not write_cell:
        raise typer.BadParameter("CELL.toml goes with --write-cell")
    if write_cell:
        _give_cell(path, cell_file, terminal, follow_links=follow_links)
        return
    from cyclekit.api.inspect import inspect_logs
    from cyclekit.cli.facts import page
    from cyclekit.inspect.facts import DatasetDescription

    with terminal.progress("looking") as progress:
        found = inspect_logs(
            path, cell=cell, sequences=sequences or (), follow_links=follow_links, verify=verify, progress=progress
        )
    checked = found.verified if isinstance(found, DatasetDescription) else None
    whole = "" if checked is None else f"{checked} files, all as written"
    terminal.answer(found.to_dict(), page(found), whole)


def _give_cell(path: str, cell_file: Path | None, terminal: Terminal, *, follow_links: bool) -> None:
    """Print the drafted cell file, or write it to `cell_file` and print the next step."""
    from cyclekit.api.inspect import draft_cell

    draft = draft_cell(path, cell_file, follow_links=follow_links)
    sure = "to use it, type\n  "
    doubt = f'{draft.unsure} lines are not sure: look for "# ?" in it, then type\n  ' if draft.unsure else sure
    if cell_file is None:
        terminal.answer(draft.to_dict(), draft.cell.rstrip("\n"))
        return
    then = command_line("ingest", path, "--cell", cell_file, "--out", "dataset")
    terminal.done(draft.to_dict(), f"{cell_file}: written; {doubt}{then}")
