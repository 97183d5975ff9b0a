"""Points touched by robot and tracker -> pose of the tracker, as the `frame` of its source in the cell file.

Move the robot's tool to four or more places well apart, put the tracker's marker there, and write both positions into
a table: `log_x_m, log_y_m, log_z_m, base_x_m, base_y_m, base_z_m` (or `…_mm`), one row per place, optionally with its
name in `point`. The fit is in `frames`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import polars as pl

from cyclekit.alignment.frames import FrameFit, fit_frame
from cyclekit.errors import DamagedLog, LogError, MissingColumns
from cyclekit.parallel.one_thread import one_thread
from cyclekit.text.numbers import fixed
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from cyclekit.config import Frame
    from cyclekit.schema import Floats

SIDES = ("log", "base")
UNITS = {"m": 1.0, "mm": 0.001}


@dataclass(frozen=True, repr=False)
class Calibration(Result):
    """A fitted frame and its points.

    Attributes:
        path: The file of the points.
        points: Name of each point, in order of the file.
        fit: Frame, residual of each point and rms, m.
        up: Axis that points up in the tracker's frame.
    """

    path: Path
    points: tuple[str, ...]
    fit: FrameFit
    up: Literal["y", "z"]

    @property
    def line(self) -> str:
        """The line for the tracker's source in cell.toml."""
        return frame_line(self.fit.frame)

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        frame = self.fit.frame
        residuals = zip(self.points, self.fit.residual_m.tolist(), strict=True)
        return {
            "path": str(self.path),
            "up": self.up,
            "frame": {"xyz_m": list(frame.xyz_m), "rotation": [list(row) for row in frame.rotation]},
            "line": self.line,
            "points": [{"point": name, "residual_m": far} for name, far in residuals],
            "rms_m": self.fit.rms_m,
            "scale": self.fit.scale,
            "warnings": list(self.fit.warnings),
        }

    def to_frame(self) -> pl.DataFrame:
        """Return one row per point with its residual, m."""
        return pl.DataFrame({"point": list(self.points), "residual_m": self.fit.residual_m.tolist()})

    def _lines(self) -> list[str]:
        return [f"{len(self.points)} points, rms {fixed(1000 * self.fit.rms_m, 1)} mm", self.line]


@one_thread()
def calibrate(points: Path | str, *, up: Literal["y", "z"] = "z") -> Calibration:
    """Fit the pose of a tracker to points that robot and tracker both touched.

    Args:
        points: CSV with a header: `log_x_m`, `log_y_m`, `log_z_m` in the tracker's axes, `base_x_m`, `base_y_m`,
            `base_z_m` in the robot base frame; `_mm` instead of `_m` for millimetres. Comma, semicolon or tab.
        up: Axis that points up in the tracker's frame ("y" by default in Motive).

    Raises:
        LogError: The file cannot be read; MissingColumns, DamagedLog: it is not such a table.
        ConfigError: The points do not determine a frame: too few, on one line, in different units, mirrored.
    """
    path = Path(points)
    table = _read(path)
    log_m, base_m = (_points(path, table, side) for side in SIDES)
    names = table["point"].to_list() if "point" in table.columns else []
    named = [name or str(row) for row, name in enumerate(names, 1)] or [str(row + 1) for row in range(len(log_m))]
    return Calibration(path, tuple(named), fit_frame(log_m, base_m, up=up), up)


def frame_line(frame: Frame) -> str:
    """Return a frame as a line of cell.toml: position to 0.1 mm, yaw to 0.0001 deg or rotation to 8 decimals."""
    xyz = ", ".join(f"{_rounded(value):.4f}" for value in frame.xyz_m)
    rotation = np.array(frame.rotation)
    if abs(rotation[2, 2] - 1) < 1e-9:
        yaw = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))
        return f"frame = {{ xyz_m = [{xyz}], yaw_deg = {_rounded(yaw):.4f} }}"
    rows = ", ".join("[" + ", ".join(f"{value:.8f}" for value in row) + "]" for row in frame.rotation)
    return f"frame = {{ xyz_m = [{xyz}], rotation = [{rows}] }}"


def _rounded(value: float) -> float:
    """Return a value as `frame_line` shows it; never -0."""
    return round(float(value), 4) + 0.0


def _read(path: Path) -> pl.DataFrame:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise LogError(path, f"cannot be read ({error.strerror or error})", cure="Check the path.") from error
    except UnicodeDecodeError as error:
        raise DamagedLog(path, "is not text in UTF-8", cure="Save the table as CSV.") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise DamagedLog(path, "is empty", cure="Write a header and one row per point.")
    separator = max(",;\t", key=lines[0].count)
    cells = [[cell.strip() for cell in line.split(separator)] for line in lines]
    for number, row in enumerate(cells[1:], 2):
        if len(row) != len(cells[0]):
            cause = f"line {number} has {len(row)} cells, the header {len(cells[0])}"
            raise DamagedLog(path, cause, cure="Give every point a value in every column, with decimal points.")
    if len(set(cells[0])) < len(cells[0]):
        raise DamagedLog(path, "two columns have one name", cure="Remove one of them.")
    return pl.DataFrame(cells[1:], schema=dict.fromkeys(cells[0], pl.String()), orient="row")


def _points(path: Path, table: pl.DataFrame, side: str) -> Floats:
    unit = "mm" if f"{side}_x_mm" in table.columns else "m"
    wanted = [f"{side}_{axis}_{unit}" for axis in "xyz"]
    if missing := [name for name in wanted if name not in table.columns]:
        raise MissingColumns(path, missing, table.columns, cure="Columns: log_x_m … base_z_m, or …_mm; point if named.")
    columns = []
    for name in wanted:
        values = table[name].cast(pl.Float64, strict=False)
        bad = (values.is_null() | ~values.is_finite().fill_null(value=False)).to_numpy()
        if bad.any():
            row = int(bad.argmax())
            cause = f"point {row + 1}: {name} = {table[name][row]!r} is not a number"
            raise DamagedLog(path, cause, cure="Write metres with a decimal point, or remove the row.")
        columns.append(values.to_numpy() * UNITS[unit])
    return np.column_stack(columns) if table.height else np.empty((0, 3))
