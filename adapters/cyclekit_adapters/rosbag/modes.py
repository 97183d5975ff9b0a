"""Names of the robot and safety modes of a UR driver; latched, one message per change.

The numbers are the controller's. RUNNING means that the brakes are released, independent of the program; in any other
mode no program moves the arm. Numbers added by newer software stay numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.decode import Group

ROBOT_MODE, SAFETY_MODE = "ur_dashboard_msgs/msg/RobotMode", "ur_dashboard_msgs/msg/SafetyMode"
RUNNING = "RUNNING"

_ROBOT = dict(
    enumerate(
        (
            "NO_CONTROLLER",
            "DISCONNECTED",
            "CONFIRM_SAFETY",
            "BOOTING",
            "POWER_OFF",
            "POWER_ON",
            "IDLE",
            "BACKDRIVE",
            RUNNING,
            "UPDATING_FIRMWARE",
        ),
        start=-1,
    )
)
_SAFETY = dict(
    enumerate(
        (
            "NORMAL",
            "REDUCED",
            "PROTECTIVE_STOP",
            "RECOVERY",
            "SAFEGUARD_STOP",
            "SYSTEM_EMERGENCY_STOP",
            "ROBOT_EMERGENCY_STOP",
            "VIOLATION",
            "FAULT",
            "VALIDATE_JOINT_ID",
            "UNDEFINED_SAFETY_MODE",
            "AUTOMATIC_MODE_SAFEGUARD_STOP",
            "SYSTEM_THREE_POSITION_ENABLING_STOP",
        ),
        start=1,
    )
)


def mode_names(kind: str, group: Group) -> list[str]:
    """Return the name of each message's mode."""
    words = _ROBOT if kind == ROBOT_MODE else _SAFETY
    return [words.get(int(mode), str(int(mode))) for mode in group.numbers("mode")]
