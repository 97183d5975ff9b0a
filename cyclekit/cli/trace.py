"""`cyclekit trace`: shows the lines of the logs from which a sample was made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cyclekit.cli.options import DatasetPlace, Json, Quiet, seconds
from cyclekit.cli.terminal import Terminal
from cyclekit.text.numbers import fixed, given

if TYPE_CHECKING:
    from cyclekit.dataset.trace import Trace

EXAMPLE = "cyclekit trace dataset --execution 1 --at 12.5s --logs logs"


def trace(
    dataset: DatasetPlace,
    execution: Annotated[str, typer.Option(help="Name of the execution, or its number from 1.", metavar="ID")],
    at: Annotated[
        str,
        typer.Option(
            help="Time since the execution began: 12.5s, 2min; default: its start.",
            metavar="TIME",
            show_default=False,
        ),
    ] = "1ms",
    logs: Annotated[
        Path | None, typer.Option(help="Folder of the logs, or the log itself, to show the lines.", metavar="LOGS")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show the lines of the logs that a sample was made from.

    For the robot its row of the log, for people and events the rows before and after.
    """
    at_s = seconds(at)
    from cyclekit.api.trace import trace_sample

    terminal = Terminal(json=json, quiet=quiet)
    found = trace_sample(dataset, execution, at_s, logs=logs)
    terminal.answer(found.to_dict(), page(found))


def page(found: Trace) -> str:
    """Return a sample and its source lines as text."""
    lines = [f"execution {found.execution}, sample at {_shown(found.sample['t_s'])} s of its session"]
    lines += [f"  {name}: {_shown(value)}" for name, value in found.sample.items() if name not in ("execution", "t_s")]
    for origin in found.origins:
        among = f" of {origin.among}" if origin.among else ""
        place = f"{origin.row_is} {origin.source_row}{among}" if origin.source_row is not None else "no row"
        lines.append(f"{origin.table}: {origin.file}, {place}, {fixed(origin.t_s, 3)} s")
        if origin.text is not None:
            lines.append(f"  {origin.text[:400]}")
        else:
            lines += [f"  {name}: {_shown(value)}" for name, value in origin.values.items()]
    return "\n".join(lines)


def _shown(value: Any) -> str:  # noqa: ANN401 - whatever a table holds
    return given(value) if isinstance(value, float) else str(value)
