"""The operator's position per sample, from the tracks of a session, and his goals.

Of several people, the one nearest to the TCP is x_h; the samples with several are counted. Only short gaps in a track
are bridged; ids that change with every frame are replaced by linking positions by motion; implausible jumps are
removed. Goals come from a button log if there is one, otherwise from the operator's standstills; the latter are marked
as inferred. Frames and clocks are aligned before.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.dataset import Place
from cyclekit.segmentation.places import cluster

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Floats, Ints, Points, Vector


STILL_M_S = 0.2
"""Horizontal speed, m/s, below which the operator stands still."""
STILL_S, BRIEF_S = 0.8, 0.2
"""Minimum duration of a standstill, s; shorter ones are hesitations, except where the operator is always quick. Those
shorter than the second value never count."""
PLACE_M = 0.4
"""Maximum distance, m, of standstills at the same place."""


LINK_M_S, LINK_M, FORGET_S = 5.0, 0.15, 1.0
"""Linking of bodies between frames: maximum speed, m/s, position noise, m, and time unseen, s, after which a body is a
new one."""
SHORT_ROWS = 3.0
"""Minimum number of frames per id, as a median over rows, for ids that persist."""
JUMP_M_S, JUMP_M = 20.0, 0.3
"""Maximum plausible speed of a person, m/s; a step shorter than JUMP_M, m, is never a jump."""
STRAY_S = 0.25
"""Maximum duration, s, of a part between two jumps that is a false detection."""
OCCLUDED_S = 5.0
"""Maximum duration of a gap by occlusion, s; in a longer one the person may have been absent."""
REASONS = ("seen", "occluded", "absent", "outside")
"""Whether a log of people sees an operator, or why not; over all logs of a session, the first in this order counts."""


@dataclass(frozen=True)
class PersonTrack:
    """One person's track in session time and base frame: `t_s` (T,), s, `xyz_m` (T, 3), m; NaN = not seen."""

    person: str
    t_s: Vector
    xyz_m: Points

    @cached_property
    def period_s(self) -> float:
        """Median time between frames with a position, s; infinite for fewer than two."""
        t = self.t_s[np.isfinite(self.xyz_m[:, :2]).all(axis=1)]
        return float(np.median(np.diff(t))) if len(t) > 1 else np.inf

    @cached_property
    def span_s(self) -> tuple[float, float]:
        """First and last time of its frames, s; no time lies between them if there are none."""
        return (float(self.t_s[0]), float(self.t_s[-1])) if len(self.t_s) else (np.inf, -np.inf)

    def around(self, first_s: float, last_s: float) -> PersonTrack:
        """Return views of its rows from the last one before `first_s` to the first one after `last_s`."""
        begin, end = np.searchsorted(self.t_s, first_s) - 1, np.searchsorted(self.t_s, last_s, side="right") + 1
        part = slice(max(int(begin), 0), int(end))
        return PersonTrack(self.person, self.t_s[part], self.xyz_m[part])


