"""Words, axis, number and unit in a column name, for names common in logs of robots and trackers.

The words come from public logs of ABB, Doosan, FANUC, Franka, KUKA, Staubli, UR, xArm and Yaskawa robots, of ROS
exports and of trackers. A name alone is no proof; `draft` also considers the values.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

UNITS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("cm", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
    **dict.fromkeys(("deg", "degs", "degree", "degrees", "°", "grad"), "deg"),
    **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisec", "milliseconds", "millisecond"), "ms"),
    **dict.fromkeys(("us", "µs", "usec", "usecs", "micros", "microseconds", "microsec"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanoseconds"), "ns"),
    **dict.fromkeys(("%", "percent", "pct", "percentage"), "%"),
}
TIME_UNITS = {"s", "ms", "us", "ns"}
TIME = {
    *("time", "times", "timestamp", "timestamps", "stamp", "ts", "tm", "clock", "elapsed", "timer", "tick"),
    *("ticks", "ipoc", "zeit", "zeitstempel", "uhrzeit", "epoch", "datetime", "date", "datum", "when", "utc"),
    *("datenum", "filetime", "gps", "ipo"),
}
COUNTS = {"frame", "frames", "index", "idx", "row", "sample", "samples", "count", "counter", "seq", "nr", "no", "line"}
PLACE = {"tcp", "tool", "ee", "eef", "effector", "endeffector", "flange", "pose", "cartesian", "cart", "rist"}
POSITION = {"pos", "position", "translation", "trans", "point", "coord", "coordinate", "coordinates", "location", "p"}
JOINT = {
    "joint",
    "joints",
    "jnt",
    "j",
    "axis",
    "ax",
    "a",
    "q",
    "theta",
    "th",
    "angle",
    "angles",
    "rax",
    "jpos",
    "achse",
}
ROBOT = {"robot", "arm", "manipulator", "ur", "kuka", "abb", "fanuc", "doosan", "xarm", "gripper", "cobot"}
ROBOT |= PLACE - {"pose"}  # a word that trackers also use for people
PERSON = {
    *("human", "humans", "person", "persons", "people", "operator", "worker", "pedestrian", "ped", "body", "skeleton"),
    *("head", "pelvis", "hip", "hips", "torso", "helmet", "vest", "subject", "visitor", "track"),
}
TRACKER = {"tracker", "tracking", "tracks", "mocap", "motive", "optitrack", "vicon", "qualisys", "camera"}
IDS = {"id", "ids", "person", "ped", "pedestrian", "track", "body", "human", "subject", "people", "worker", "object"}
OTHER_IDS = {
    "frame",
    "header",
    "child",
    "robot",
    "joint",
    "execution",
    "episode",
    "cycle",
    "task",
    "run",
    "seq",
    "topic",
}
SET_POINT = {
    *("target", "desired", "des", "cmd", "command", "commanded", "set", "setpoint", "sp", "ref", "reference", "goal"),
    *("planned", "plan", "soll", "sol", "nominal", "expected", "next", "start", "end", "home", "d", "rsol"),
}
ACTUAL = {"actual", "act", "ist", "measured", "meas", "curr", "cur", "current", "fbk", "feedback", "robot"}
OTHER = {
    *("vel", "velocity", "velocities", "speed", "qd", "dq", "qdd", "ddq", "v", "acc", "acceleration", "accel", "w"),
    *(
        "accelerometer",
        "force",
        "forces",
        "f",
        "torque",
        "torques",
        "tau",
        "moment",
        "moments",
        "wrench",
        "amp",
        "temp",
    ),
    *("temperature", "temperatures", "voltage", "effort", "efforts", "load", "power", "error", "err", "diff", "delta"),
    *("dev", "std", "var", "cov", "covariance", "jerk", "gyro", "imu", "angular", "limit", "min", "max", "offset"),
    *("quat", "quaternion", "orientation", "orient", "rot", "rotation", "ori", "rpy", "euler", "roll", "pitch", "yaw"),
    *("status", "mode", "bits", "encoder", "raw", "external", "ext", "mass", "cog", "payload", "voltages", "currents"),
    *("input", "output", "digital", "analog", "stiffness", "damping", "momentum", "finger", "rpm", "confidence"),
    *("rx", "ry", "rz", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "fx", "fy", "fz", "wx", "wy", "wz", "tx", "ty", "tz"),
}
"""Words for quantities that are neither a position nor a joint angle."""
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-zäöüß]+|[A-Z]+|\d+|%|°|µs")
_ONE_WORD = re.compile(r"TCP|RIst|RSol")  # would otherwise be split in two
_LABVIEW_TIME = re.compile(r"X_Value(?:#\d+)?")
"""The time in a measurement file of LabVIEW (LVM), s."""
_BRACKETED = re.compile(r"[\[(<{]\s*([A-Za-zµ°%]+)\s*[\])>}]\s*(?:#\d+)?$|/\s*([A-Za-zµ°%]+)$")
_AXIS_PREFIXES = {"", "act", "actual", "curr", "ist"} | PLACE | POSITION | ROBOT | PERSON
"""Words that occur joined with an axis: `toolx`, `xpos`."""
_SMALL_UNITS = {"m", "s", "in"}  # a unit only as the last word of a name


@dataclass(frozen=True)
class Name:
    """The parsed name of a column.

    Attributes:
        column: Name of the column.
        words: Its words in lower case, without axis and unit, with `#` for its last number; equal for columns that
            differ only in axis or number.
        axis: x, y or z.
        number: Last number in the name.
        unit: A value of `UNITS`.
    """

    column: str
    words: tuple[str, ...]
    axis: str | None
    number: int | None
    unit: str | None

    def says(self, words: Iterable[str]) -> bool:
        """Return whether the name contains one of `words`."""
        return not set(self.words).isdisjoint(words)

    @property
    def is_time(self) -> bool:
        """True if the name means a time; `t` counts only as the last word, because it has many meanings."""
        return self.says(TIME) or self.words[-1:] == ("t",)

    @property
    def is_set_point(self) -> bool:
        """True if the column is a set point, not a measurement."""
        return self.says(SET_POINT) and not self.says(ACTUAL)

    @property
    def is_other(self) -> bool:
        """True if the column is neither position nor joint angle; `current` is electrical except as first word."""
        electrical = "current" in self.words and self.words[0] != "current"
        return self.says(OTHER) or electrical


def name_of(column: str, unit: str = "") -> Name:
    """Parse the name of a column.

    Args:
        column: Name of the column.
        unit: Its entry in a line of units.
    """
    column = "time [s]" if _LABVIEW_TIME.fullmatch(column) else column
    found = _BRACKETED.search(column)
    named = UNITS.get((found[1] or found[2]).lower()) if found else None
    text = column[: found.start()] if found and named else column
    words = [word.lower() for word in _WORD.findall(_ONE_WORD.sub(lambda one: f" {one[0].lower()} ", text))]
    if named is None and words and (len(words) > 1 or words[0] not in _SMALL_UNITS) and words[-1] in UNITS:
        named = UNITS[words.pop()]
    named = UNITS.get(unit.strip("[]() ").lower()) or named
    axis, rest = _axis(words)
    numbers = [at for at, word in enumerate(rest) if word.isdecimal() and len(word) < 10]
    number = int(rest[numbers[-1]]) if numbers else None
    kept = tuple("#" if at in numbers[-1:] else word for at, word in enumerate(rest))
    return Name(column, kept, axis, number, named)


def _axis(words: list[str]) -> tuple[str | None, list[str]]:
    """Return the axis, if exactly one word names one, and the other words."""
    found = [(at, *split) for at, word in enumerate(words) if (split := _split_axis(word))]
    if len(found) != 1:
        return None, words
    at, axis, joined = found[0]
    return axis, [*words[:at], *([joined] if joined else []), *words[at + 1 :]]


def _split_axis(word: str) -> tuple[str, str] | None:
    """Return the axis at one end of a word and the rest, if the rest is a word that occurs joined with an axis."""
    for axis, joined in ((word[-1:], word[:-1]), (word[:1], word[1:])):
        if axis in ("x", "y", "z") and joined in _AXIS_PREFIXES:
            return axis, joined
    return None
