"""Length unit and axes of a ZED skeleton, inferred from the skeletons.

The SDK lets its user choose both and writes neither. Metres and millimetres differ by a factor of 1000 and people do
not, so body size decides the unit. People stand and sit upright, so the vector from pelvis to neck shows the vertical
axis. It does not show left and right: right-handed axes are assumed, as written by the SDK's exporters; anything else
must be given.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from cyclekit.errors import LogError
from cyclekit.text.numbers import compact, fixed

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Numbers = NDArray[np.float64]

UNITS = {"m": 1.0, "mm": 1e-3}
SIZE_M = (0.25, 3.0)
"""Range of the longest edge of a body's bounding box, m: from half a crouching person to a man with raised arms."""

Up = Literal["y", "z"]
_SAME = np.eye(3)
_FLIP = np.diag([1.0, -1.0, -1.0])
_MIRROR = np.diag([1.0, 1.0, -1.0])
AXES: dict[str, tuple[Numbers, Up]] = {
    "right_handed_y_up": (_SAME, "y"),
    "right_handed_z_up": (_SAME, "z"),
    "right_handed_z_up_x_fwd": (_SAME, "z"),
    "image": (_FLIP, "y"),
    "left_handed_y_up": (_MIRROR, "y"),
    "left_handed_z_up": (np.diag([1.0, -1.0, 1.0]), "z"),
}
"""Coordinate systems of the SDK: rotation (or mirror) into right-handed axes, and their vertical axis."""

_CLEAR = 0.6


def metres_of(path: Path, sizes: Numbers, unit: str | None) -> tuple[float, str]:
    """Return metres per unit of the file, and the evidence.

    Args:
        path: The log.
        sizes: Size of each body in the file's unit, shape (N,).
        unit: Unit given in the cell file, or None.

    Raises:
        LogError: The body sizes fit neither unit.
    """
    if unit is not None:
        return UNITS[unit], f"{unit}, from the cell file"
    typical = float(np.median(sizes)) if len(sizes) else float("nan")
    for name, metres in UNITS.items():
        if SIZE_M[0] <= typical * metres <= SIZE_M[1]:
            return metres, f"{name}, since bodies are {compact(typical)} {name} from end to end"
    seen = "no body shows its size" if not len(sizes) else f"bodies are {compact(typical)} from end to end"
    cause = f"the unit may be metres or millimetres: {seen}"
    raise LogError(path, cause, cure='Give it in cell.toml: unit = "m" or unit = "mm" in [sources.map].')


def axes_of(path: Path, upward: Numbers, axes: str | None) -> tuple[Numbers, Up, str]:
    """Return the rotation into right-handed axes (3, 3), their vertical axis, and the evidence.

    Args:
        path: The log.
        upward: Vector from pelvis to neck of each body, shape (N, 3).
        axes: Axes given in the cell file, or None.

    Raises:
        LogError: The bodies point neither up nor down along one axis.
    """
    if axes is not None:
        return *AXES[axes], f"{axes}, from the cell file"
    length = np.linalg.norm(upward, axis=1, keepdims=True)
    usable = (length > 0.0) & np.isfinite(length)
    if not usable.any():
        return *AXES["right_handed_y_up"], "right_handed_y_up, the default of the SDK's exporters; no body shows it"
    mean = (upward[usable[:, 0]] / length[usable[:, 0]]).mean(axis=0)
    shown = {"right_handed_y_up": mean[1], "image": -mean[1], "right_handed_z_up": mean[2]}
    best = max(shown, key=lambda name: float(shown[name]))
    if shown[best] < _CLEAR:
        way = ", ".join(fixed(value, 2) for value in mean)
        cause = f"the bodies do not show which axis is up: pelvis to neck is ({way}) on average"
        raise LogError(path, cause, cure=f"Give it in cell.toml, in [sources.map]: axes = one of {', '.join(AXES)}.")
    turned = "; turned to y up, z towards the camera" if best == "image" else ""
    return *AXES[best], f"{best}, since bodies stand along it; taken as right-handed{turned}"
