"""`cyclekit levels`: finds the levels of a dataset's speed scaling by the chosen method."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import DatasetPlace, Json, Quiet
from cyclekit.cli.terminal import Terminal, bullet, table
from cyclekit.text.numbers import compact, fixed, percent

if TYPE_CHECKING:
    from cyclekit.api.levels import ScalingLevels

EXAMPLE = "cyclekit levels dataset --picture levels.svg"


def levels(
    dataset: DatasetPlace,
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="plateau (values held over time); dbscan or kmeans-silhouette (values only)."
        ),
    ] = "plateau",
    picture: Annotated[Path | None, typer.Option(help="Also draw them: a .svg, .png or .pdf file.")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the levels of the speed scaling.

    Each execution is searched separately, never across a gap. Levels set in the cell file are only counted.
    """
    from cyclekit.api.levels import find_levels

    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("looking for levels"):
        found = find_levels(dataset, method=method, picture=picture)
    terminal.warnings(found.warnings)
    terminal.answer(found.to_dict(), _page(found))


def _page(found: ScalingLevels) -> str:
    means = found.means or found.levels
    rows = [
        [compact(level, 4), fixed(mean, 4), percent(share)]
        for level, mean, share in zip(found.levels, means, found.share, strict=True)
    ]
    moving = 1 - sum(found.share)
    transition = f"{percent(moving)} of the samples in transition or unknown"
    head = bullet([f"P = {len(found.levels)} levels by {found.method}; {transition}"], mark="")
    return f"{head}\n\n{table(['level ', 'mean', 'of the time'], rows)}"
