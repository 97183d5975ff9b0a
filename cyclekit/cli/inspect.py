"""`cyclekit inspect`: describes a log, a folder of logs, a dataset or a model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import FollowLinks, Json, Quiet
from cyclekit.cli.terminal import Terminal, table
from cyclekit.errors import command_line
from cyclekit.text.numbers import counted, fixed
from cyclekit.text.plain_text import shown_task

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    history: Annotated[
        bool, typer.Option("--history", help="Of a dataset: what each agent did, and when each signal was on.")
    ] = False,
    execution: Annotated[
        list[str] | None,
        typer.Option(metavar="ID", help="With --history: an execution, or its number from 1; repeat for several."),
    ] = None,
    gantt: Annotated[
        Path | None, typer.Option(help="With --history: also draw a time chart here: SVG, PNG or PDF.")
    ] = None,
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
    if (execution or gantt) and not history:
        raise typer.BadParameter("--execution and --gantt go with --history")
    if history:
        _tell_history(path, execution or [], gantt, terminal)
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


def _tell_history(path: str, executions: Sequence[str], gantt: Path | None, terminal: Terminal) -> None:
    """Print what each agent did in the named executions; in the first one if none is named."""
    from cyclekit.api.inspect import logged_history

    with terminal.progress("reading"):
        found = logged_history(path, executions=executions, gantt=gantt)
    if gantt is not None:
        terminal.remark(f"written: {gantt}")
    tables = [] if terminal.json else found.rows.partition_by("execution", maintain_order=True)
    shown = tables if executions else tables[:1]
    head = ["agent", "activity", "begin s", "there", "ready", "end", "waited for"]
    times = ("begin_s", "there_s", "ready_s", "end_s")
    parts = [
        table(
            head,
            [
                [
                    row["agent"],
                    shown_task(row["activity"]),
                    *(fixed(row[name], 1) for name in times),
                    row["waited_for"] or "",
                ]
                for row in rows.iter_rows(named=True)
            ],
            title=rows["execution"][0],
        )
        for rows in shown
    ]
    if len(tables) > len(shown):
        more = counted(len(tables) - len(shown), "more execution")
        parts.append(f"{more}: --execution with a name or number shows one, --json all")
    terminal.answer(found.to_dict(), *(parts or ["no task is known"]))


def _give_cell(path: str, cell_file: Path | None, terminal: Terminal, *, follow_links: bool) -> None:
    """Print the drafted cell file, or write it to `cell_file` and print the next step."""
    from cyclekit.api.inspect import draft_cell

    draft = draft_cell(path, cell_file, follow_links=follow_links)
    sure = "to use it, type\n  "
    lines = "1 line is" if draft.unsure == 1 else f"{draft.unsure} lines are"
    doubt = f'{lines} not sure: look for "# ?" in it, then type\n  ' if draft.unsure else sure
    if cell_file is None:
        terminal.answer(draft.to_dict(), draft.cell.rstrip("\n"))
        return
    then = command_line("ingest", path, "--cell", cell_file, "--out", "dataset")
    terminal.done(draft.to_dict(), f"{cell_file}: written; {doubt}{then}")
