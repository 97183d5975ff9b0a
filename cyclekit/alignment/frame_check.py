"""Check of a tracker's pose by the slow-downs of the robot.

Where the distance decides the speed, each change of level comes at the same distance from TCP to operator, but only in
the right frame. The check finds a wrong frame and proposes the right one, without extra measurement. Zones on the
floor, which ignore the TCP, give no proposal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Floats, Ints, Vector

    People = NDArray[np.float64]
    """Positions of all people at each time, shape (N, K, 3), m; NaN = not seen, or height unknown."""
    Poses = NDArray[np.float64]
    """Yaw, rad, and x, y and z of the origin, m, shape (P, 4)."""
    Found = tuple[Vector, float]
    """A pose, shape (4,), and its score."""

BIN_M, FARTHEST_M = 0.05, 4.0
"""Width of the bins of distance, m; all distances beyond the last bin share one."""
TURN_DEG, SHIFT_M, AROUND_M = 10.0, 0.25, 2.5
"""Search grid: steps of yaw, deg, and position, m; half width, m, around poses that put people at the stopped robot."""
COARSE, COARSE_CHANGES, COARSE_ROUNDS = 1000, 100, 3
"""Maximum numbers of samples for the grid, and of changes and rounds for the choice among its best poses."""
STARTS, APART_M = 6, 0.4
"""Number of grid poses that are refined, and their minimum distance, m, by the mean position of the people."""
ROUNDS, MOVES = 9, 6
"""A pattern search has rounds of at most MOVES moves; each round halves the steps."""
MIN_SAMPLES, MIN_CHANGES, MIN_CHANGES_OF_KIND = 500, 60, 8
"""Minimum number of samples, of changes of level, and of changes of one kind."""
MAX_SPREAD_M, MAX_RATIO = 0.06, 0.5
"""Maximum spread of the distances in a proposed frame, m, and maximum ratio to the spread in the present one."""
MAX_ROUGH_SPREAD_M = 0.12
"""Maximum spread after the rough search, m."""
MIN_EXPLAINED = 0.7
"""Minimum share of levels that the distance explains in a proposed frame."""
MAX_HALVES_APART_M = 0.1
"""Maximum median distance between positions by the frames of two halves of the changes, m."""
MIN_SHIFT_M = 0.1
"""Minimum median shift of positions for a proposal, m."""
_BATCH = 32
"""Number of poses that are scored at once: their distances stay in the cache of the processor."""


@dataclass(frozen=True)
class FrameProposal:
    """A correction of the tracker's frame: p = turn(yaw) @ p_present + xyz.

    Attributes:
        yaw_deg, xyz_m: The correction, in the robot base frame. z is 0 if the distance on the floor decides.
        spread_m, present_m: Median deviation of the distances at changes of level, with it and without, m.
        moved_m: Median shift of the people's positions, m.
    """

    yaw_deg: float
    xyz_m: tuple[float, float, float]
    spread_m: float
    present_m: float
    moved_m: float


@dataclass(frozen=True)
class LevelRows:
    """Samples on a level: TCP (N, 3), m, people (N, K, 3), m, both in the robot base frame, and level (N,)."""

    tcp_m: Floats
    people_m: People
    level: Ints

    def explained(self, poses: Poses) -> Vector:
        """Return the share of levels that the best staircase over the distance explains, per pose, shape (P,).

        The distance is the one on the floor to the nearest person. Each level counts the same.
        """
        index = np.unique(self.level, return_inverse=True)[1]
        weight = 1.0 / np.bincount(index)[index]
        parts = [poses[i : i + _BATCH] for i in range(0, len(poses), _BATCH)]
        return np.concatenate([self._explained(part, index, weight) for part in parts])

    def _explained(self, poses: Poses, level: Ints, weight: Vector) -> Vector:
        apart = np.minimum(nearest_m(self.tcp_m, self.people_m, poses), FARTHEST_M)
        bins, levels = round(FARTHEST_M / BIN_M) + 1, int(level.max()) + 1
        cell = (apart / BIN_M).astype(np.int64) * levels + level + np.arange(len(poses))[:, None] * (bins * levels)
        weights = np.broadcast_to(weight, cell.shape).ravel()
        count = np.bincount(cell.ravel(), weights, len(poses) * bins * levels).reshape(len(poses), bins, levels)
        right = np.zeros((len(poses), levels))  # best staircase over the bins so far, by the level of the last one
        for at in range(bins):
            right = np.maximum.accumulate(right, axis=1) + count[:, at]
        return np.asarray(right.max(axis=1) / weight.sum())


@dataclass(frozen=True)
class ChangeRows:
    """Changes of level: TCP (L, C, 3) and people (L, C, K, 3), m, at L times before each change, and its kind (C,)."""

    tcp_m: Floats
    people_m: People
    kind: Ints

    @classmethod
    def of(cls, tcp_m: Floats, people_m: People, kind: Ints) -> ChangeRows:
        """Leave out kinds with too few changes."""
        usual = np.bincount(kind, minlength=1)[kind] >= MIN_CHANGES_OF_KIND
        return cls(tcp_m[:, usual], people_m[:, usual], kind[usual])

    def spread_m(self, poses: Poses, *, in_space: bool) -> Vector:
        """Return the median deviation of the distances from the median of their kind, per pose, shape (P,), m.

        The time before the change at which they agree best counts.
        """
        spreads = [self._spread(poses, late, in_space=in_space) for late in range(len(self.tcp_m))]
        return np.asarray(np.min(spreads, axis=0))

    def _spread(self, poses: Poses, late: int, *, in_space: bool) -> Vector:
        apart = nearest_m(self.tcp_m[late], self.people_m[late], poses, in_space=in_space)
        kinds = [apart[:, self.kind == one] for one in np.unique(self.kind)]
        off = [np.abs(mine - _medians(mine)[:, None]) for mine in kinds]
        return _medians(np.concatenate(off, axis=1))

    def some(self, rows: Bools) -> ChangeRows:
        """Return a part of the changes."""
        return ChangeRows.of(self.tcp_m[:, rows], self.people_m[:, rows], self.kind[rows])


def _medians(rows: Floats) -> Vector:
    """Return the median of each row, shape (P,), NaN where one value is; as numpy's, but sorts, which is faster."""
    ordered, half = np.sort(rows, axis=1), rows.shape[1] // 2
    middle = ordered[:, half] if rows.shape[1] % 2 else (ordered[:, half - 1] + ordered[:, half]) / 2
    return np.where(np.isnan(ordered[:, -1]), np.nan, middle)


