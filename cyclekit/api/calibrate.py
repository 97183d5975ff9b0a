"""`calibrate_tracker`: the pose of the tracker, from points touched by both robot and tracker."""

from __future__ import annotations

from cyclekit.alignment.calibrate import calibrate
from cyclekit.api.arguments import checked

calibrate_tracker = checked(calibrate, __name__, "calibrate_tracker")
