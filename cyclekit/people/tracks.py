"""The operator: one position per sample out of the tracks of a session, and the goal of what the operator does.

Of several people the one nearest to the TCP is x_h. A gap in a track stays a gap, apart from short ones that are
bridged; ids that a tracker gives anew with every frame are linked by motion, and a jump that nobody makes is not
believed. Goals come from a button log where there is one, else from where the operator stays for a while; the latter
are marked as inferred. Frames and clocks have been settled before.
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
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Ints, Points, Vector


STAY_M_S = 0.2
"""Below this horizontal speed the operator stands still."""
STAY_S = 0.8
"""A standstill of the operator shorter than this is a hesitation, not an activity."""
SPOT_M = 0.4
"""Stays nearer than this to each other are at one spot: people do not stand twice on the same tile."""


LINK_M_S, LINK_M, FORGET_S = 5.0, 0.15, 1.0
"""A body is the same one as in the last frame if it came no faster than this, beside this much noise; one that was not
seen for FORGET_S is somebody new."""
SHORT_ROWS = 3.0
"""Where half of the rows have an id that lives for fewer frames than this, the ids are no tracks."""
JUMP_M_S, JUMP_M = 20.0, 0.3
"""Maximum plausible speed of a person; a step shorter than JUMP_M is not a jump, however short the time."""
STRAY_S = 0.25
"""A part shorter than this between two jumps is a false detection."""
OCCLUDED_S = 5.0
"""A gap of a track up to this long is one behind something; after a longer one the person may have been away."""
REASONS = ("seen", "occluded", "absent", "outside")
"""Whether a log of people sees somebody, and why not; what an earlier one says holds for all logs of a session."""


@dataclass(frozen=True)
class PersonTrack:
    """One person's track in session time and base frame: `t_s` (T,), `xyz_m` (T, 3), NaN = not seen."""

    person: str
    t_s: Vector
    xyz_m: Points

    @cached_property
    def period_s(self) -> float:
        """Usual time between frames in which the person was seen; infinite where there are none."""
        t = self.t_s[np.isfinite(self.xyz_m[:, :2]).all(axis=1)]
        return float(np.median(np.diff(t))) if len(t) > 1 else np.inf

    def around(self, first_s: float, last_s: float) -> PersonTrack:
        """Return its rows from the last one before `first_s` to the first one behind `last_s`; views."""
        begin, end = np.searchsorted(self.t_s, first_s) - 1, np.searchsorted(self.t_s, last_s, side="right") + 1
        part = slice(max(int(begin), 0), int(end))
        return PersonTrack(self.person, self.t_s[part], self.xyz_m[part])


def at_times(track: PersonTrack, t_s: Vector, *, bridge_s: float, width_s: float = 0.0) -> Points:
    """Return the track at the times `t_s` (N,), shape (N, 3); NaN where no seen position lies near enough.

    Positions are interpolated linearly between seen ones at most `bridge_s` apart (or two frames of the tracker, if
    that is longer: a slow tracker has no gap between its frames), and averaged over `width_s` around each time, so that
    noise and shaking faster than the samples do not pass for motion. The average never looks across a gap: near one it
    is taken over less, evenly on both sides.
    """
    limit = max(bridge_s, 2.0 * track.period_s)
    if not np.isfinite(limit) or len(t_s) == 0:
        return np.full((len(t_s), 3), np.nan)
    part = track.around(float(t_s.min()) - limit - width_s, float(t_s.max()) + limit + width_s)
    seen = np.isfinite(part.xyz_m[:, :2]).all(axis=1)
    t, xyz = part.t_s[seen], part.xyz_m[seen]
    if len(t) < 2:  # alone in a gap: it was seen just then, and not around it
        return np.where(t_s[:, None] == t, xyz, np.nan) if len(t) else np.full((len(t_s), 3), np.nan)
    right = np.clip(np.searchsorted(t, t_s), 1, len(t) - 1)
    inside = (t_s >= t[0]) & (t_s <= t[-1]) & (t[right] - t[right - 1] <= limit)
    inside |= (t[right] == t_s) | (t[right - 1] == t_s)  # seen at exactly this time
    breaks = np.flatnonzero(np.diff(t) > limit)
    begins, ends = t[np.concatenate([[0], breaks + 1])], t[np.concatenate([breaks, [len(t) - 1]])]
    stretch = np.clip(np.searchsorted(begins, t_s, side="right") - 1, 0, None)
    half = np.clip(np.minimum(t_s - begins[stretch], ends[stretch] - t_s), 0.0, 0.5 * width_s)
    out = np.column_stack([_mean_around(t, xyz[:, axis], t_s, half) for axis in range(3)])
    out[~inside] = np.nan
    return out


