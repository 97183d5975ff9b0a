"""Finds other people and skeletons at the times of samples, from the recordings of the trackers.

x_h of a sample is one point of one person. Every tracked person who is not at x_h is another person. Skeletons are
returned as bones between their joints. `people` draws both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.alignment.frames import to_base
from cyclekit.config import Frame

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.dataset import Dataset

NEAR_S = 0.15
"""Maximum time between a sample and the tracker's frame used for it, s."""

SAME_M = 0.4
"""A person nearer to x_h than this, m, is the operator, whatever the tracker."""

RIDES_M = 0.4
"""A body that is almost always nearer to the TCP than this, m, is mounted on the robot."""

_MAX_FRAMES = 400


@dataclass(frozen=True)
class Skeletons:
    """Skeletons of all visible people at T samples.

    Attributes:
        bones: Per sample an array (B, 2, 3) of line segments, m, base frame; B = 0 without a skeleton.
        of_operator: Whether the operator is one of them, shape (T,).
    """

    bones: tuple[NDArray[np.float64], ...]
    of_operator: NDArray[np.bool_]


def other_people(
    dataset: Dataset,
    session: str,
    times_s: NDArray[np.float64],
    human_m: NDArray[np.float64],
    robot_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], ...]:
    """Return the other people at each sample.

    Args:
        dataset: Dataset with the recordings.
        session: Session of the execution.
        times_s: Times of the samples, session seconds, shape (T,).
        human_m: x_h, shape (T, 3), m; no people are returned where it is unknown.
        robot_m: x_r, shape (T, 3), m.

    Returns:
        Per sample an array (N, 3), m, base frame.
    """
    found: list[list[NDArray[np.float64]]] = [[] for _ in times_s]
    for rows in _recorded(dataset, session, "people", times_s):
        rows = rows.filter(pl.col("x").is_finite())
        if rows.is_empty():
            continue
        points, who = rows.select("x", "y", "z").to_numpy(), rows["person"].to_numpy()
        points[np.isnan(points[:, 2]), 2] = 0.0
        at = rows["sample"].to_numpy()
        apart = np.linalg.norm(points[:, :2] - human_m[at, :2], axis=1)
        from_tool = np.linalg.norm(points - robot_m[at], axis=1)
        riders = [name for name in set(who.tolist()) if _rides(from_tool[who == name])]
        other = (apart > SAME_M) & ~np.isin(who, riders)
        for sample, point in zip(at[other].tolist(), points[other], strict=True):
            found[sample].append(point)
    return tuple(np.array(points).reshape(-1, 3) for points in found)


