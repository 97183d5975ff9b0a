"""Roles and units of the topics of a bag.

A name alone is not sufficient: `/speed_scaling_factor` is a state in 0..1 as Float64 of a UR driver, and a command in
0..100 as Int32 of a FANUC driver. So each rule requires a message type and a name ending (drivers prefix their names).
Other topics are left to the cell file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, LogError, UnknownName, nearest
from cyclekit_adapters.rosbag.clocks import HOWS, How
from cyclekit_adapters.rosbag.modes import ROBOT_MODE, SAFETY_MODE
from cyclekit_adapters.rosbag.people import MARKERS, TRACKERS
from cyclekit_adapters.rosbag.robots import of_one_robot, spaces

if TYPE_CHECKING:
    from pathlib import Path

JOINTS, POSE, POSES = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseArray"
POINT = "geometry_msgs/msg/PointStamped"
TRANSFORMS, TEXT, FLAG = "tf2_msgs/msg/TFMessage", "std_msgs/msg/String", "std_msgs/msg/Bool"
_TF1 = "tf/msg/tfMessage"
CONTROLLER, CLOCK = "control_msgs/msg/JointTrajectoryControllerState", "rosgraph_msgs/msg/Clock"
_NUMBERS = {f"std_msgs/msg/{kind}" for kind in ("Float64", "Float32", "Int64", "Int32", "Int16", "UInt8")}
_SCALES = {*_NUMBERS, *(f"std_msgs/msg/{kind}" for kind in ("Int8", "UInt16", "UInt32", "UInt64")), FLAG, CONTROLLER}
_FACTOR, IO_STATES = "control_msgs/msg/SpeedScalingFactor", "ur_msgs/msg/IOStates"
_TYPES = {
    "tcp": {POSE, POINT},
    "joints": {JOINTS, CONTROLLER},
    "scaling": {*_SCALES, _FACTOR},
    "running": {FLAG},
    "people": {POSES, POSE, POINT, MARKERS, *TRACKERS, TRANSFORMS, _TF1},
    "events": {TEXT, FLAG, ROBOT_MODE, SAFETY_MODE},
}
"""Message types allowed for a topic given in the cell file, by key; other types hold nothing usable."""
_PEOPLE_WORDS = {"poses", "people", "persons", "humans", "bodies", "human", "person", "operator"}
_TOPICS = ("tcp", "joints", "scaling", "running", "people", "events")
_TCP, _RUNNING = ("tcp_pose_broadcaster/pose", "tcp_pose"), "robot_program_running"
_UR_RUNNING = tuple(f"{name}/{_RUNNING}" for name in ("io_and_status_controller", "ur_hardware_interface"))
_UR_2, _UR_1 = "speed_scaling_state_broadcaster/speed_scaling", "speed_scaling_factor"
_KEYS = (*_TOPICS, "scaling_max", "base_frame", "tool_frame", "time")
_WHERE = "[sources.map] of a bag"


@dataclass(frozen=True)
class Factor:
    """One topic that scales speed. `family`: topics of one family multiply, and so do the families of state."""

    topic: str
    family: str
    full: float
    attribute: str = "data"


@dataclass(frozen=True)
class Roles:
    """Use of each topic of this bag; None and () if there is none."""

    tcp: str | None = None
    joints: str | None = None
    transforms: tuple[str, ...] = ()
    scaling: tuple[Factor, ...] = ()
    maybe_scaling: tuple[str, ...] = ()  # by their names, but of unknown unit
    running: str | None = None
    inputs: str | None = None
    people: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    modes: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ()
    bodies: bool = False  # the transforms hold people
    base_frame: str | None = None
    tool_frame: str | None = None
    time: Mapping[str, How] = field(default_factory=dict)

    def topics(self) -> set[str]:
        """Return all topics in use."""
        single = [topic for topic in (self.tcp, self.joints, self.running, self.inputs) if topic]
        factors = [factor.topic for factor in self.scaling]
        transforms = self.transforms if self.bodies or self.people or self.base_frame or not self.tcp else ()
        return {*single, *transforms, *factors, *self.people, *self.events, *self.modes, *self.clocks}


def roles_in(
    path: Path,
    types: Mapping[str, str],
    counts: Mapping[str, int],
    chosen: Mapping[str, object],
    body: str | None,
    *,
    robot: bool = True,
) -> Roles:
    """Assign roles to the topics of a bag.

    Args:
        path: The bag, for messages.
        types: Message type of each topic.
        counts: Number of messages of each topic; a topic without messages is no candidate.
        chosen: `[sources.map]` of the cell file, which takes precedence over all rules.
        body: Topic of the person, if given in the cell file.
        robot: Whether the robot is requested; among several robots one must then be identified.

    Raises:
        UnknownName: The cell file uses an unknown key.
        ConfigError: The cell file names a scaling topic of unknown unit.
        LogError: The cell file names a topic that is missing, or does not identify one of several robots.
    """
    for key in chosen:
        if key not in _KEYS:
            raise UnknownName(_WHERE, "key", key, _KEYS)
    named = {key: _named(path, types, chosen[key], key) for key in _TOPICS if key in chosen}
    live = {topic: kind for topic, kind in types.items() if counts.get(topic, 0) > 0}
    people = _named(path, types, body, "people") if body else named.get("people", _people(live))
    if robot:
        live = _of_robot(path, live, named)
    transforms = tuple(topic for topic, kind in live.items() if kind in (TRANSFORMS, _TF1))
    bodies = not {*people}.isdisjoint(transforms) or (not body and "people" not in named and _has_humans(types))
    running = named.get("running", _ending(live, {FLAG}, _RUNNING))
    tcp = named.get("tcp", _ending(live, {POSE}, *_TCP))
    frames = {key: str(chosen[key]) for key in ("base_frame", "tool_frame") if key in chosen}
    scaling = _chosen_factor(named["scaling"], chosen, live) if "scaling" in named else _factors(live)
    used = {*running, *(factor.topic for factor in scaling)}
    modes = _ending_of_type(live, ROBOT_MODE) + _ending_of_type(live, SAFETY_MODE)
    events = [t for t, kind in live.items() if kind in (TEXT, FLAG) and t not in used and not _is_description(t)]
    return Roles(
        tcp=next(iter(tcp), None),
        joints=next(iter(named.get("joints", _joints(live))), None),
        transforms=transforms,
        scaling=scaling,
        maybe_scaling=tuple(t for t, kind in live.items() if kind in _NUMBERS and _speaks_of_scaling(t)),
        running=next(iter(running), None),
        inputs=next(iter(_ending_of_type(live, IO_STATES)), None),
        people=tuple(topic for topic in people if topic not in transforms),
        events=tuple(named.get("events", events + modes)),
        modes=tuple(modes),
        clocks=tuple(_ending_of_type(live, CLOCK)),
        bodies=bodies and bool(transforms),
        base_frame=frames.get("base_frame"),
        tool_frame=frames.get("tool_frame"),
        time=_times(path, types, chosen.get("time", {})),
    )


def _of_robot(path: Path, live: Mapping[str, str], named: Mapping[str, list[str]]) -> dict[str, str]:
    """Return the topics of one robot and those of none; the robot is that of a given topic, else of the only pose."""

    def quantity(topic: str) -> str | None:
        kind = live[topic]
        if kind == POSE and "tcp" not in named:
            return next((end for end in _TCP if _ends(topic, end)), None)
        if kind == FLAG and "running" not in named and _ends(topic, _RUNNING):
            return next((end for end in _UR_RUNNING if _ends(topic, end)), _RUNNING)
        factor = _factor(topic, kind) if "scaling" not in named else None
        if factor is None or factor.family not in ("ur-1", "ur-2", "cnr"):
            return None
        return {"ur-1": _UR_1, "ur-2": _UR_2}.get(factor.family) or topic.rpartition("/")[2]

    anchors = [topic for key in ("tcp", "joints", "scaling", "running") for topic in named.get(key, [])]
    poses = _ending(live, {POSE}, *_TCP)
    return of_one_robot(path, live, spaces(live, quantity), [*anchors, *(poses if len(poses) == 1 else [])])


def _times(path: Path, types: Mapping[str, str], asked: object) -> dict[str, How]:
    """Return the kind of time to use for each topic, as given in the cell file."""
    if not isinstance(asked, Mapping):
        cure = f'Write time = {{ "/topic" = "{HOWS[0]}" }}; known: {", ".join(HOWS)}.'
        raise ConfigError(f"{_WHERE}: time = {asked!r} is not a table", cure=cure)
    found: dict[str, How] = {}
    for topic, how in asked.items():
        if how not in HOWS:
            raise UnknownName(f"{_WHERE}: time", "choice", str(how), HOWS)
        found[_named(path, types, topic)[0]] = how
    return found


def _named(path: Path, types: Mapping[str, str], value: object, key: str = "") -> list[str]:
    """Return the topics named in a value of the cell file; a leading slash is optional.

    Raises:
        LogError: There is no such topic, or its type does not suit `key`.
    """
    names = (
        [str(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else [str(value)]
    )
    found = []
    for name in names:
        match = next((topic for topic in types if topic.strip("/") == name.strip("/")), None)
        if match is None:
            cure = f"In the bag: {', '.join(sorted(types))}."
            raise LogError(path, f"no topic {name!r}", nearest=nearest(name, types), cure=cure)
        if key and types[match] not in _TYPES[key]:
            cure = f"For {key} it must be {', '.join(sorted(_TYPES[key]))}."
            raise LogError(path, f"topic {match!r} has type {types[match]}, from which {key} cannot be read", cure=cure)
        found.append(match)
    return found


def _ending(types: Mapping[str, str], kinds: set[str], *endings: str) -> list[str]:
    return [t for t, kind in types.items() if kind in kinds and any(_ends(t, ending) for ending in endings)]


def _ends(topic: str, ending: str) -> bool:
    return topic == ending or topic.endswith(f"/{ending}")


def _is_description(topic: str) -> bool:
    return "description" in topic.rpartition("/")[2]


def _joints(types: Mapping[str, str]) -> list[str]:
    """Return joint topics, best first, without set points; a controller's state is the last resort."""
    measured = [t for t in _ending_of_type(types, JOINTS) if "target" not in t and "command" not in t]
    return sorted(
        measured, key=lambda topic: (topic.strip("/") != "joint_states", not _ends(topic, "joint_states"))
    ) + (_ending_of_type(types, CONTROLLER))


