"""MediaPipe Pose landmarks: recognised and refused, because they do not give the person's position.

World landmarks are in m from the centre of the person's hips, so the pelvis is always at zero; the other kind are
fractions of the image. Neither gives a distance to a robot. JSON is recognised by MediaPipe's own names
(`LEFT_EYE_INNER`, `RIGHT_FOOT_INDEX`, ...), by `pose_world_landmarks`, or by landmarks with a visibility; tables, which
differ between scripts, by `landmark_tables`.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import LogError
from cyclekit_adapters.text.text_blocks import head_of
from cyclekit_adapters.tracking.landmark_tables import OWN_NAMES, landmarks_in

if TYPE_CHECKING:
    from pathlib import Path

_KEYS = ("poseworldlandmarks", "poselandmarks", "worldlandmarks")
_WHOLE = re.compile(r"[^a-z0-9]+")


class _MediaPipe:
    def recognises(self, path: Path) -> bool:
        return bool(_shown(head_of(path)))

    def read(self, path: Path, options: ReadOptions) -> Recording:
        shown = _shown(head_of(path))
        cause = (
            f"{shown or 'it is read as landmarks'}: MediaPipe's landmarks do not give the person's position. World "
            "landmarks are metres from the middle of the person's own hips, the others are fractions "
            "or pixels of the picture"
        )
        cure = 'Use a depth camera\'s skeleton; or compute positions yourself and map them with adapter = "csv".'
        raise LogError(path, cause, cure=cure)


def _shown(head: str) -> str:
    """Return the evidence that a text holds landmarks; "" if there is none."""
    if not head.lstrip().startswith(("{", "[")):
        return landmarks_in(head)
    plain = _WHOLE.sub("", head.lower())
    named = sum(name in plain for name in OWN_NAMES) >= 2
    keyed = any(key in plain for key in _KEYS) or ("landmarks" in plain and '"visibility"' in head)
    known = (named or keyed) and all(f'"{axis}"' in head.lower() for axis in "xyz")
    return "its keys are those of MediaPipe's landmarks" if known else ""


ADAPTER: Adapter = _MediaPipe()
