"""Message layouts of types outside the ROS distributions, for bags without definitions.

ROS 2 up to Humble stores no definitions in sqlite3 bags. A type is then read only if exactly one of its historic
layouts decodes every message of its topic to the last byte; `undefined` decides that. Field names and types are those
of the named packages; only the fields are listed, in message definition syntax.
"""

from __future__ import annotations

from dataclasses import dataclass

RULE = "=" * 80


@dataclass(frozen=True)
class HistoricLayout:
    """A historic layout of a type.

    Attributes:
        name: Version or first release, to display.
        text: Its definition; types of other packages are those of `distribution`.
        distribution: ROS distribution of the common types it uses.
    """

    name: str
    text: str = ""
    distribution: str = "humble"


def _joined(first: str, **others: str) -> str:
    """Join the definition of a type and those of other types of its package into one text."""
    return f"\n{RULE}\n".join([first, *(f"MSG: {kind.replace('__', '/')}\n{text}" for kind, text in others.items())])


def _lines(*fields: str) -> str:
    return "\n".join(fields)


_POINT, _MULTI = "trajectory_msgs/JointTrajectoryPoint", "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_HEAD = ("std_msgs/Header header", "string[] joint_names")


def _controller(*names: str, many: bool = True, scaling: bool = False) -> str:
    """Return a controller's state with these points, and optionally those of multi-axis joints."""
    multi = ["string[] multi_dof_joint_names", *(f"{_MULTI} multi_dof_{name}" for name in names)] if many else []
    return _lines(*_HEAD, *(f"{_POINT} {name}" for name in names), *multi, *["float64 speed_scaling_factor"] * scaling)


_PRESENT = ("reference", "feedback", "error", "output")
_CONTROLLERS = (
    HistoricLayout("control_msgs up to 3", _controller("desired", "actual", "error", many=False)),
    HistoricLayout("control_msgs 4.4, Humble", _controller(*_PRESENT, "desired", "actual")),
    HistoricLayout("control_msgs 5.0", _controller(*_PRESENT)),
    HistoricLayout("control_msgs 5.3, Jazzy", _controller(*_PRESENT, scaling=True)),
)


def _tracked(*more: str) -> str:
    ids = ("uint64 track_id", "bool is_occluded", "bool is_matched", "uint64 detection_id", *more)
    moves = ("geometry_msgs/PoseWithCovariance pose", "geometry_msgs/TwistWithCovariance twist")
    person = _lines(*ids, "duration age", *moves)
    head = _lines("std_msgs/Header header", "TrackedPerson[] tracks")
    return _joined(head, spencer_tracking_msgs__TrackedPerson=person)


_PERSON = _lines(
    "string name",
    "geometry_msgs/Point position",
    "geometry_msgs/Point velocity",
    "float64 reliability",
    "string[] tagnames",
    "string[] tags",
)
_LEG = _lines(
    "std_msgs/Header header",
    "string name",
    "string object_id",
    "geometry_msgs/Point pos",
    "float64 reliability",
    "float64[9] covariance",
    "byte initialization",
)
_LEGS = _lines("std_msgs/Header header", "PositionMeasurement[] people", "float32[] cooccurrence")