def at_times(track: PersonTrack, t_s: Vector, *, bridge_s: float, width_s: float = 0.0) -> Points:
    """Return the track at times `t_s` (N,), shape (N, 3), m; NaN if no position is near enough.

    Positions are interpolated linearly if at most `bridge_s` apart (or two frames of the tracker, if that is longer),
    and averaged over `width_s` around each time, so that noise faster than the samples does not appear as motion. The
    average does not extend across a gap; near one it is shorter, symmetric to the time.
    """
    limit = max(bridge_s, 2.0 * track.period_s)
    if not np.isfinite(limit) or len(t_s) == 0:
        return np.full((len(t_s), 3), np.nan)
    part = track.around(float(t_s.min()) - limit - width_s, float(t_s.max()) + limit + width_s)
    seen = np.isfinite(part.xyz_m[:, :2]).all(axis=1)
    t, xyz = part.t_s[seen], part.xyz_m[seen]
    if len(t) < 2:  # a single position counts only at its own time
        return np.where(t_s[:, None] == t, xyz, np.nan) if len(t) else np.full((len(t_s), 3), np.nan)
    right = np.clip(np.searchsorted(t, t_s), 1, len(t) - 1)
    inside = (t_s >= t[0]) & (t_s <= t[-1]) & (t[right] - t[right - 1] <= limit)
    inside |= (t[right] == t_s) | (t[right - 1] == t_s)  # exactly at a frame
    breaks = np.flatnonzero(np.diff(t) > limit)
    begins, ends = t[np.concatenate([[0], breaks + 1])], t[np.concatenate([breaks, [len(t) - 1]])]
    stretch = np.clip(np.searchsorted(begins, t_s, side="right") - 1, 0, None)
    half = np.clip(np.minimum(t_s - begins[stretch], ends[stretch] - t_s), 0.0, 0.5 * width_s)
    out = np.column_stack([_mean_around(t, xyz[:, axis], t_s, half) for axis in range(3)])
    out[~inside] = np.nan
    return out


def _mean_around(t: Vector, x: Vector, at: Vector, half: Vector) -> Vector:
    """Return the mean of the polyline (t, x) from `at - half` to `at + half`, shape (N,); its value if `half` is 0."""
    value = np.interp(at, t, x)
    if not (half > 0.0).any() or np.isnan(x).any():
        return value
    area = np.concatenate([[0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))])

    def until(end: Vector) -> Vector:
        left = np.clip(np.searchsorted(t, end, side="right") - 1, 0, len(t) - 1)
        return np.asarray(area[left] + 0.5 * (x[left] + np.interp(end, t, x)) * (end - t[left]))

    wide = half > 1e-6
    mean = (until(at + half) - until(at - half)) / np.where(wide, 2.0 * half, 1.0)
    return np.where(wide, mean, value)


def ids_are_real(ids: Ints) -> bool:
    """Return whether the ids of a log's rows (N,) persist; a tracker may number the bodies of each frame anew."""
    counts = np.bincount(ids) if len(ids) else np.empty(0)
    if np.count_nonzero(counts) < 4:
        return True
    return float(np.median(counts[ids])) >= SHORT_ROWS  # by rows, so that a lasting track among false detections counts


def link_by_motion(t_s: Vector, xyz_m: Points) -> Ints:
    """Return a track number for each row, linking each body to the nearest one of the last frame within reach.

    People who pass each other closely may be exchanged; the distance of the nearest person stays correct.

    Args:
        t_s: Times, shape (N,), s, ascending; the bodies of one frame have the same time.
        xyz_m: Positions, shape (N, 3), m; rows without one get -1.
    """
    track = np.full(len(t_s), -1, np.int64)
    seen = np.flatnonzero(np.isfinite(xyz_m[:, :2]).all(axis=1))
    if len(seen) == 0:
        return track
    flat = np.nan_to_num(xyz_m)
    frames = np.split(seen, np.flatnonzero(np.diff(t_s[seen])) + 1)
    alive: list[tuple[int, int]] = []  # (track, its last row)
    count = 0
    for rows in frames:
        now = float(t_s[rows[0]])
        alive = [(name, row) for name, row in alive if now - t_s[row] <= FORGET_S]
        chosen = _continuations(now, rows, alive, t_s, flat)
        for row in rows.tolist():
            if row not in chosen:
                chosen[row] = count
                count += 1
            track[row] = chosen[row]
        taken = set(chosen.values())
        alive = [(name, row) for name, row in alive if name not in taken] + [(n, r) for r, n in chosen.items()]
    return track


