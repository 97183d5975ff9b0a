"""`cyclekit replay`: writes executions as a Rerun recording, in 3-D and over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import DatasetPlace, Json, OtherCell, Quiet, seconds
from cyclekit.cli.terminal import Terminal, table
from cyclekit.errors import command_line
from cyclekit.text.numbers import duration, fixed, megabytes, whole_percent

if TYPE_CHECKING:
    from cyclekit.replay import Miss, ReplayFacts
    from cyclekit.replay.layout import Focus

EXAMPLE = "cyclekit replay dataset --execution 1 --out replay.rrd"


def replay(
    dataset: DatasetPlace,
    execution: Annotated[
        list[str],
        typer.Option(help="Name of the execution, or its number from 1; repeat for several.", metavar="ID"),
    ],
    out: Annotated[Path, typer.Option(help="Recording to write (.rrd).")],
    model: Annotated[
        str | None, typer.Option(metavar="MODEL", help="Model whose prediction and learned zones are also shown.")
    ] = None,
    at: Annotated[
        str,
        typer.Option(
            metavar="WHAT", help="What plays first: slowdown (the costliest), error (the model's worst), or a time."
        ),
    ] = "slowdown",
    open_after: Annotated[bool, typer.Option("--open", help="Open the recording in the Rerun viewer.")] = False,
    serve_after: Annotated[
        bool, typer.Option("--serve", help="Serve it to a browser on this machine, until Ctrl-C.")
    ] = False,
    bind: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Address of --serve; any other than this one shows the recording to everybody who can reach it.",
        ),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of --serve; 0 takes a free one.")] = 9090,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a Rerun recording of one or several executions.

    Shows robot, operator, places and speed scaling, in 3-D and over time; with the prediction of a model if given.
    """
    from cyclekit.api.replay import write_replay
    from cyclekit.replay import open_viewer, serve

    terminal = Terminal(json=json, quiet=quiet)
    focus = _focus(at)
    with terminal.progress("replaying") as progress:
        facts = write_replay(dataset, execution, out, model=model, at=focus, other_cell=other_cell, progress=progress)
    terminal.warnings(facts.notes)
    terminal.done(facts.to_dict(), _said(facts))
    if open_after:
        open_viewer(out, facts.first)
    if serve_after:
        with serve(out, bind=bind, port=port) as server:
            terminal.remark(f"open in a browser, until Ctrl-C: {server.address}")
            server.serve_forever()


def _focus(at: str) -> Focus:
    if at == "slowdown":
        return "slowdown"
    if at == "error":
        return "error"
    try:
        return seconds(at)
    except typer.BadParameter as error:
        msg = f"{at!r} is neither slowdown nor error, and {error.message}"
        raise typer.BadParameter(msg, param_hint="--at") from error


def _said(facts: ReplayFacts) -> str:
    names = " and ".join(facts.executions)
    many = "execution" if len(facts.executions) == 1 else "executions"
    head = f"{facts.path}: {many} {names}, {duration(facts.duration_s)}, {megabytes(facts.bytes)}"
    parts = [head, _worst(facts.misses), f"next: {command_line(facts.path, program='rerun')}"]
    return "\n".join(part for part in parts if part)


def _worst(misses: tuple[Miss, ...]) -> str:
    """Return a table of the largest differences between prediction and log; empty without a model."""
    if not misses:
        return ""
    rows = [
        [
            f"{fixed(miss.t_s, 1)} s",
            whole_percent(miss.logged),
            whole_percent(miss.predicted),
            f"{fixed(miss.seconds, 1)} s",
            f"{fixed(miss.distance_m, 2)} m",
            miss.robot_task or "",
        ]
        for miss in misses[:5]
    ]
    heads = ["at", "logged", "predicted", "off by", "distance", "robot task "]
    return table(heads, rows, title="Where model and log differ most (open there: --at error)")
