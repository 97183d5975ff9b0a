"""One body of a ZED dump: position, size and upward direction, in the file's unit and axes.

Names and order of the keypoints are those of the SDK's BODY_18, BODY_34 and BODY_38. The SDK writes a body that it has
not fitted yet in a rest pose at the camera, which is no measurement; its `position` is used instead. A body that the
SDK searches for is hidden, and its expected position is not a measurement either.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import DamagedLog
from cyclekit_adapters.text.json_parts import number, point, points
from cyclekit_adapters.times.units import EARLIEST_S, LATEST_S

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.adapter import ClockKind
    from cyclekit_adapters.text.json_parts import Place

_ARM = ("clavicle", "shoulder", "elbow", "wrist", "hand", "handtip", "thumb")
_LEG = ("hip", "knee", "ankle", "foot")
_BOTH = ("left", "right")
_PAIRS_38 = (
    *("clavicle", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "big_toe", "small_toe", "heel"),
    *("hand_thumb_4", "hand_index_1", "hand_middle_4", "hand_pinky_1"),
)
JOINTS: dict[int, tuple[str, ...]] = {
    18: (
        *("nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist"),
        *("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle"),
        *("right_eye", "left_eye", "right_ear", "left_ear"),
    ),
    34: (
        *("pelvis", "naval_spine", "chest_spine", "neck"),
        *(f"{side}_{part}" for side in _BOTH for part in _ARM),
        *(f"{side}_{part}" for side in _BOTH for part in _LEG),
        *("head", "nose", "left_eye", "left_ear", "right_eye", "right_ear", "left_heel", "right_heel"),
    ),
    38: (
        *("pelvis", "spine_1", "spine_2", "spine_3", "neck", "nose"),
        *("left_eye", "right_eye", "left_ear", "right_ear"),
        *(f"{side}_{part}" for part in _PAIRS_38 for side in _BOTH),
    ),
}
_PELVIS = {18: (8, 11), 34: (0,), 38: (0,)}
_NECK = {18: 1, 34: 3, 38: 4}
_ENOUGH = 5  # minimum number of keypoints for the size of a body
_HIDDEN = ("SEARCHING", "TERMINATE", "2", "3")


@dataclass(frozen=True)
class ZedBody:
    """One body of one frame, in the file's unit and axes.

    Attributes:
        t_s: Time, s.
        clock: Kind of clock.
        row: Frame.
        name: Id of the body.
        here: Position; None if not seen.
        size: Longest edge of the bounding box of its keypoints; None with too few keypoints.
        upward: Vector from pelvis to neck.
        joints: Number of keypoints.
        hidden: The SDK searches for the body.
        resting: The body is in the SDK's rest pose.
        keypoints: Positions, shape (J, 3), if requested.
    """

    t_s: float
    clock: ClockKind
    row: int
    name: str
    here: Place | None
    size: float | None
    upward: Place | None
    joints: int
    hidden: bool = False
    resting: bool = False
    keypoints: NDArray[np.float64] | None = None


def seconds_of(stamp: object) -> tuple[float, ClockKind] | None:
    """Return a timestamp in s: since 1970 if plausible in s, ms, us or ns, else as the SDK's ns of uptime."""
    if isinstance(stamp, str):
        if len(stamp) > 20 or not stamp.strip().isascii() or not stamp.strip().isdigit():
            return None
        stamp = int(stamp)
    value = number(stamp)
    if value is None or not 0.0 <= value < 1e19:
        return None
    for scale in (1, 10**3, 10**6, 10**9):
        if EARLIEST_S <= value / scale <= LATEST_S:
            return (stamp if isinstance(stamp, int) else value) / scale, "epoch"
    return value / 10**9, "uptime"


def body_of(
    path: Path, body: dict[str, object], time: tuple[float, ClockKind], row: int, *, skeletons: bool
) -> ZedBody | None:
    """Return a body; None if it has neither keypoints nor a position.

    Raises:
        DamagedLog: The SDK does not write this number of keypoints.
    """
    raw = body.get("keypoint")
    places = points(raw) if isinstance(raw, list) else np.empty((0, 3))
    if len(places) and len(places) not in JOINTS:
        cause = f"a body of {len(places)} keypoints: ZED writes 18, 34 or 38"
        raise DamagedLog(path, cause, cure='Map the table with adapter = "csv" if this is another skeleton.')
    position = point(body.get("position"))
    position = None if position == (0.0, 0.0, 0.0) else position
    if not len(places) and position is None:
        return None
    resting = bool(len(places)) and _is_resting(places)
    if resting:
        places[:] = np.nan
    places[(places == 0.0).all(axis=1)] = np.nan  # programs without NaN write zeros
    pelvis = _middle(places, _PELVIS.get(len(places), ()))
    neck = _middle(places, (_NECK[len(places)],)) if len(places) else None
    upward = (neck[0] - pelvis[0], neck[1] - pelvis[1], neck[2] - pelvis[2]) if neck and pelvis else None
    name = str(body.get("id", ""))[:80]
    hidden = str(body.get("tracking_state", "")).rpartition(".")[2].upper() in _HIDDEN
    return ZedBody(
        *time,
        row,
        name,
        None if hidden else pelvis or position,
        _size(places),
        upward,
        len(places),
        hidden,
        resting,
        places if skeletons and len(places) and not hidden else None,
    )


def _is_resting(places: NDArray[np.float64]) -> bool:
    """Return whether pelvis and neck lie exactly on an axis of the camera, as no measurement does."""
    spine = [places[list(_PELVIS[len(places)])].mean(axis=0), places[_NECK[len(places)]]]
    return bool(((spine[0] == 0.0) & (spine[1] == 0.0)).sum() == 2)


def _middle(places: NDArray[np.float64], which: tuple[int, ...]) -> Place | None:
    if not which:
        return None
    x, y, z = places[list(which)].mean(axis=0).tolist()
    return (x, y, z) if np.isfinite((x, y, z)).all() else None


def _size(places: NDArray[np.float64]) -> float | None:
    seen = places[np.isfinite(places).all(axis=1)]
    return float((seen.max(axis=0) - seen.min(axis=0)).max()) if len(seen) >= _ENOUGH else None