def _continuations(
    now: float, rows: Ints, alive: Sequence[tuple[int, int]], t_s: Vector, xyz: Points
) -> dict[int, int]:
    """Return the track of each row that continues one; nearest pairs first."""
    if not alive:
        return {}
    last = np.array([row for _, row in alive])
    apart = np.linalg.norm(xyz[rows][:, None, :] - xyz[last][None, :, :], axis=2)
    apart[apart > LINK_M + LINK_M_S * (now - t_s[last])[None, :]] = np.inf
    chosen: dict[int, int] = {}
    while np.isfinite(low := apart.min()):
        i, j = np.unravel_index(int(np.flatnonzero(apart.ravel() == low)[0]), apart.shape)
        chosen[int(rows[i])] = alive[int(j)][0]
        apart[i, :], apart[:, j] = np.inf, np.inf
    return chosen


def without_jumps(track: PersonTrack) -> tuple[list[PersonTrack], int]:
    """Return the parts of a track between implausible jumps, and the number of implausible positions.

    A false detection is removed and the track continues; after a lasting jump (the tracker switched to another person)
    a new part starts, so that nothing is interpolated across it.
    """
    seen = np.flatnonzero(np.isfinite(track.xyz_m[:, :2]).all(axis=1))
    rows = seen
    while len(rows) > 1 and (stray := _strays(track, rows)).any():
        rows = rows[~stray]
    xyz, dropped = track.xyz_m, np.setdiff1d(seen, rows, assume_unique=True)
    if len(dropped):
        xyz = xyz.copy()
        xyz[dropped] = np.nan
    starts = rows[_jumps(track, rows)].tolist() if len(rows) > 1 else []
    parts = [slice(begin, end) for begin, end in pairwise([0, *starts, len(xyz)])]  # views, to save memory
    return [PersonTrack(track.person, track.t_s[part], xyz[part]) for part in parts], len(dropped)


def _strays(track: PersonTrack, rows: Ints) -> Bools:
    """Return which rows are in a part between jumps that is short, and shorter than its neighbours."""
    cuts = _jumps(track, rows)
    starts, ends = np.concatenate([[0], cuts]), np.concatenate([cuts, [len(rows)]])
    length = track.t_s[rows[ends - 1]] - track.t_s[rows[starts]]
    if len(starts) == 1 or length.max() <= 0:
        return np.zeros(len(rows), bool)
    order = length + 1e-9 * np.modf(0.618 * np.arange(len(length)))[0]  # breaks ties between equally short parts
    beside = np.concatenate([[np.inf], order, [np.inf]])
    stray = (length < STRAY_S) & (order < beside[:-2]) & (order < beside[2:])
    return np.repeat(stray, ends - starts)


def _jumps(track: PersonTrack, rows: Ints) -> Ints:
    """Return the indices into `rows` of those implausibly far from the previous row."""
    step = np.linalg.norm(np.diff(track.xyz_m[rows, :2], axis=0), axis=1)
    return np.flatnonzero(step > np.maximum(JUMP_M, JUMP_M_S * np.diff(track.t_s[rows]))) + 1


def gap_reasons(
    tracks: Sequence[PersonTrack], t_s: Vector, span_s: tuple[float, float], *, bridge_s: float
) -> NDArray[np.int8]:
    """Return for each time whether an operator is seen, or why not; shape (N,), indices into REASONS.

    Args:
        tracks: All tracks of one log.
        t_s: Times, shape (N,), s.
        span_s: First and last time of the log.
        bridge_s: Maximum duration of a bridged gap, s.

    Returns:
        `seen`; `outside`: before the start or after the end of the log; `occluded`: within a track that continues
        within OCCLUDED_S; `absent`: none of these.
    """
    seen, hidden = np.zeros(len(t_s), bool), np.zeros(len(t_s), bool)
    for track, rows in _during(tracks, t_s):
        seen[rows] |= np.isfinite(at_times(track, t_s[rows], bridge_s=bridge_s)[:, 0])
    near: dict[str, list[Vector]] = {}  # frames further away end no gap that counts as occluded
    for track, _ in _during(tracks, t_s, OCCLUDED_S):
        part = track.around(float(t_s.min()) - OCCLUDED_S, float(t_s.max()) + OCCLUDED_S)
        near.setdefault(track.person, []).append(part.t_s[np.isfinite(part.xyz_m[:, :2]).all(axis=1)])
    for known in near.values():
        times = np.sort(np.concatenate(known))
        if len(times) > 1:
            right = np.clip(np.searchsorted(times, t_s), 1, len(times) - 1)
            between = (t_s >= times[0]) & (t_s <= times[-1])
            hidden |= between & (times[right] - times[right - 1] <= OCCLUDED_S)
    outside = (t_s < span_s[0]) | (t_s > span_s[1])
    numbers = {name: number for number, name in enumerate(REASONS)}
    why = np.where(outside, numbers["outside"], np.where(hidden, numbers["occluded"], numbers["absent"]))
    return np.where(seen, numbers["seen"], why).astype(np.int8)


