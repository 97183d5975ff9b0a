"""Who stands where, out of the messages of people trackers, each by its own numbering.

One group of messages becomes the names and places of its people. A place that the tracker only predicts (occluded,
searching) is not one it has seen: that person is there, the place unknown. Metres, in the frame of the message.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.decode import Group

Array = npt.NDArray[np.float64]
Step = str | int

MARKERS, TRACKED = "visualization_msgs/msg/MarkerArray", "spencer_tracking_msgs/msg/TrackedPersons"
PEOPLE, LEG, LEGS = (
    f"people_msgs/msg/{kind}" for kind in ("People", "PositionMeasurement", "PositionMeasurementArray")
)
ZED, ZED_EARLIER = "zed_msgs/msg/ObjectsStamped", "zed_interfaces/msg/ObjectsStamped"
TRACKERS = {TRACKED, PEOPLE, LEG, LEGS, ZED, ZED_EARLIER}
"""Types that speak of people whatever their topic is called; markers do so only from a body tracker."""

_JOINTS_PER_BODY = 100  # Azure Kinect: id = body * 100 + joint, and joint 0 is the pelvis
_UNSET_VARIANCE = 99999.0  # SPENCER: a planar tracker says so of the height
_HEIGHT_VARIANCE = 14  # zz of a 6 x 6 covariance
_ZED_OK = 1
_HIPS = {0: (8, 11), 1: (0,), 2: (0,)}  # ZED's BODY_18, 34 and 38


@dataclass(frozen=True)
class Persons:
    """N messages about K people: names, shape (N, K), empty for none; places, shape (N, K, 3), m, NaN = not seen."""

    names: npt.NDArray[np.str_]
    places: Array
    said: str = ""


def persons(kind: str, group: Group) -> Persons:
    """Return the people of a group of messages of one of the `TRACKERS`, or of markers.

    Raises:
        AttributeError, TypeError, ValueError: The messages have other fields than the type is known for.
    """
    if kind == LEG:
        return _joined(group, [_measured(group, (), 0)])
    field = {MARKERS: "markers", TRACKED: "tracks", ZED: "objects", ZED_EARLIER: "objects"}.get(kind) or _list(group)
    read = {MARKERS: _marker, TRACKED: _track, PEOPLE: _person, LEGS: _measured}.get(kind, _zed)
    said = {TRACKED: "people said to be occluded", ZED: "objects not in tracking state OK"}
    found = [read(group, (field, number), number) for number in range(len(group.first(field)) if field else 0)]
    return _joined(group, found, said.get(ZED if kind == ZED_EARLIER else kind, ""))


def headers(group: Group) -> list[tuple[Step, ...]]:
    """Return where these messages have headers: their own, then that of their first entry."""
    found: list[tuple[Step, ...]] = [("header",)] if hasattr(group.message, "header") else []
    field = _list(group)
    if field and len(group.first(field)) and hasattr(group.first(field, 0), "header"):
        found.append((field, 0, "header"))
    return found


def _list(group: Group) -> str:
    """Return the name of the field that holds the entries: the one list of messages, not of numbers."""
    lists = (name for name, value in vars(group.message).items() if isinstance(value, list))
    return next(lists, "")


Entry = tuple[npt.NDArray[np.str_], Array]


def _joined(group: Group, found: list[Entry], said: str = "") -> Persons:
    if not found:
        count = group.rows.size
        return Persons(np.zeros((count, 0), "U1"), np.zeros((count, 0, 3)))
    names = np.stack([name for name, _ in found], axis=1)
    places = np.stack([place for _, place in found], axis=1)
    return Persons(names, places, said)


def _marker(group: Group, at: tuple[Step, ...], number: int) -> Entry:
    marker = group.numbers(*at, "id").astype(np.int64)
    pelvis = (marker % _JOINTS_PER_BODY == 0) & (group.numbers(*at, "action") == 0)  # 0 adds, the others take away
    return np.where(pelvis, (marker // _JOINTS_PER_BODY).astype(str), ""), _point(group, *at, "pose", "position")


def _track(group: Group, at: tuple[Step, ...], number: int) -> Entry:
    place = _point(group, *at, "pose", "pose", "position")
    planar = group.numbers(*at, "pose", "covariance")[:, _HEIGHT_VARIANCE] > _UNSET_VARIANCE
    place[planar, 2] = np.nan
    place[group.numbers(*at, "is_occluded").astype(bool)] = np.nan
    return _names(group, at, ("track_id",), number), place


def _person(group: Group, at: tuple[Step, ...], number: int) -> Entry:
    return _names(group, at, ("name",), number), _point(group, *at, "position")


def _measured(group: Group, at: tuple[Step, ...], number: int) -> Entry:
    return _names(group, at, ("object_id",), number), _point(group, *at, "pos")


def _zed(group: Group, at: tuple[Step, ...], number: int) -> Entry:
    place = group.numbers(*at, "position").astype(np.float64)
    for form, hips in _HIPS.items():
        middle, known = _hips(group, at, hips)
        chosen = known & (group.numbers(*at, "body_format") == form) if known.any() else known
        place[chosen] = middle[chosen]
    place[group.numbers(*at, "tracking_state") != _ZED_OK] = np.nan
    return _names(group, at, ("instance_id", "label_id"), number), place


def _hips(group: Group, at: tuple[Step, ...], hips: tuple[int, ...]) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the middle of the hips and whether there is a skeleton; the array is there, as zeros, without one too."""
    here = group.first(*at)
    if not hasattr(here, "skeleton_3d"):
        return np.zeros((group.rows.size, 3)), np.zeros(group.rows.size, bool)
    joints = [group.numbers(*at, "skeleton_3d", "keypoints", hip, "kp").astype(np.float64) for hip in hips]
    known: Any = np.all([np.isfinite(joint).all(1) & (joint != 0.0).any(1) for joint in joints], axis=0)
    if hasattr(here, "skeleton_available"):
        known = known & group.numbers(*at, "skeleton_available").astype(bool)
    return np.mean(joints, axis=0), known


def _names(group: Group, at: tuple[Step, ...], fields: tuple[str, ...], number: int) -> npt.NDArray[np.str_]:
    """Return the id of an entry as text, shape (N,); its place in the array where it has none."""
    field = next((name for name in fields if hasattr(group.first(*at), name)), None)
    if field is None:
        return np.full(group.rows.size, str(number))
    if isinstance(text := group.first(*at, field), str):
        return np.full(group.rows.size, text or str(number))
    return group.numbers(*at, field).astype(str)


def _point(group: Group, *path: Step) -> Array:
    return np.stack([group.numbers(*path, axis).astype(np.float64) for axis in "xyz"], axis=1)