def skeletons(
    dataset: Dataset, session: str, times_s: NDArray[np.float64], human_m: NDArray[np.float64]
) -> Skeletons | None:
    """Return the skeletons at each sample; None if the dataset has none. Arguments as of `other_people`."""
    bones: list[list[NDArray[np.float64]]] = [[] for _ in times_s]
    mine = np.zeros(len(times_s), dtype=np.bool_)
    for rows in _recorded(dataset, session, "skeletons", times_s):
        for _, body in rows.group_by("person", maintain_order=True):
            samples, points = _by_joint(body)
            pairs = _bones(points)
            at = np.array(samples)
            for sample, limbs in zip(samples, points[:, pairs], strict=True):
                bones[sample].append(limbs[np.isfinite(limbs).all(axis=(1, 2))])
            known = np.isfinite(points[..., :1]) & np.isfinite(points[..., 1:2])
            centre = np.where(known, points, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
            mine[at] |= np.linalg.norm(centre[:, :2] - human_m[at, :2], axis=1) < SAME_M
    if not any(len(limbs) for each in bones for limbs in each):
        return None
    return Skeletons(tuple(np.concatenate([np.empty((0, 2, 3)), *each]) for each in bones), mine)


def _recorded(dataset: Dataset, session: str, table: str, times_s: NDArray[np.float64]) -> Iterator[pl.DataFrame]:
    """Yield per recording the rows nearest to the samples: sample, person, joint (of skeletons), base frame x, y, z."""
    if not len(times_s):
        return
    for record in dataset.recordings:
        if record.session != session or table not in record.tables:
            continue
        own_s = (times_s - record.clock.offset_s) / record.clock.rate
        rows = dataset.recorded_between(record.id, table, float(own_s.min()) - NEAR_S, float(own_s.max()) + NEAR_S)
        if rows is None or rows.is_empty():
            continue
        frames = np.unique(rows["t_s"].to_numpy())
        right = np.clip(np.searchsorted(frames, own_s), 1, max(1, len(frames) - 1))
        left = right - 1
        right = np.minimum(right, len(frames) - 1)
        nearest = np.where(own_s - frames[left] <= frames[right] - own_s, left, right)
        near = np.abs(frames[nearest] - own_s) <= NEAR_S
        picked = pl.DataFrame({"t_s": frames[nearest[near]], "sample": np.flatnonzero(near)})
        rows = picked.join(rows, on="t_s", how="inner", maintain_order="left")
        base = _in_base(rows.select("x_m", "y_m", "z_m").to_numpy(), record)
        names = [name for name in ("sample", "person", "joint") if name in rows.columns]
        yield rows.select(names).with_columns(*(pl.Series(axis, base[:, k]) for k, axis in enumerate("xyz")))


def _in_base(points_m: NDArray[np.float64], record: RecordingCard) -> NDArray[np.float64]:
    placed, frame = record.frame, None
    if placed.xyz_m is not None and placed.rotation is not None:
        frame = Frame(xyz_m=placed.xyz_m, rotation=placed.rotation)
    return to_base(points_m.astype(np.float64), frame, up=record.up)


def _rides(from_tool_m: NDArray[np.float64]) -> bool:
    known = from_tool_m[np.isfinite(from_tool_m)]
    return len(known) > 10 and float(np.quantile(known, 0.95)) < RIDES_M


def _by_joint(body: pl.DataFrame) -> tuple[list[int], NDArray[np.float64]]:
    """Return samples (N) and joint positions (N, J, 3) of one person; NaN = unknown."""
    joints = {name: index for index, name in enumerate(body["joint"].unique(maintain_order=True).to_list())}
    samples = {sample: index for index, sample in enumerate(body["sample"].unique(maintain_order=True).to_list())}
    points = np.full((len(samples), len(joints), 3), np.nan)
    row = body["sample"].replace_strict(samples).to_numpy()
    column = body["joint"].replace_strict(joints).to_numpy()
    points[row, column] = body.select("x", "y", "z").to_numpy()
    return list(samples), points


def _bones(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the pairs of joints connected by a bone, shape (B, 2): the tree of the shortest, most constant distances.

    Trackers name joints differently, but a bone has constant length and connects joints that are near each other, so
    the tree is found from the motion.
    """
    thin = points[:: max(1, len(points) // _MAX_FRAMES)]
    apart = np.linalg.norm(thin[:, :, None] - thin[:, None, :], axis=-1)
    known = np.isfinite(apart)
    count = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, apart, 0.0).sum(axis=0) / count
    spread = np.sqrt(np.where(known, (apart - mean) ** 2, 0.0).sum(axis=0) / count)
    cost = np.where(known.any(axis=0), mean + 4.0 * spread, np.inf)
    inside, pairs = [0], []
    outside = set(range(1, cost.shape[0]))
    while outside:
        rest = sorted(outside)
        block = cost[np.ix_(inside, rest)]
        a, b = np.unravel_index(int(np.argmin(block)), block.shape)
        if not np.isfinite(block[a, b]):
            break
        pairs.append((inside[int(a)], rest[int(b)]))
        inside.append(rest[int(b)])
        outside.discard(rest[int(b)])
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)
