"""What the name of a column says: its words, axis, number and unit; as people name those of robots and trackers.

Taken from public logs of ABB, Doosan, FANUC, Franka, KUKA, Staubli, UR, xArm and Yaskawa robots, of ROS exports and of
trackers. A name alone proves nothing; what its values say is the business of `draft`.
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
ROBOT |= PLACE - {"pose"}  # which trackers say of people, too
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
"""Words of quantities that are neither a position nor a joint angle."""
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-zäöüß]+|[A-Z]+|\d+|%|°|µs")
_ONE_WORD = re.compile(r"TCP|RIst|RSol")  # which look like two
_BRACKETED = re.compile(r"[\[(<{]\s*([A-Za-zµ°%]+)\s*[\])>}]\s*(?:#\d+)?$|/\s*([A-Za-zµ°%]+)$")
_BESIDE_AXIS = {"", "act", "actual", "curr", "ist"} | PLACE | POSITION | ROBOT | PERSON
"""Words that people write together with an axis: `toolx`, `xpos`."""
_SMALL_UNITS = {"m", "s", "in"}  # as words of a name they are a unit at its end only


@dataclass(frozen=True)
class Name:
    """The name of a column, taken apart.

    Attributes:
        column: The column.
        words: What it says, in lower case, without axis and unit, `#` for its last number: what columns of other axes
            or numbers have in common with it.
        axis: x, y or z.
        number: The last number in it.
        unit: A key of `UNITS`' values.
    """

    column: str
    words: tuple[str, ...]
    axis: str | None
    number: int | None
    unit: str | None

    def says(self, words: Iterable[str]) -> bool:
        """Tell whether one of `words` is in it."""
        return not set(self.words).isdisjoint(words)

    @property
    def is_time(self) -> bool:
        """It is called a time; `t` alone only at its end, since it stands for many things."""
        return self.says(TIME) or self.words[-1:] == ("t",)

    @property
    def is_set_point(self) -> bool:
        """It is a set point, not a measurement."""
        return self.says(SET_POINT) and not self.says(ACTUAL)

    @property
    def is_other(self) -> bool:
        """It is neither a place nor a joint angle; `current` is electrical where it does not come first."""
        electrical = "current" in self.words and self.words[0] != "current"
        return self.says(OTHER) or electrical


def name_of(column: str, unit: str = "") -> Name:
    """Take the name of a column apart.

    Args:
        column: The column.
        unit: What a line of units says of it.
    """
    found = _BRACKETED.search(column)
    said = UNITS.get((found[1] or found[2]).lower()) if found else None
    text = column[: found.start()] if found and said else column
    words = [word.lower() for word in _WORD.findall(_ONE_WORD.sub(lambda one: f" {one[0].lower()} ", text))]
    if said is None and words and (len(words) > 1 or words[0] not in _SMALL_UNITS) and words[-1] in UNITS:
        said = UNITS[words.pop()]
    said = UNITS.get(unit.strip("[]() ").lower()) or said
    axis, rest = _axis(words)
    numbers = [at for at, word in enumerate(rest) if word.isdigit()]
    number = int(rest[numbers[-1]]) if numbers else None
    kept = tuple("#" if at in numbers[-1:] else word for at, word in enumerate(rest))
    return Name(column, kept, axis, number, said)


def _axis(words: list[str]) -> tuple[str | None, list[str]]:
    """Return the axis that exactly one of the words names, and the other words."""
    found = [(at, *split) for at, word in enumerate(words) if (split := _split_axis(word))]
    if len(found) != 1:
        return None, words
    at, axis, beside = found[0]
    return axis, [*words[:at], *([beside] if beside else []), *words[at + 1 :]]


def _split_axis(word: str) -> tuple[str, str] | None:
    """Return the axis at one end of a word, and the rest of it, if people write such words."""
    for axis, beside in ((word[-1:], word[:-1]), (word[:1], word[1:])):
        if axis in ("x", "y", "z") and beside in _BESIDE_AXIS:
            return axis, beside
    return None