def _ending_of_type(types: Mapping[str, str], kind: str) -> list[str]:
    return [topic for topic, found in types.items() if found == kind]


def _people(types: Mapping[str, str]) -> list[str]:
    kinds = {POSES, POSE, POINT}
    named = [t for t, kind in types.items() if kind in kinds and _speaks_of_people(t, kind)]
    tracked = [t for t, kind in types.items() if kind in TRACKERS]
    return named + tracked + _ending(types, {MARKERS}, "body_tracking_data")


def _has_humans(types: Mapping[str, str]) -> bool:
    """Return whether ROS4HRI is used: its lists and bodies are below `humans`, the positions of bodies in TF."""
    return any("/humans/" in f"/{topic.strip('/')}/" for topic in types)


def _speaks_of_people(topic: str, kind: str) -> bool:
    words = set(topic.strip("/").lower().replace("_", "/").split("/"))
    if words & {"goal", "target", "command"}:
        return False
    return bool(words & (_PEOPLE_WORDS if kind == POSES else _PEOPLE_WORDS - {"poses"}))


def _factors(types: Mapping[str, str]) -> tuple[Factor, ...]:
    """Return the topics whose product is the effective scaling; a command only if no state was recorded."""
    found = [factor for topic, kind in types.items() if (factor := _factor(topic, kind))]
    families = {factor.family for factor in found}
    if "ur-2" in families:
        found = [factor for factor in found if factor.family != "ur-1"]
    state = [factor for factor in found if factor.family in ("ur-1", "ur-2", "cnr")]
    if not state:  # a controller's state has a factor since Jazzy; without one the command is used
        state = [factor for factor in found if factor.family == "controller"][:1]
        state += [factor for factor in found if factor.family == "command"][:1]
        state += [factor for factor in found if factor.family == "clamp"]
    return tuple(_once_per_override(state))


