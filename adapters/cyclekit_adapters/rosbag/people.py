"""Positions of people from the messages of people trackers, each with its own numbering.

A group of messages gives names and positions of its people and, if requested, of their joints. A position that the
tracker only predicts (occluded, searching) was not seen: the person is present, the position unknown. Positions are in
m, in the frame of the message, or of the entry if it has its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cyclekit_adapters.rosbag.joints import AZURE_KINECT
from cyclekit_adapters.rosbag.joints import ZED as ZED_JOINTS

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.decode import Group

Array = npt.NDArray[np.float64]
Names = npt.NDArray[np.str_]
PathStep = str | int

MARKERS, TRACKED = "visualization_msgs/msg/MarkerArray", "spencer_tracking_msgs/msg/TrackedPersons"
PEOPLE, LEG, LEGS = (
    f"people_msgs/msg/{kind}" for kind in ("People", "PositionMeasurement", "PositionMeasurementArray")
)
ZED, ZED_EARLIER = "zed_msgs/msg/ObjectsStamped", "zed_interfaces/msg/ObjectsStamped"
TRACKERS = {TRACKED, PEOPLE, LEG, LEGS, ZED, ZED_EARLIER}
"""Types that always describe people; markers do so only from a body tracker."""

_JOINTS_PER_BODY = 100  # Azure Kinect: id = body * 100 + joint, and joint 0 is the pelvis
_UNSET_VARIANCE = 99999.0  # SPENCER: value of a planar tracker for the unknown height
_HEIGHT_VARIANCE = 14  # index of zz in a 6 x 6 covariance
_ZED_OK = 1
_HIPS = {0: (8, 11), 1: (0,), 2: (0,), 3: (0,)}  # ZED's BODY_18, 34, 38 and 70
_LISTS = {MARKERS: "markers", TRACKED: "tracks", ZED: "objects", ZED_EARLIER: "objects", PEOPLE: "people"}


@dataclass(frozen=True)
class Persons:
    """N messages about K people, or about K joints of people.

    Attributes:
        names: Shape (N, K), empty for no person.
        places: Positions, shape (N, K, 3), m; NaN = not seen.
        frames: Frame of each entry, empty if it has none; length K, or no entries at all.
        reason: Reason for unknown positions.
        joints: Name of the joint, shape (N, K); None for people.
        bodies: Joints of these people, if requested.
    """

    names: Names
    places: Array
    frames: tuple[str, ...] = ()
    reason: str = ""
    joints: Names | None = None
    bodies: Persons | None = None


def persons(kind: str, group: Group, *, skeletons: bool = False) -> Persons:
    """Return the people in a group of messages of one of the `TRACKERS`, or of markers.

    Args:
        kind: Type of the messages.
        group: The messages.
        skeletons: Also return the joints, if the type has any.

    Raises:
        AttributeError, TypeError, ValueError: The messages have other fields than known for this type.
    """
    if kind == LEG:
        return _joined(group, [_measured(group, (), 0)])
    field = _LISTS.get(kind) or _list(group)
    entries: list[tuple[PathStep, ...]] = [(field, number) for number in range(len(group.first(field)) if field else 0)]
    readers: dict[str, Callable[[Group, tuple[PathStep, ...], int], Entry]] = {
        MARKERS: _marker,
        TRACKED: _track,
        PEOPLE: _person,
        LEGS: _measured,
    }
    read = readers.get(kind, _zed)
    found = _joined(group, [read(group, at, number) for number, at in enumerate(entries)], _frames(group, entries))
    reasons = {TRACKED: "people said to be occluded", ZED: "objects not in tracking state OK"}
    found = replace(found, reason=reasons.get(ZED if kind == ZED_EARLIER else kind, ""))
    if skeletons and kind in (MARKERS, ZED, ZED_EARLIER):
        bodies = _marker_joints(group, entries, found) if kind == MARKERS else _zed_joints(group, entries, found)
        return replace(found, bodies=bodies)
    return found


def headers(group: Group) -> list[tuple[PathStep, ...]]:
    """Return the paths of these messages' headers: their own, then that of their first entry."""
    found: list[tuple[PathStep, ...]] = [("header",)] if hasattr(group.message, "header") else []
    field = _list(group)
    if field and len(group.first(field)) and hasattr(group.first(field, 0), "header"):
        found.append((field, 0, "header"))
    return found


def _list(group: Group) -> str:
    """Return the name of the field with the entries: the only list of messages, not of numbers."""
    lists = (name for name, value in vars(group.message).items() if isinstance(value, list))
    return next(lists, "")


Entry = tuple[Names, Array]


def _frames(group: Group, entries: list[tuple[PathStep, ...]]) -> tuple[str, ...]:
    return tuple(
        str(group.first(*at, "header", "frame_id")) if hasattr(group.first(*at), "header") else "" for at in entries
    )


def _joined(group: Group, found: list[Entry], frames: tuple[str, ...] = ()) -> Persons:
    if not found:
        count = group.rows.size
        return Persons(np.zeros((count, 0), "U1"), np.zeros((count, 0, 3)))
    names = np.stack([name for name, _ in found], axis=1)
    places = np.stack([place for _, place in found], axis=1)
    return Persons(names, places, frames)


