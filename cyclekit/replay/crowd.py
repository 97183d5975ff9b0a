"""Who else is in the cell, and the operator's limbs where they were kept: from the trackers' own recordings.

x_h of the samples is one point of one person. Here the recordings are read again at the times of the samples: everybody
who is not at x_h is another person, and the joints of kept skeletons come with the bones between them. How they are
drawn is the business of `bodies`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit.alignment.frames import to_base
from cyclekit.config import Frame

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset

NEAR_S = 0.15
"""A frame of a tracker further than this from a sample says nothing about it."""

SAME_M = 0.4
"""Whoever is nearer to x_h than this is the operator, by whichever tracker."""

RIDES_M = 0.4
"""A body that hardly ever leaves the tool by more than this rides on the robot."""

_MOST_FRAMES = 400


@dataclass(frozen=True)
class Skeletons:
    """Limbs at the T samples: per sample the bones of all people seen, each shape (2, 3), metres, base frame.

    Attributes:
        bones: One array (B, 2, 3) per sample; no rows where no skeleton is known.
        of_operator: True where the operator is one of them, shape (T,).
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
    """Return everybody but the operator at each sample.

    Args:
        dataset: Where the recordings are.
        session: Session of the execution.
        times_s: Times of the samples, session seconds, shape (T,).
        human_m: x_h, shape (T, 3); where it is unknown nobody is returned.
        robot_m: x_r, shape (T, 3).

    Returns:
        Per sample an array (N, 3), metres, base frame.
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
    """Return the limbs at each sample, None where no skeletons were kept; arguments as for `other_people`."""
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
    """Yield per recording the rows nearest to the samples: sample, person, joint (of skeletons), x, y, z in base."""
    if not len(times_s):
        return
    for record in dataset.recordings:
        if record["session"] != session or table not in record["tables"]:
            continue
        clock = record["clock"]
        own_s = (times_s - clock["offset_s"]) / clock["rate"]
        rows = dataset.recorded_between(record["id"], table, float(own_s.min()) - NEAR_S, float(own_s.max()) + NEAR_S)
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


def _in_base(points_m: NDArray[np.float64], record: dict[str, Any]) -> NDArray[np.float64]:
    placed = record["frame"]
    frame = None
    if placed.get("rotation"):
        x, y, z = placed["xyz_m"]
        one, two, three = (tuple(row) for row in placed["rotation"])
        frame = Frame(xyz_m=(x, y, z), rotation=(one, two, three))
    return to_base(points_m.astype(np.float64), frame, up=record.get("up", "z"))


def _rides(from_tool_m: NDArray[np.float64]) -> bool:
    known = from_tool_m[np.isfinite(from_tool_m)]
    return len(known) > 10 and float(np.quantile(known, 0.95)) < RIDES_M


def _by_joint(body: pl.DataFrame) -> tuple[list[int], NDArray[np.float64]]:
    """Samples (N) and joint positions (N, J, 3) of one person, NaN where unknown."""
    joints = {name: index for index, name in enumerate(body["joint"].unique(maintain_order=True).to_list())}
    samples = {sample: index for index, sample in enumerate(body["sample"].unique(maintain_order=True).to_list())}
    points = np.full((len(samples), len(joints), 3), np.nan)
    row = body["sample"].replace_strict(samples).to_numpy()
    column = body["joint"].replace_strict(joints).to_numpy()
    points[row, column] = body.select("x", "y", "z").to_numpy()
    return list(samples), points


def _bones(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Pairs of joints that a bone joins, shape (B, 2): the tree of the shortest and stiffest connections.

    Trackers name their joints each in their own way, but a bone has the same length all the time, and neighbours are
    near each other. So the tree is read from the motion.
    """
    thin = points[:: max(1, len(points) // _MOST_FRAMES)]
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