def _during(tracks: Sequence[PersonTrack], t_s: Vector, reach_s: float = 0.0) -> Iterator[tuple[PersonTrack, slice]]:
    """Yield the tracks that last during times (N,), ascending, or end or begin within `reach_s` of them.

    With each the rows of `t_s` during the track: elsewhere it has no position. A log may hold many thousand tracks.
    """
    first_s, last_s = (float(t_s[0]) - reach_s, float(t_s[-1]) + reach_s) if len(t_s) else (np.inf, -np.inf)
    for track in tracks:
        begin_s, end_s = track.span_s
        if begin_s <= last_s and end_s >= first_s:
            yield track, slice(int(np.searchsorted(t_s, begin_s)), int(np.searchsorted(t_s, end_s, side="right")))


def nearest_person(
    tracks: Sequence[PersonTrack], t_s: Vector, tcp_m: Points, *, bridge_s: float, width_s: float = 0.0
) -> tuple[Points, Bools]:
    """Return x_h at each time, shape (N, 3), m: position of the person nearest to the TCP, NaN = nobody seen.

    Also return when people are seen more than PLACE_M apart, shape (N,): nearer tracks may be of one body. If the TCP
    is unknown, the first person seen counts. See `at_times` for `bridge_s` and `width_s`.
    """
    best = np.full((len(t_s), 3), np.nan)
    distance, several = np.full(len(t_s), np.inf), np.zeros(len(t_s), bool)
    for track, rows in _during(tracks, t_s):
        here, best_m, apart_m = (
            at_times(track, t_s[rows], bridge_s=bridge_s, width_s=width_s),
            best[rows],
            distance[rows],
        )
        several[rows] |= np.linalg.norm((here - best_m)[:, :2], axis=1) > PLACE_M  # NaN compares false
        offset = np.where(np.isfinite(tcp_m[rows]), here - tcp_m[rows], 0.0)
        offset[~np.isfinite(here[:, 2]), 2] = 0.0
        far = np.linalg.norm(offset, axis=1)
        better = np.isfinite(here[:, 0]) & (far < apart_m)
        best_m[better], apart_m[better] = here[better], far[better]
    return best, several


def goals_from_events(t_event_s: Vector, values: Sequence[str], t_s: Vector) -> list[str | None]:
    """Return the goal at each time: the value of the last goal event, None before the first."""
    last = np.searchsorted(t_event_s, t_s, side="right") - 1
    return [values[i] if i >= 0 else None for i in last.tolist()]


def find_operator_standstills(t_s: Vector, human_m: Points) -> list[tuple[int, int]]:
    """Return the standstills in one execution's samples as (first, last) rows: slow for at least BRIEF_S.

    People at work sway, reach and step aside: a standstill continues as long as they stay within PLACE_M of it, also
    where the tracker loses them for at most OCCLUDED_S. One that is not seen to begin or to end is cut by the log.
    """
    if len(t_s) < 3:
        return []
    speed = np.linalg.norm(np.gradient(human_m[:, :2], t_s, axis=0), axis=1)
    still = speed < STILL_M_S  # NaN compares false: an unseen operator is not at a standstill
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    spans = [(a, b - 1) for a, b in edges.reshape(-1, 2).tolist()]
    return [(a, b) for a, b in _stays(spans, t_s, human_m[:, :2]) if t_s[b] - t_s[a] >= BRIEF_S]


