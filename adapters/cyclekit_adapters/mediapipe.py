"""MediaPipe Pose landmarks: recognised and refused, for they do not say where the person is.

World landmarks are metres from the middle of the person's own hips, so the pelvis is always at zero; the other kind are
fractions of the picture. Neither can give a distance to a robot. The usual dumps are known by their content: JSON or
CSV with MediaPipe's own names (`LEFT_EYE_INNER`, `RIGHT_FOOT_INDEX`, ...), with `pose_world_landmarks`, or with 33
numbered landmarks and their visibility.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import LogError
from cyclekit_adapters.delimited import delimiter_of, fields_of
from cyclekit_adapters.text_blocks import head_of

if TYPE_CHECKING:
    from pathlib import Path

_OWN_NAMES = ("lefteyeinner", "righteyeinner", "leftfootindex", "rightfootindex", "mouthleft", "leftpinky")
_KEYS = ("poseworldlandmarks", "poselandmarks", "worldlandmarks")
_NUMBERED = re.compile(r"^(?:(?:pose|world|landmark|lm|kp|keypoint)?_?)(?:([xyzv])_?(\d+)|(\d+)_?([xyzv]))$")
_LANDMARKS = 33
_WHOLE = re.compile(r"[^a-z0-9]+")


class _MediaPipe:
    def recognises(self, path: Path) -> bool:
        head = head_of(path).lstrip()
        if head.startswith(("{", "[")):
            plain = _WHOLE.sub("", head.lower())
            named = sum(name in plain for name in _OWN_NAMES) >= 2
            keyed = any(key in plain for key in _KEYS) or ("landmarks" in plain and '"visibility"' in head)
            return (named or keyed) and all(f'"{axis}"' in head.lower() for axis in "xyz")
        line = head.partition("\n")[0]
        if max(map(line.count, ",;\t")) < _LANDMARKS - 1:
            return False
        cells = [cell.strip().lower() for cell in fields_of(line, delimiter_of(line, ",;\t"))]
        if len(cells) < _LANDMARKS:
            return False
        plain = _WHOLE.sub("", " ".join(cells))
        return sum(name in plain for name in _OWN_NAMES) >= 2 or _are_numbered(cells)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        cause = (
            "MediaPipe landmarks do not say where the person is: world landmarks are metres from the middle of the "
            "person's own hips, the others are fractions of the picture"
        )
        cure = 'Use a depth camera\'s skeleton; or compute places yourself and map them with adapter = "csv".'
        raise LogError(path, cause, cure=cure)


def _are_numbered(cells: list[str]) -> bool:
    """Tell whether the columns are 33 landmarks of x, y, z and visibility."""
    found: dict[str, set[int]] = {}
    for cell in cells:
        short = cell.replace("visibility", "v").replace("vis", "v")
        if (match := _NUMBERED.match(short)) and len(match[2] or match[3]) <= 2:
            found.setdefault(match[1] or match[4], set()).add(int(match[2] or match[3]))
    return set(found) == set("xyzv") and all(len(numbers) == _LANDMARKS for numbers in found.values())


ADAPTER: Adapter = _MediaPipe()