def _objects(package: str, joints: int, *, form: bool, confidence: bool) -> str:
    seen = _lines(
        "string label",
        "int16 label_id",
        "string sublabel",
        "float32 confidence",
        "float32[3] position",
        "float32[6] position_covariance",
        "float32[3] velocity",
        "bool tracking_available",
        "int8 tracking_state",
        "int8 action_state",
        "BoundingBox2Di bounding_box_2d",
        "BoundingBox3D bounding_box_3d",
        "float32[3] dimensions_3d",
        "bool skeleton_available",
        *["int8 body_format"] * form,
        "BoundingBox2Df head_bounding_box_2d",
        "BoundingBox3D head_bounding_box_3d",
        "float32[3] head_position",
        "Skeleton2D skeleton_2d",
        "Skeleton3D skeleton_3d",
        *["float32[70] skeleton_keypoint_confidence"] * confidence,
    )
    parts = {
        "Object": seen,
        "BoundingBox2Di": "Keypoint2Di[4] corners",
        "BoundingBox2Df": "Keypoint2Df[4] corners",
        "BoundingBox3D": "Keypoint3D[8] corners",
        "Skeleton2D": f"Keypoint2Df[{joints}] keypoints",
        "Skeleton3D": f"Keypoint3D[{joints}] keypoints",
        "Keypoint2Di": "uint32[2] kp",
        "Keypoint2Df": "float32[2] kp",
        "Keypoint3D": "float32[3] kp",
    }
    head = _lines("std_msgs/Header header", "Object[] objects")
    return _joined(head, **{f"{package}__{name}": text for name, text in parts.items()})


def _zed(package: str) -> tuple[HistoricLayout, ...]:
    return (
        HistoricLayout("ZED SDK 3, 18 joints", _objects(package, 18, form=False, confidence=False)),
        HistoricLayout("ZED SDK 4, 70 joints", _objects(package, 70, form=True, confidence=False)),
        HistoricLayout("ZED SDK 5, 70 joints", _objects(package, 70, form=True, confidence=True)),
    )


def _io_states(analog: str) -> str:
    parts = _lines("Digital[] digital_in_states", "Digital[] digital_out_states", "Digital[] flag_states")
    parts += "\n" + _lines("Analog[] analog_in_states", "Analog[] analog_out_states")
    return _joined(parts, ur_msgs__Digital="uint8 pin\nbool state", ur_msgs__Analog=analog)


KNOWN: dict[str, tuple[HistoricLayout, ...]] = {
    "ur_dashboard_msgs/msg/RobotMode": (HistoricLayout("ur_dashboard_msgs", "int8 mode"),),
    "ur_dashboard_msgs/msg/SafetyMode": (HistoricLayout("ur_dashboard_msgs", "uint8 mode"),),
    "ur_msgs/msg/IOStates": (
        HistoricLayout("ur_msgs", _io_states("uint8 pin\nuint8 domain\nfloat32 state")),
        HistoricLayout("ur_msgs without domains", _io_states("uint8 pin\nfloat32 state")),
    ),
    "control_msgs/msg/JointTrajectoryControllerState": _CONTROLLERS,
    "control_msgs/msg/SpeedScalingFactor": (HistoricLayout("control_msgs", "float64 factor"),),
    "spencer_tracking_msgs/msg/TrackedPersons": (
        HistoricLayout("spencer_tracking_msgs", _tracked()),
        HistoricLayout("spencer_tracking_msgs with detection_ids", _tracked("uint64[] detection_ids")),
    ),
    "people_msgs/msg/People": (
        HistoricLayout("people_msgs", _joined("std_msgs/Header header\nPerson[] people", people_msgs__Person=_PERSON)),
    ),
    "people_msgs/msg/PositionMeasurement": (HistoricLayout("people_msgs", _LEG),),
    "people_msgs/msg/PositionMeasurementArray": (
        HistoricLayout("people_msgs", _joined(_LEGS, people_msgs__PositionMeasurement=_LEG)),
    ),
    "zed_msgs/msg/ObjectsStamped": _zed("zed_msgs"),
    "zed_interfaces/msg/ObjectsStamped": _zed("zed_interfaces"),
    "visualization_msgs/msg/MarkerArray": (
        HistoricLayout("Galactic and later"),
        HistoricLayout("up to Foxy", distribution="foxy"),
    ),
}
"""Layouts by type; the markers of ROS 2 itself also changed once."""


def known(kind: str, name: str) -> HistoricLayout:
    """Return a layout by its name."""
    return next(layout for layout in KNOWN[kind] if layout.name == name)