def _mean_around(t: Vector, x: Vector, at: Vector, half: Vector) -> Vector:
    """Return the mean of the polyline (t, x) from `at - half` to `at + half`, shape (N,); its value where half is 0."""
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
    """Tell whether the ids of a log's rows (N,) last: a tracker may number each frame's bodies anew."""
    counts = np.bincount(ids) if len(ids) else np.empty(0)
    if np.count_nonzero(counts) < 4:
        return True
    return float(np.median(counts[ids])) >= SHORT_ROWS  # by rows: a lasting track among false sightings is one


def link_by_motion(t_s: Vector, xyz_m: Points) -> Ints:
    """Return a track number for each row, joining each body to the nearest one of the last frame that it can be.

    Where two people pass within a step of a frame they may be exchanged, which changes nothing about the distance to
    the nearest of them.

    Args:
        t_s: Times, shape (N,), ascending; the bodies of one frame have the same time.
        xyz_m: Positions, shape (N, 3), metres; rows without one belong to nobody (-1).
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
    """Return the track of each row that continues one: nearest pairs first."""
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
    """Return the parts of a track between implausible jumps, and how many positions are implausible.

    A false sighting is taken out and the track goes on; after a lasting jump (the tracker took somebody else for the
    person) another part begins, so that nothing is interpolated across it.
    """
    seen = np.flatnonzero(np.isfinite(track.xyz_m[:, :2]).all(axis=1))
    rows = seen
    while len(rows) > 1 and (stray := _strays(track, rows)).any():
        rows = rows[~stray]
    xyz, dropped = track.xyz_m, np.setdiff1d(seen, rows)
    if len(dropped):
        xyz = xyz.copy()
        xyz[dropped] = np.nan
    starts = rows[_jumps(track, rows)].tolist() if len(rows) > 1 else []
    parts = [slice(begin, end) for begin, end in pairwise([0, *starts, len(xyz)])]  # views: of many hours there is much
    return [PersonTrack(track.person, track.t_s[part], xyz[part]) for part in parts], len(dropped)


def _strays(track: PersonTrack, rows: Ints) -> Bools:
    """Tell which rows belong to a part between jumps that is short, and shorter than the parts beside it."""
    cuts = _jumps(track, rows)
    starts, ends = np.concatenate([[0], cuts]), np.concatenate([cuts, [len(rows)]])
    length = track.t_s[rows[ends - 1]] - track.t_s[rows[starts]]
    if len(starts) == 1 or length.max() <= 0:
        return np.zeros(len(rows), bool)
    order = length + 1e-9 * np.modf(0.618 * np.arange(len(length)))[0]  # of parts equally short some go first
    beside = np.concatenate([[np.inf], order, [np.inf]])
    stray = (length < STRAY_S) & (order < beside[:-2]) & (order < beside[2:])
    return np.repeat(stray, ends - starts)


def _jumps(track: PersonTrack, rows: Ints) -> Ints:
    """Return the indices into `rows` that are implausibly far from the row before."""
    step = np.linalg.norm(np.diff(track.xyz_m[rows, :2], axis=0), axis=1)
    return np.flatnonzero(step > np.maximum(JUMP_M, JUMP_M_S * np.diff(track.t_s[rows]))) + 1


def gap_reasons(
    tracks: Sequence[PersonTrack], t_s: Vector, span_s: tuple[float, float], *, bridge_s: float
) -> NDArray[np.int8]:
    """Return for each time whether an operator is seen, or why not; shape (N,), indices into REASONS.

    Args:
        tracks: All that one log saw.
        t_s: Times, shape (N,).
        span_s: First and last time of the log.
        bridge_s: Gaps up to this long are bridged.

    Returns:
        `seen`; `outside`: the log had not begun or was over; `occluded`: within a track that goes on within
        OCCLUDED_S; `absent`: no such track.
    """
    seen, hidden = np.zeros(len(t_s), bool), np.zeros(len(t_s), bool)
    for track in tracks:
        seen |= np.isfinite(at_times(track, t_s, bridge_s=bridge_s)[:, 0])
    for person in {track.person for track in tracks}:
        known = [t.t_s[np.isfinite(t.xyz_m[:, :2]).all(axis=1)] for t in tracks if t.person == person]
        times = np.sort(np.concatenate(known))
        if len(times) > 1:
            right = np.clip(np.searchsorted(times, t_s), 1, len(times) - 1)
            between = (t_s >= times[0]) & (t_s <= times[-1])
            hidden |= between & (times[right] - times[right - 1] <= OCCLUDED_S)
    outside = (t_s < span_s[0]) | (t_s > span_s[1])
    numbers = {name: number for number, name in enumerate(REASONS)}
    why = np.where(outside, numbers["outside"], np.where(hidden, numbers["occluded"], numbers["absent"]))
    return np.where(seen, numbers["seen"], why).astype(np.int8)


def nearest_person(
    tracks: Sequence[PersonTrack], t_s: Vector, tcp_m: Points, *, bridge_s: float, width_s: float = 0.0
) -> Points:
    """Return x_h at each time, shape (N, 3): the position of the person nearest to the TCP, NaN = nobody seen.

    Where the TCP is unknown the first person seen counts. See `at_times` for `bridge_s` and `width_s`.
    """
    best = np.full((len(t_s), 3), np.nan)
    distance = np.full(len(t_s), np.inf)
    for track in tracks:
        here = at_times(track, t_s, bridge_s=bridge_s, width_s=width_s)
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
    still = speed < STAY_M_S  # NaN compares false: an unseen operator does not stay
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
        spots[f"spot_{number}"] = spot(f"spot_{number}", stays[group])
    return spots


def spot(name: str, points: Points) -> Place:
    """Return the place in the middle of stays (M, 3), m; without any height it lies at that of the robot's base, 0."""
    heights = points[np.isfinite(points[:, 2]), 2]
    x, y = (round(float(v), 4) for v in np.nanmedian(points[:, :2], axis=0))
    return Place(name, (x, y, round(float(np.median(heights)), 4) if len(heights) else 0.0), SPOT_M, inferred=True)


def goals_from_stays(
    stays: Sequence[tuple[int, int]], at_m: Points, samples: int, spots: Mapping[str, Place]
) -> list[str | None]:
    """Return the goal per sample: the spot of the stay that is running or comes next, None when none follows.

    `stays` are from `find_stays`, `at_m` is where the operator was in each, shape (M, 3), metres.
    """
    goals: list[str | None] = [None] * samples
    names = list(spots)
    centres = np.array([spots[name].xyz_m[:2] for name in names]).reshape(-1, 2)
    begin = 0
    for (_, last), xyz_m in zip(stays, at_m, strict=True):
        far = np.linalg.norm(centres - xyz_m[:2], axis=1)
        if len(far) and far.min() <= SPOT_M:
            goals[begin : last + 1] = [names[int(far.argmin())]] * (last + 1 - begin)
        begin = last + 1
    return goals
