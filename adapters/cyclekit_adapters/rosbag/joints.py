"""Body joints by number and name, in the numbering of the tracker makers; names in lower case.

Azure Kinect: the enumeration of its body tracking SDK. ZED: its body formats of 18, 34, 38 and 70 joints. ROS4HRI: the
links of the human model in REP-155, without those that only split a rotation and have no position.
"""

from __future__ import annotations

import re

_SIDES = ("left", "right")
_ARM = ("clavicle", "shoulder", "elbow", "wrist", "hand", "handtip", "thumb")
_LEG = ("hip", "knee", "ankle", "foot")
_HEAD = ("head", "nose", "eye_left", "ear_left", "eye_right", "ear_right")

AZURE_KINECT = (
    "pelvis",
    "spine_navel",
    "spine_chest",
    "neck",
    *(f"{part}_{side}" for side in _SIDES for part in _ARM),
    *(f"{part}_{side}" for side in _SIDES for part in _LEG),
    *_HEAD,
)
_ZED_18 = (
    "nose",
    "neck",
    *(f"{side}_{part}" for side in reversed(_SIDES) for part in ("shoulder", "elbow", "wrist")),
    *(f"{side}_{part}" for side in reversed(_SIDES) for part in ("hip", "knee", "ankle")),
    "right_eye",
    "left_eye",
    "right_ear",
    "left_ear",
)
_ZED_34 = (
    "pelvis",
    "naval_spine",
    "chest_spine",
    "neck",
    *(f"{side}_{part}" for side in _SIDES for part in _ARM),
    *(f"{side}_{part}" for side in _SIDES for part in _LEG),
    "head",
    "nose",
    "left_eye",
    "left_ear",
    "right_eye",
    "right_ear",
    "left_heel",
    "right_heel",
)
_IN_PAIRS = ("clavicle", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "big_toe", "small_toe", "heel")
_ZED_BODY = (
    "pelvis",
    "spine_1",
    "spine_2",
    "spine_3",
    "neck",
    "nose",
    *(f"{side}_{part}" for part in ("eye", "ear", *_IN_PAIRS) for side in _SIDES),
)
_HAND_38 = ("hand_thumb_4", "hand_index_1", "hand_middle_4", "hand_pinky_1")
_FINGERS = ("thumb", "index", "middle", "ring", "pinky")

ZED = {
    0: _ZED_18,
    1: _ZED_34,
    2: (*_ZED_BODY, *(f"{side}_{part}" for part in _HAND_38 for side in _SIDES)),
    3: (*_ZED_BODY, *(f"{side}_hand_{part}_{n}" for side in _SIDES for part in _FINGERS for n in (1, 2, 3, 4))),
}
"""Joint names by `body_format`; the array in the message always has 70 entries, of which only these are used."""

_ROTATION = re.compile(r"[ypr]_head|[lr]_[ypr]_(?:shoulder|hip)")


def of_human(frame: str, body: str) -> str | None:
    """Return the joint of a ROS4HRI body frame (`l_elbow_<id>`); None for any other frame."""
    name = frame.rpartition("/")[2].lower()
    joint = name.removesuffix(f"_{body.lower()}")
    known = joint != name and not joint.startswith(("body", "person", "face", "gaze", "voice", "focus"))
    return joint if known and not _ROTATION.fullmatch(joint) else None