def _stays(spans: Sequence[tuple[int, int]], t_s: Vector, at_m: Floats) -> list[tuple[int, int]]:
    """Join spans of (first, last) rows between which all positions, shape (T, 2), m, are within PLACE_M of the first.

    Nothing is joined across a longer time without a position than OCCLUDED_S: he may have been away.
    """
    found: list[tuple[int, int]] = []
    centre = np.full(2, np.nan)

    def stays(first: int, last: int) -> bool:
        rows = np.arange(first, last + 1)
        rows = rows[np.isfinite(at_m[rows]).all(axis=1)]
        near = np.linalg.norm(at_m[rows] - centre, axis=1) <= PLACE_M
        return bool(near.all() and np.diff(t_s[[first, *rows, last]]).max(initial=0.0) <= OCCLUDED_S)

    for first, last in spans:
        if found and stays(found[-1][1], last):
            found[-1] = found[-1][0], last
            continue
        centre = np.median(at_m[first : last + 1], axis=0)
        found.append((first if found or not stays(0, first) else 0, last))
    if found and stays(found[-1][1], len(t_s) - 1):
        found[-1] = found[-1][0], len(t_s) - 1
    return found


def find_operator_places(standstills: Points) -> dict[str, Place]:
    """Return the places of the operator from standstills (M, 3), m, named `spot_1`, ... by frequency.

    A place needs at least two standstills and 1 % of all of them.
    """
    rows = np.arange(len(standstills), dtype=np.int64)
    floor = np.column_stack([standstills[:, :2], np.zeros(len(standstills))])
    groups = [g for g in cluster(floor, rows, PLACE_M) if len(g) >= max(2, 0.01 * len(standstills))]
    places = {}
    for number, group in enumerate(sorted(groups, key=len, reverse=True), 1):
        places[f"spot_{number}"] = operator_place(f"spot_{number}", standstills[group])
    return places


def operator_place(name: str, points: Points) -> Place:
    """Return the place at the median of standstills (M, 3), m; without heights its z is 0, that of the robot's base."""
    heights = points[np.isfinite(points[:, 2]), 2]
    x, y = (round(float(v), 4) for v in np.nanmedian(points[:, :2], axis=0))
    return Place(name, (x, y, round(float(np.median(heights)), 4) if len(heights) else 0.0), PLACE_M, inferred=True)


def nearest_places(at_m: Points, places: Mapping[str, Place]) -> list[str | None]:
    """Return the place of each position (M, 3), m: the nearest one that reaches so far; None if none does."""
    names = list(places)
    centres = np.array([places[name].xyz_m[:2] for name in names]).reshape(-1, 2)
    reach_m = np.array([max(places[name].radius_m, PLACE_M) for name in names])
    found: list[str | None] = []
    for xyz_m in at_m:
        far = np.linalg.norm(centres - xyz_m[:2], axis=1)
        near = int(far.argmin()) if len(far) else -1
        found.append(names[near] if len(far) and far[near] <= reach_m[near] else None)
    return found


def goals_from_standstills(
    standstills: Sequence[tuple[int, int]], at_m: Points, samples: int, places: Mapping[str, Place]
) -> list[str | None]:
    """Return the goal per sample: the place of the present or next standstill, None if none follows.

    `standstills` are from `find_operator_standstills`; `at_m` are the operator's positions in them, shape (M, 3), m.
    """
    goals: list[str | None] = [None] * samples
    begin = 0
    for (_, last), name in zip(standstills, nearest_places(at_m, places), strict=True):
        goals[begin : last + 1] = [name] * (last + 1 - begin)
        begin = last + 1
    return goals