def _factor(topic: str, kind: str) -> Factor | None:
    if kind == "std_msgs/msg/Float64" and _ends(topic, _UR_2):
        return Factor(topic, "ur-2", full=100.0)
    if _ends(topic, _UR_1) and kind == "std_msgs/msg/Float64":
        return Factor(topic, "ur-1", full=1.0)
    if _ends(topic, _UR_1) and kind == "std_msgs/msg/Int32":
        return Factor(topic, "command", full=100.0)
    if _ends(topic, "collaborative_speed_scaling") and kind in {FLAG, *_NUMBERS}:
        return Factor(topic, "clamp", full=1.0)
    if kind == _FACTOR:
        return Factor(topic, "command", full=1.0, attribute="factor")
    if kind == CONTROLLER:
        return Factor(topic, "controller", full=1.0, attribute="speed_scaling_factor")
    if kind in _NUMBERS and _override_of(topic) is not None:
        return Factor(topic, "cnr", full=100.0)
    return None


def _speaks_of_scaling(topic: str) -> bool:
    name = topic.rpartition("/")[2].lower()
    return any(word in name for word in ("scaling", "override", "speed_fraction", "_ovr"))


def _override_of(topic: str) -> str | None:
    """Return which of the three overrides of the CNR stack a topic holds, if any; all variants are in percent."""
    stem = topic.rpartition("/")[2].removesuffix("_float64").removesuffix("_float")
    return stem if stem in ("speed_ovr", "safe_ovr_1", "safe_ovr_2") else None


def _once_per_override(factors: list[Factor]) -> list[Factor]:
    """Drop the Float32 and Float64 copies of an override that also exists as an integer."""
    best: dict[str, Factor] = {}
    for factor in sorted(factors, key=lambda f: len(f.topic)):
        best.setdefault(_override_of(factor.topic) or factor.topic, factor)
    return list(best.values())


def _chosen_factor(topics: Sequence[str], chosen: Mapping[str, object], types: Mapping[str, str]) -> tuple[Factor, ...]:
    full = chosen.get("scaling_max")
    if full is not None and full not in (1, 100, 1.0, 100.0):
        raise ConfigError(f"{_WHERE}: scaling_max = {full!r}", cure="Give 1 (fraction) or 100 (percent).")
    factors = []
    for topic in topics:
        known = _factor(topic, types.get(topic, ""))
        if known is None and full is None:
            cure = "Add scaling_max = 1 or scaling_max = 100."
            raise ConfigError(f"{_WHERE}: the unit of {topic!r} is not known", cure=cure)
        value = float(str(full)) if full is not None else known.full if known else 1.0
        factors.append(Factor(topic, "chosen", value, known.attribute if known else "data"))
    return tuple(factors)
