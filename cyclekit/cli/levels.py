"""`cyclekit levels`: the staircase in a dataset's speed scaling, found by a method of your choice."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cyclekit.cli.options import DatasetPlace, Json, Quiet
from cyclekit.cli.terminal import Terminal, percent, table

if TYPE_CHECKING:
    from cyclekit.scaling.levels import Staircase

EXAMPLE = "cyclekit levels dataset --picture levels.svg"
Method = Literal["plateau", "dbscan", "kmeans-silhouette", "kmeans-elbow", "hdbscan", "gmm-bic"]


def levels(
    dataset: DatasetPlace,
    method: Annotated[Method, typer.Option(help="How levels are found; plateau looks at the order in time.")] = (
        "plateau"
    ),
    picture: Annotated[Path | None, typer.Option(help="Also draw them: a .svg, .png or .pdf file.")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the levels of the speed scaling: how many, at which values.

    Each execution is looked at for itself, never across a gap. Levels fixed in the cell file are only counted.
    """
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.dataset.guard import check_output
    from cyclekit.learning.labelling import scaling_in_time, staircase_of
    from cyclekit.scaling.levels import second_opinion

    terminal = Terminal(json=json, quiet=quiet)
    check_output(picture, "picture", [dataset], option="--picture", endings=(".svg", ".png", ".pdf"))
    with terminal.progress("looking for levels"):
        opened = Dataset.open(dataset)
        opened.require_positions()
        frame = opened.samples(columns=["execution", "t_s", "scaling"])
        found = staircase_of(opened, frame, method)
        values, _ = scaling_in_time(frame, opened.rate_hz)
        other = second_opinion(values, found) if method == "plateau" else None
        if picture is not None:
            from cyclekit.plots.levels import draw_levels

            draw_levels(picture, values, found, rate_hz=opened.rate_hz)
    terminal.warnings([*found.warnings, *([other] if other else [])])
    document = {
        "method": method,
        "count": int(found.levels.size),
        "levels": [float(level) for level in found.levels],
        "means": [] if found.means is None else [float(mean) for mean in found.means],
        "share": [float(share) for share in found.share],
        "noise": found.noise,
        "is_staircase": found.is_staircase,
        "picture": None if picture is None else str(picture),
    }
    terminal.answer(document, _page(found, method))


def _page(found: Staircase, method: str) -> str:
    means = found.levels if found.means is None else found.means
    rows = [
        [f"{level:.4g}", f"{mean:.4f}", percent(float(share))]
        for level, mean, share in zip(found.levels, means, found.share, strict=True)
    ]
    moving = 1 - float(found.share.sum())
    head = f"P = {found.levels.size} levels by {method}; {percent(moving)} of the samples in transition or unknown"
    return f"{head}\n\n{table(['level ', 'mean', 'of the time'], rows)}"
