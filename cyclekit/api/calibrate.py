"""`calibrate_tracker`: where the tracker stands, from points that robot and tracker both touched."""

from __future__ import annotations

from typing import Literal

from cyclekit.alignment.calibrate import Calibration, calibrate
from cyclekit.api.arguments import Place, checked


@checked
def calibrate_tracker(points: Place, *, up: Literal["y", "z"] = "z") -> Calibration:
    """Fit where a tracker stands from points that robot and tracker both touched.

    Args:
        points: Table (CSV) with the columns log_x_m, log_y_m, log_z_m and base_x_m, base_y_m, base_z_m; `_mm` for
            millimetres.
        up: Axis that points up in the tracker.

    Raises:
        ConfigError: The table is none, or its points do not fix a frame.
    """
    return calibrate(points, up=up)
