"""Which body of this frame is which body of the last one, where a log's own ids do not say it.

People walk: between two frames a body moves less than a stride, so each body is the track that is nearest to it. A
track that nobody continued for a second is over. Where two people pass within a stride they may be exchanged, which
does not matter for a distance to the nearest of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

Place = tuple[float, float, float]

STRIDE_M = 0.5
"""How far a body may seem to jump between two frames, however short the time: trackers are no better."""
WALK_M_S = 3.0
"""How fast it may go beyond that."""
FORGET_S = 1.0
"""A track not seen for so long is over: who comes next is somebody new."""


@dataclass
class Linker:
    """Names the bodies of one frame after the other."""

    count: int = 0
    _last: dict[str, tuple[float, Place]] = field(default_factory=dict)

    def frame(self, now_s: float, bodies: Sequence[Place]) -> list[str]:
        """Return a track name ("1", "2", ...) for each body, positions in metres."""
        self._last = {name: seen for name, seen in self._last.items() if now_s - seen[0] <= FORGET_S}
        chosen = _nearest_pairs(now_s, bodies, self._last)
        for index, place in enumerate(bodies):
            if index not in chosen:
                self.count += 1
                chosen[index] = str(self.count)
            self._last[chosen[index]] = (now_s, place)
        return [chosen[index] for index in range(len(bodies))]

    def alone(self, now_s: float, place: Place) -> None:
        """Take note of the only body there has been so far, whose name is "1"."""
        self.count, self._last = 1, {"1": (now_s, place)}


def link(t_s: Sequence[float], bodies: Sequence[Sequence[Place]]) -> list[list[str]]:
    """Return a track name ("1", "2", ...) for each body of each frame.

    Args:
        t_s: Times of the frames, ascending.
        bodies: Positions in each frame, metres.
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
