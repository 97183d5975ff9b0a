"""Assignment of the bodies in a frame to the bodies in the last frame, for logs without reliable ids.

Between two frames a body moves less than a stride, so each body continues the nearest track. A track without a body for
a second ends. Two people who pass within a stride may be swapped, which does not affect the distance to the nearest of
them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

Place = tuple[float, float, float]

STRIDE_M = 0.5
"""Maximum jump of a body between two frames, m, regardless of time: the error of trackers."""
WALK_M_S = 3.0
"""Additional distance per second, m/s."""
FORGET_S = 1.0
"""Maximum gap within a track, s; after it, a body is a new person."""


@dataclass
class Linker:
    """Assigns track names to the bodies of consecutive frames."""

    count: int = 0
    _last: dict[str, tuple[float, Place]] = field(default_factory=dict)

    def frame(self, now_s: float, bodies: Sequence[Place]) -> list[str]:
        """Return a track name ("1", "2", ...) for each body, positions in m."""
        self._last = {name: seen for name, seen in self._last.items() if now_s - seen[0] <= FORGET_S}
        chosen = _nearest_pairs(now_s, bodies, self._last)
        for index, place in enumerate(bodies):
            if index not in chosen:
                self.count += 1
                chosen[index] = str(self.count)
            self._last[chosen[index]] = (now_s, place)
        return [chosen[index] for index in range(len(bodies))]

    def alone(self, now_s: float, place: Place) -> None:
        """Set the track "1" of the only body so far."""
        self.count, self._last = 1, {"1": (now_s, place)}


def link(t_s: Sequence[float], bodies: Sequence[Sequence[Place]]) -> list[list[str]]:
    """Return a track name ("1", "2", ...) for each body of each frame.

    Args:
        t_s: Times of the frames, s, ascending.
        bodies: Positions in each frame, m.
    """
    if max(map(len, bodies), default=0) <= 1:
        return [["1"] * len(frame) for frame in bodies]
    linker = Linker()
    return [linker.frame(now_s, frame) for now_s, frame in zip(t_s, bodies, strict=True)]


def _nearest_pairs(now_s: float, frame: Sequence[Place], last: dict[str, tuple[float, Place]]) -> dict[int, str]:
    pairs = []
    for name, (then_s, place) in last.items():
        reach = STRIDE_M + WALK_M_S * (now_s - then_s)
        for index, here in enumerate(frame):
            far = math.dist(here, place)
            if far <= reach:
                pairs.append((far, name, index))
    chosen: dict[int, str] = {}
    taken: set[str] = set()
    for _, name, index in sorted(pairs):
        if index not in chosen and name not in taken:
            chosen[index] = name
            taken.add(name)
    return chosen
