"""A real recording of a person, to be replayed in the simulated cell.

Two layouts: a Motive CSV (its first rigid body, Y up, units from its header) and a plain CSV `t_s,x_m,y_m,z_m` with Z
up. Lost frames are interpolated linearly. This reader exists only for the simulator; adapters read plant logs.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.options import SimulationOptions

_METRES = {"Meters": 1.0, "Centimeters": 0.01, "Millimeters": 0.001}
_PLAIN = ["t_s", "x_m", "y_m", "z_m"]
_CURE = "Give a Motive CSV with a rigid body, or a CSV with columns t_s,x_m,y_m,z_m."


def read_recording(path: Path, options: SimulationOptions) -> tuple[Array, Array]:
    """Return times (K,), s from 0, and positions (K, 3), m, in the base frame, placed as in the options.

    Raises:
        SimulationError: The file has neither layout, or fewer than two frames with the person.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as log:
            rows = [row for row in csv.reader(log) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as fault:
        raise SimulationError(f"{path}: cannot be read as CSV ({fault}). {_CURE}") from fault
    if not rows:
        raise SimulationError(f"{path}: empty. {_CURE}")
    t_s, xyz_m = _plain(path, rows) if rows[0] == _PLAIN else _motive(path, rows)
    good = np.isfinite(t_s) & np.isfinite(xyz_m).all(axis=1)
    if good.sum() < 2 or np.any(np.diff(t_s[good]) <= 0):
        raise SimulationError(f"{path}: needs at least two frames with the person, times ascending. {_CURE}")
    t_s, xyz_m = t_s[good] - t_s[good][0], xyz_m[good]
    yaw = np.deg2rad(options.operator_yaw_deg)
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.stack([c * xyz_m[:, 0] - s * xyz_m[:, 1], s * xyz_m[:, 0] + c * xyz_m[:, 1], xyz_m[:, 2]], axis=1)
    return t_s, turned + np.array(options.operator_xyz_m)


def _plain(path: Path, rows: list[list[str]]) -> tuple[Array, Array]:
    table = _numbers(path, rows[1:], range(4))
    return table[:, 0], table[:, 1:]


def _motive(path: Path, rows: list[list[str]]) -> tuple[Array, Array]:
    at = next((i for i, row in enumerate(rows) if row[0] == "Frame"), None)
    if at is None or at < 3 or not rows[0][0].startswith("Format Version"):
        raise SimulationError(f"{path}: no Motive header and no columns t_s,x_m,y_m,z_m. {_CURE}")
    header = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    unit = header.get("Length Units", "")
    if unit not in _METRES or header.get("Coordinate Space", "Global") != "Global":
        raise SimulationError(f"{path}: length unit {unit!r}, space {header.get('Coordinate Space')!r}. {_CURE}")
    kinds = next((row for row in rows[:at] if "Rigid Body" in row), [])
    components, axes = rows[at - 1], rows[at]
    columns = [
        next((i for i, kind in enumerate(kinds) if kind == "Rigid Body" and (components[i], axes[i]) == wanted), -1)
        for wanted in (("Position", "X"), ("Position", "Y"), ("Position", "Z"))
    ]
    if -1 in columns:
        raise SimulationError(f"{path}: no rigid body with a position. {_CURE}")
    table = _numbers(path, rows[at + 1 :], [0, *columns])
    t_s = table[:, 0] / float(header.get("Export Frame Rate", header.get("Capture Frame Rate", "nan")))
    x, y, z = (table[:, i] * _METRES[unit] for i in (1, 2, 3))
    return t_s, np.stack([x, -z, y], axis=1)


def _numbers(path: Path, rows: list[list[str]], columns: range | list[int]) -> Array:
    try:
        cells = [[float(row[i]) if i < len(row) and row[i] else np.nan for i in columns] for row in rows]
    except ValueError as fault:
        raise SimulationError(f"{path}: a cell is not a number ({fault}). {_CURE}") from fault
    return np.array(cells, dtype=np.float64).reshape(-1, len(columns))
