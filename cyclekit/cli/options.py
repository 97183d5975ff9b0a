"""The command line without commands, and the options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from cyclekit.text.durations import seconds_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.parallel.engine import Engine

Json = Annotated[bool, typer.Option("--json", help="One JSON document on standard output, all else on standard error.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no remarks; errors are still shown.")]
FollowLinks = Annotated[
    bool, typer.Option("--follow-links", help="Also follow links that lead out of a folder of logs.")
]
Extrapolate = Annotated[
    bool,
    typer.Option(
        "--extrapolate", help="Also estimate what is mostly outside of the logged data; such numbers are marked."
    ),
]
Checked = Annotated[bool, typer.Option("--check/--no-check", help="Validate on logged executions; correct the bias.")]

OtherCell = Annotated[
    bool, typer.Option("--other-cell", help="Accept a model of another cell, or with a large bias on these logs.")
]
DatasetPlace = Annotated[str, typer.Argument(help="Dataset: a folder or its URL.", metavar="DATASET")]
ModelPlace = Annotated[str, typer.Argument(help="Model: a folder or its URL.", metavar="MODEL")]
LoggedPlace = Annotated[
    str,
    typer.Option(
        "--dataset",
        metavar="DATASET",
        help="Dataset with the logged motions of the robot, and what the logs show of the operator.",
    ),
]
SequenceFile = Annotated[
    Path,
    typer.Argument(
        help="Sequence file: for each sequence its name and its places or tasks in order.", metavar="SEQUENCES.toml"
    ),
]
Takt = Annotated[
    str | None, typer.Option(metavar="TIME", help="Takt time, such as 105s or 1min 45s: compare the cycles with it.")
]
Baseline = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Sequence that the others are compared with; default: the logged executions."),
]
OperatorLog = Annotated[
    Path | None, typer.Option(help="Real tracker recording to use instead of the simulated operator.")
]
OperatorXyz = Annotated[
    str | None, typer.Option(metavar="X,Y,Z", help="Position of the recording's origin, base frame: x,y,z in m.")
]
OperatorYaw = Annotated[float, typer.Option(help="Rotation of the recording about the vertical, degrees.")]
EngineName = Annotated[
    Literal["local", "ray"],
    typer.Option(help="Where the jobs run: on this machine, or on a Ray cluster (docs/fleet.md)."),
]
Jobs = Annotated[int | None, typer.Option(min=1, help="Jobs at the same time; default: 1, with Ray one per core.")]
RayAddress = Annotated[
    str | None, typer.Option(help="Running Ray cluster; default: Ray on this machine.", metavar="auto|HOST:PORT")
]


def engine_of(name: Literal["local", "ray"], jobs: int | None, address: str | None) -> Engine:
    """Return the engine selected by the three options."""
    from cyclekit.parallel.engine import Engine

    if address is not None and name != "ray":
        raise typer.BadParameter("goes with --engine ray", param_hint="--ray-address")
    return Engine(name, jobs, address)


def new_app(tools: Sequence[str] = ()) -> typer.Typer:
    """Return the command line without commands; its help is plain text, the same in a terminal and in a file.

    Args:
        tools: Commands that its help lists below the others.
    """

    class Commands(TyperGroup):
        """Lists commands of every day first, tools below them."""

        def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - typer's own
            known = {name: command for name in self.list_commands(ctx) if (command := self.get_command(ctx, name))}
            for title, rest in (("Commands", False), ("Tools", True)):
                some = {name: command for name, command in known.items() if (name in tools) is rest}
                width = formatter.width - 6 - max(map(len, known), default=0)
                if some:
                    with formatter.section(title):
                        formatter.write_dl([(name, one.get_short_help_str(width)) for name, one in some.items()])

    frame = typer.Typer(
        name="cyclekit",
        cls=Commands,
        help=(
            "Cycle times of human-robot cells, estimated from their logs.\n\n"
            "Workflow: ingest logs, train a model on the dataset, estimate sequences; then report and replay. "
            "`init` and `run` take all these steps for a folder of logs."
        ),
        epilog=(
            "\b\nStart here:\n  cyclekit demo --out out/\n\n"
            "\b\nWith your own logs:\n  cyclekit init logs --takt 105s\n  cyclekit run"
        ),
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    frame.callback()(_first)
    return frame


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"cyclekit {version('cyclekit')}")
        raise typer.Exit


def _first(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def seconds(text: str) -> float:
    """Return a duration such as `14s`, `14`, `1min 45s` or `500ms` in seconds.

    Raises:
        typer.BadParameter: It is not a positive duration.
    """
    try:
        return seconds_in(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def whole_numbers(text: str) -> tuple[int, ...]:
    """Return whole numbers such as `1,2,3`, each once.

    Raises:
        typer.BadParameter: The text holds no whole numbers, or a negative one.
    """
    try:
        found = tuple(dict.fromkeys(int(word) for word in text.split(",")))
    except ValueError as error:
        msg = f"{text!r} are not whole numbers separated by commas"
        raise typer.BadParameter(msg) from error
    if min(found) < 0:
        raise typer.BadParameter("seeds are not negative")
    return found


def levels(text: str) -> tuple[float, ...]:
    """Return percentages such as `5,50,95` as ascending levels in (0, 1).

    Raises:
        typer.BadParameter: The text does not hold at least two numbers between 0 and 100.
    """
    try:
        found = tuple(sorted({float(part) / 100 for part in text.split(",")}))
    except ValueError as error:
        msg = f"{text!r} is not a list of percentages; write them as 5,50,95"
        raise typer.BadParameter(msg) from error
    if len(found) < 2 or not 0 < found[0] <= found[-1] < 1:
        msg = f"{text!r}: give two percentages or more, each between 0 and 100, such as 5,50,95"
        raise typer.BadParameter(msg)
    return found


def vector(text: str) -> tuple[float, float, float]:
    """Return `x,y,z` as three numbers, m.

    Raises:
        typer.BadParameter: The text does not hold three finite numbers.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        msg = f"{text!r} is not three numbers; write x,y,z in metres, such as 0.4,-1.2,0"
        raise typer.BadParameter(msg) from error
    if not all(abs(value) < float("inf") for value in (x, y, z)):
        msg = f"{text!r} is not three finite numbers"
        raise typer.BadParameter(msg)
    return x, y, z