def nearest_m(tcp_m: Floats, people_m: People, poses: Poses, *, in_space: bool = False) -> Floats:
    """Return the distance to the nearest person per pose, on the floor or in space, shape (P, N), m; inf: nobody."""
    cos, sin, x0, y0, z0 = (part[:, None] for part in (np.cos(poses[:, 0]), np.sin(poses[:, 0]), *poses[:, 1:].T))
    apart = np.full((len(poses), len(tcp_m)), np.inf)
    for x, y, z in people_m.transpose(1, 2, 0):
        if np.isfinite(x).any():
            off_x, off_y = cos * x - sin * y + x0 - tcp_m[:, 0], sin * x + cos * y + y0 - tcp_m[:, 1]
            square = off_x * off_x + off_y * off_y
            if in_space:
                square += (z + z0 - tcp_m[:, 2]) ** 2
            apart = np.fmin(apart, np.sqrt(square))
    return apart


def propose_frame(rows: LevelRows, changes: ChangeRows, *, near: bool = False) -> FrameProposal | None:
    """Return the frame in which the distances at changes of level agree, None if there is none that is certain.

    The search starts from the present frame and from frames in which the distance explains the levels. The best frame
    must make the distances agree much better than the present one, and both halves of the changes must lead to it.

    Args:
        rows: Samples.
        changes: Changes of level.
        near: Search near the present frame only, as for one that was measured.
    """
    if len(rows.level) < MIN_SAMPLES or len(np.unique(rows.level)) < 2 or len(changes.kind) < MIN_CHANGES:
        return None
    middle_m = np.nanmean(rows.people_m[..., :2], axis=(0, 1))  # heights may be unknown
    present = np.zeros((1, 4))
    known = np.all(np.isfinite(changes.people_m), axis=3)
    heights = bool(np.all(np.any(known, axis=2)))

    def sharpest(part: ChangeRows, start: Vector, rounds: int = ROUNDS, *, in_space: bool = False) -> Found:
        def score(poses: Poses) -> Vector:
            return -part.spread_m(poses, in_space=in_space)

        return _refined(score, start, middle_m, rounds, rises=in_space)

    few = changes.some(np.arange(len(changes.kind)) % -(-len(changes.kind) // COARSE_CHANGES) == 0)
    starts = present if near else np.concatenate([present, _starts(rows, middle_m)])
    start, rough = max((sharpest(few, one, COARSE_ROUNDS) for one in starts), key=lambda found: found[1])
    if -rough > MAX_ROUGH_SPREAD_M:
        return None
    ways = (False, True) if heights else (False,)
    found = [(*sharpest(changes, start, in_space=way), way) for way in ways]
    pose, score, in_space = max(found, key=lambda one: one[1])
    present_m = float(changes.spread_m(present, in_space=in_space)[0])
    seen = rows.people_m[np.isfinite(rows.people_m[..., 0])][:, :2]
    moved_m = float(np.median(np.linalg.norm(moved(seen, pose) - seen, axis=1)))
    if -score > min(MAX_SPREAD_M, MAX_RATIO * present_m) or moved_m < MIN_SHIFT_M:
        return None
    if rows.explained(pose[None])[0] < MIN_EXPLAINED:
        return None
    half = np.arange(len(changes.kind)) % 2 == 0
    here, there = (moved(seen, sharpest(changes.some(mine), pose, in_space=in_space)[0]) for mine in (half, ~half))
    if np.median(np.linalg.norm(here - there, axis=1)) > MAX_HALVES_APART_M:
        return None
    yaw_deg = (float(np.degrees(pose[0])) + 180.0) % 360.0 - 180.0
    x, y, z = pose[1:].tolist()
    return FrameProposal(yaw_deg, (x, y, z), -score, present_m, moved_m)


def moved(points_m: Floats, pose: Vector) -> Floats:
    """Return points (..., 2) rotated about the origin by a pose's yaw, then shifted to its x and y."""
    cos, sin = np.cos(pose[0]), np.sin(pose[0])
    return np.asarray(points_m @ np.array([[cos, sin], [-sin, cos]]) + pose[1:3])


def _starts(rows: LevelRows, middle_m: Vector) -> Poses:
    """Return the best poses of a grid in which somebody is near the robot while it is slowest."""
    few = slice(None, None, -(-len(rows.level) // COARSE))
    rows = LevelRows(rows.tcp_m[few], rows.people_m[few], rows.level[few])
    slow = rows.level == rows.level.min()
    shift = np.arange(-AROUND_M, AROUND_M + SHIFT_M / 2, SHIFT_M)
    x, y = (each.ravel() for each in np.meshgrid(shift, shift))
    grid = []
    for yaw in np.radians(np.arange(0.0, 360.0, TURN_DEG)):
        turned = moved(rows.people_m[slow][..., :2], np.array([yaw, 0.0, 0.0, 0.0]))
        centre = np.nanmedian(rows.tcp_m[slow][:, None, :2] - turned, axis=(0, 1))
        grid.append(np.column_stack([np.full(len(x), yaw), centre[0] + x, centre[1] + y, np.zeros(len(x))]))
    poses = np.concatenate(grid)
    poses = poses[np.argsort(-rows.explained(poses))]
    chosen: list[Vector] = []
    for pose in poses[: 20 * STARTS]:
        if len(chosen) < STARTS and all(_apart(pose, other, middle_m) > APART_M for other in chosen):
            chosen.append(pose)
    return np.array(chosen)


def _apart(pose: Vector, other: Vector, middle_m: Vector) -> float:
    """Return how far two poses are apart, m: by the people's mean position and by an arm of 1 m that they turn."""
    return float(np.linalg.norm(moved(middle_m, pose) - moved(middle_m, other)) + np.abs(pose[0] - other[0]))


def _refined(score: Callable[[Poses], Vector], pose: Vector, middle_m: Vector, rounds: int, *, rises: bool) -> Found:
    """Return the pose with the highest score near one, by a pattern search, and the score.

    Poses turn about `middle_m`, shape (2,). With `rises` the height is searched, too.
    """
    ways = [[-1.0, 0.0, 1.0]] * 3 + [[-1.0, 0.0, 1.0] if rises else [0.0]]
    around = np.stack(np.meshgrid(*ways, indexing="ij"), axis=-1).reshape(-1, 4)
    steps = np.array([np.radians(TURN_DEG), SHIFT_M, SHIFT_M, SHIFT_M])
    best = float(score(pose[None])[0])
    for _ in range(rounds):
        steps = steps / 2
        for _ in range(MOVES):
            yaw = pose[0] + around[:, 0] * steps[0]
            turned = np.array([moved(middle_m, np.array([one, 0.0, 0.0, 0.0])) for one in yaw])
            shifted = moved(middle_m, pose) - turned + around[:, 1:3] * steps[1:3]
            tried = np.column_stack([yaw, shifted, pose[3] + around[:, 3] * steps[3]])
            scores = score(tried)
            if scores.max() <= best:
                break
            pose, best = tried[int(scores.argmax())], float(scores.max())
    return pose, best
