"""The operator: one position per sample out of the tracks of a session, and the goal of what the operator does.

Of several people the one nearest to the TCP is x_h. A gap in a track stays a gap, apart from short ones that are
bridged. Goals come from a button log where there is one, else from where the operator stays for a while; the latter
are marked as inferred. Frames and clocks have been settled before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset import Place
from cyclekit.segment import cluster

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]

STAY_M_S = 0.2
"""An operator slower than this (horizontally) stays."""
STAY_S = 0.8
"""A stay shorter than this is a hesitation, not an activity."""
SPOT_M = 0.4
"""Stays nearer than this to each other are at one spot: people do not stand twice on the same tile."""


@dataclass(frozen=True)
class Track:
    """One person's track in session time and base frame: `t_s` (T,), `xyz_m` (T, 3), NaN = not seen."""

    person: str
    t_s: Vector
    xyz_m: Points


def at_times(track: Track, t_s: Vector, *, bridge_s: float) -> Points:
    """Return the track at the times `t_s` (N,), shape (N, 3); NaN where no seen position lies near enough.

    Positions are interpolated linearly between seen ones at most `bridge_s` apart (or two frames of the tracker, if
    that is longer: a slow tracker has no gap between its frames).
    """
    seen = np.isfinite(track.xyz_m[:, :2]).all(axis=1)
    t, xyz = track.t_s[seen], track.xyz_m[seen]
    if len(t) < 2:
        return np.full((len(t_s), 3), np.nan)
    limit = max(bridge_s, 2.0 * float(np.median(np.diff(t))))
    right = np.clip(np.searchsorted(t, t_s), 1, len(t) - 1)
    gap = t[right] - t[right - 1]
    inside = (t_s >= t[0]) & (t_s <= t[-1]) & (gap <= limit)
    out = np.column_stack([np.interp(t_s, t, xyz[:, axis]) for axis in range(3)])
    out[~inside] = np.nan
    return out


def nearest_person(tracks: Sequence[Track], t_s: Vector, tcp_m: Points, *, bridge_s: float) -> Points:
    """Return x_h at each time, shape (N, 3): the position of the person nearest to the TCP, NaN = nobody seen.

    Where the TCP is unknown the first person seen counts.
    """
    best = np.full((len(t_s), 3), np.nan)
    distance = np.full(len(t_s), np.inf)
    for track in tracks:
        here = at_times(track, t_s, bridge_s=bridge_s)
        offset = np.where(np.isfinite(tcp_m), here - tcp_m, 0.0)
        offset[~np.isfinite(here[:, 2]), 2] = 0.0
        far = np.linalg.norm(offset, axis=1)
        better = np.isfinite(here[:, 0]) & (far < distance)
        best[better], distance[better] = here[better], far[better]
    return best


def goals_from_events(t_event_s: Vector, values: Sequence[str], t_s: Vector) -> list[str | None]:
    """Return the goal in force at each time: the value of the last goal event, None before the first."""
    last = np.searchsorted(t_event_s, t_s, side="right") - 1
    return [values[i] if i >= 0 else None for i in last.tolist()]


def find_stays(t_s: Vector, human_m: Points) -> list[tuple[int, int]]:
    """Return the stays of one execution's samples as (first, last) rows: slow for at least STAY_S."""
    if len(t_s) < 3:
        return []
    speed = np.linalg.norm(np.gradient(human_m[:, :2], t_s, axis=0), axis=1)
    still = speed < STAY_M_S  # NaN compares false: nobody seen is no stay
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    spans = [(a, b - 1) for a, b in edges.reshape(-1, 2).tolist()]
    return [(a, b) for a, b in spans if t_s[b] - t_s[a] >= STAY_S]


def find_spots(stays: Points) -> dict[str, Place]:
    """Return the spots where the operator stays, named `spot_1`, ... by how often, out of stays (M, 3), metres.

    A spot needs at least two stays and a hundredth of all of them.
    """
    rows = np.arange(len(stays), dtype=np.int64)
    floor = np.column_stack([stays[:, :2], np.zeros(len(stays))])
    groups = [g for g in cluster(floor, rows, SPOT_M) if len(g) >= max(2, 0.01 * len(stays))]
    spots = {}
    for number, group in enumerate(sorted(groups, key=len, reverse=True), 1):
        x, y, z = (round(float(v), 4) for v in np.nanmedian(stays[group], axis=0))
        spots[f"spot_{number}"] = Place(f"spot_{number}", (x, y, z), SPOT_M, inferred=True)
    return spots


def goals_from_stays(stays: Sequence[tuple[int, int]], human_m: Points, spots: Mapping[str, Place]) -> list[str | None]:
    """Return the goal per sample: the spot of the stay that is running or comes next, None when none follows."""
    goals: list[str | None] = [None] * len(human_m)
    names = list(spots)
    centres = np.array([spots[name].xyz_m[:2] for name in names]).reshape(-1, 2)
    begin = 0
    for first, last in stays:
        far = np.linalg.norm(centres - np.median(human_m[first : last + 1, :2], axis=0), axis=1)
        if len(far) and far.min() <= SPOT_M:
            goals[begin : last + 1] = [names[int(far.argmin())]] * (last + 1 - begin)
        begin = last + 1
    return goals
