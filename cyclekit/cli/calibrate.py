"""`cyclekit calibrate`: computes the pose of the tracker from points touched by robot and tracker."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, table
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from cyclekit.alignment.calibrate import Calibration

EXAMPLE = "cyclekit calibrate points.csv --up y"


def calibrate(
    points: Annotated[Path, typer.Argument(help="Table of points (CSV).", metavar="POINTS")],
    up: Annotated[Literal["y", "z"], typer.Option(help="Axis that points up in the tracker.")] = "z",
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the pose of the tracker from points.

    Robot and tracker have touched the same points. The table has the columns log_x_m, log_y_m, log_z_m (tracker) and
    base_x_m, base_y_m, base_z_m (robot base); _mm for millimetres. Prints the line for cell.toml, and the error of each
    point.
    """
    from cyclekit.api.calibrate import calibrate_tracker

    terminal = Terminal(json=json, quiet=quiet)
    found = calibrate_tracker(points, up=up)
    terminal.warnings(found.fit.warnings)
    terminal.answer(found.to_dict(), page(found))


def page(found: Calibration) -> str:
    """Return the residuals as a table, and the line for the cell file."""
    residuals = zip(found.points, found.fit.residual_m.tolist(), strict=True)
    rows = [[name, fixed(1000 * far, 1)] for name, far in residuals] + [["rms", fixed(1000 * found.fit.rms_m, 1)]]
    return f"{table(['point ', 'off by, mm'], rows)}\n\n{found.line}"
