"""`cyclekit convert`: converts one log to one table, for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal

EXAMPLE = "cyclekit convert logs/session_000/robot.csv --out robot.parquet --rate 10"


def convert(
    log: Annotated[Path, typer.Argument(help="A log: a file, or a folder that is one log.", metavar="LOG")],
    out: Annotated[Path, typer.Option(help="The table, .parquet or .csv.", metavar="FILE")],
    table: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="robot, people, events, task_list, safety, skeletons; default: the first one in the log.",
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Rows per second, averaged; default: every row.", metavar="HZ")
    ] = None,
    columns: Annotated[
        str, typer.Option(metavar="LIST", help="Columns to write, separated by commas; default: all.")
    ] = "",
    cell: Annotated[Path | None, typer.Option(help="Cell file with the settings for reading the log.")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write one table of a log as Parquet or CSV.

    In SI units, in the log's own clock and frame. For use in other tools; to make a dataset, use `ingest`.
    """
    from cyclekit.api.convert import convert_log

    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("converting") as progress:
        done = convert_log(
            log,
            out,
            table=table,
            rate_hz=rate,
            columns=[name.strip() for name in columns.split(",") if name.strip()],
            cell=cell,
            progress=progress,
        )
    terminal.warnings(done.warnings)
    aside = f", {done.rows_set_aside} of {done.rows_read} set aside" if done.rows_set_aside else ""
    terminal.done(done.to_dict(), f"{done.out}: {done.rows} rows of {done.table}, read by {done.adapter}{aside}")
