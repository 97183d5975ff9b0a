"""Which body of this frame is which body of the last one, where a log's own ids do not say it.

People walk: between two frames a body moves less than a stride, so each body is the track that is nearest to it. A
track that nobody continued for a second is over. Where two people pass within a stride they may be exchanged, which
does not matter for a distance to the nearest of them.
"""

from __future__ import annotations

import math
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


def link(t_s: Sequence[float], bodies: Sequence[Sequence[Place]]) -> list[list[str]]:
    """Return a track name ("1", "2", ...) for each body of each frame.

    Args:
        t_s: Times of the frames, ascending.
        bodies: Positions in each frame, metres.
    """
    if max(map(len, bodies), default=0) <= 1:
        return [["1"] * len(frame) for frame in bodies]
    last: dict[str, tuple[float, Place]] = {}
    names: list[list[str]] = []
    count = 0
    for now_s, frame in zip(t_s, bodies, strict=True):
        last = {name: seen for name, seen in last.items() if now_s - seen[0] <= FORGET_S}
        chosen = _nearest_pairs(now_s, frame, last)
        for index in range(len(frame)):
            if index not in chosen:
                count += 1
                chosen[index] = str(count)
            last[chosen[index]] = (now_s, frame[index])
        names.append([chosen[index] for index in range(len(frame))])
    return names


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