def _marker_numbers(group: Group, at: tuple[PathStep, ...]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Return the id of a marker and whether it is added (0); other actions remove markers."""
    return group.numbers(*at, "id").astype(np.int64), group.numbers(*at, "action") == 0


def _marker(group: Group, at: tuple[PathStep, ...], number: int) -> Entry:
    marker, added = _marker_numbers(group, at)
    pelvis = (marker % _JOINTS_PER_BODY == 0) & added
    return np.where(pelvis, (marker // _JOINTS_PER_BODY).astype(str), ""), _point(group, *at, "pose", "position")


def _marker_joints(group: Group, entries: list[tuple[PathStep, ...]], found: Persons) -> Persons:
    """Return every marker of a body tracker as a joint; unknown numbers are ignored."""
    known = np.array([*AZURE_KINECT, *[""] * (_JOINTS_PER_BODY - len(AZURE_KINECT))])
    names, joints = np.zeros(found.names.shape, "U20"), np.zeros(found.names.shape, known.dtype)
    for number, at in enumerate(entries):
        marker, added = _marker_numbers(group, at)
        joints[:, number] = known[marker % _JOINTS_PER_BODY]
        is_joint = added & (joints[:, number] != "")
        names[:, number] = np.where(is_joint, (marker // _JOINTS_PER_BODY).astype(str), "")
    return Persons(names, found.places, found.frames, joints=joints)


def _track(group: Group, at: tuple[PathStep, ...], number: int) -> Entry:
    place = _point(group, *at, "pose", "pose", "position")
    planar = group.numbers(*at, "pose", "covariance")[:, _HEIGHT_VARIANCE] > _UNSET_VARIANCE
    place[planar, 2] = np.nan
    place[group.numbers(*at, "is_occluded").astype(bool)] = np.nan
    return _names(group, at, ("track_id",), number), place


def _person(group: Group, at: tuple[PathStep, ...], number: int) -> Entry:
    return _names(group, at, ("name",), number), _point(group, *at, "position")


def _measured(group: Group, at: tuple[PathStep, ...], number: int) -> Entry:
    return _names(group, at, ("object_id",), number), _point(group, *at, "pos")


def _zed(group: Group, at: tuple[PathStep, ...], number: int) -> Entry:
    place = group.numbers(*at, "position").astype(np.float64)
    form, skeleton = _zed_form(group, at)
    for number_of_form, hips in _HIPS.items():
        chosen = skeleton & (form == number_of_form)
        if chosen.any():
            joints = [_zed_joint(group, at, hip)[chosen] for hip in hips]
            known = np.all([np.isfinite(joint).all(1) for joint in joints], axis=0)
            place[chosen] = np.where(known[:, None], np.mean(joints, axis=0), place[chosen])
    place[group.numbers(*at, "tracking_state") != _ZED_OK] = np.nan
    return _names(group, at, ("instance_id", "label_id"), number), place


def _zed_form(group: Group, at: tuple[PathStep, ...]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Return body format and presence of a skeleton, shape (N,); without a skeleton its array holds zeros."""
    here, count = group.first(*at), group.rows.size
    form = group.numbers(*at, "body_format") if hasattr(here, "body_format") else np.zeros(count)
    there = np.full(count, hasattr(here, "skeleton_3d"))
    if hasattr(here, "skeleton_available"):
        there &= group.numbers(*at, "skeleton_available").astype(bool)
    return form.astype(np.int64), there


def _zed_joint(group: Group, at: tuple[PathStep, ...], joint: int) -> Array:
    """Return the position of a joint, shape (N, 3); exact zeros mean not seen."""
    place = group.numbers(*at, "skeleton_3d", "keypoints", joint, "kp").astype(np.float64)
    place[(place == 0.0).all(1)] = np.nan
    return place


def _zed_joints(group: Group, entries: list[tuple[PathStep, ...]], found: Persons) -> Persons:
    """Return the keypoints that the body format has."""
    names, joints, places = [], [], []
    for number, at in enumerate(entries):
        form, skeleton = _zed_form(group, at)
        seen = skeleton & (group.numbers(*at, "tracking_state") == _ZED_OK)
        if not seen.any():
            continue
        for joint in range(len(group.first(*at, "skeleton_3d", "keypoints"))):
            called = {kind: known[joint] for kind, known in ZED_JOINTS.items() if joint < len(known)}
            name = np.array([called.get(kind, "") for kind in form.tolist()])
            names.append(np.where(seen & (name != ""), found.names[:, number], ""))
            joints.append(name)
            places.append(_zed_joint(group, at, joint))
    if not names:
        return Persons(np.zeros((group.rows.size, 0), "U1"), np.zeros((group.rows.size, 0, 3)))
    return Persons(np.stack(names, axis=1), np.stack(places, axis=1), joints=np.stack(joints, axis=1))


def _names(group: Group, at: tuple[PathStep, ...], fields: tuple[str, ...], number: int) -> Names:
    """Return the id of an entry as text, shape (N,); its index in the array if it has none."""
    field = next((name for name in fields if hasattr(group.first(*at), name)), None)
    if field is None:
        return np.full(group.rows.size, str(number))
    text: Any = group.first(*at, field)
    if isinstance(text, str):
        return np.full(group.rows.size, text or str(number))
    return group.numbers(*at, field).astype(str)


def _point(group: Group, *path: PathStep) -> Array:
    return np.stack([group.numbers(*path, axis).astype(np.float64) for axis in "xyz"], axis=1)
