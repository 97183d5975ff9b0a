"""Logged operator tracks, long enough for any cycle that is rolled out against them.

A track begins where its execution began. Where a cycle takes longer than the logged one, the track goes on: with what
the operator really did next, if the log runs on; else with the track of another execution that was still running at
that time since its start, from where its operator was nearest and doing the same. Cycles that take long would
otherwise be scored against an operator who stands still.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import EstimateError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset import Dataset

RUN_ON_S = 5.0
"""The next execution of a session goes on with the same operator if it begins within this time."""
OTHER_TASK_M = 2.0
"""An operator who does something else counts as being this much farther away."""


@dataclass(frozen=True)
class OperatorTracks:
    """K tracks on one grid of time since the execution began.

    Attributes:
        xyz_m: x_h, shape (K, T, 3), base frame; NaN = nobody seen.
        activity: Index into `activities` of what the operator does, shape (K, T); -1 = unknown.
        activities: Names of the operator's tasks.
        logged: Length of each track that its own execution logged, shape (K,), samples.
        executions: Name of the execution behind each track.
        step_s: Time between samples.
    """

    xyz_m: NDArray[np.float64]
    activity: NDArray[np.int64]
    activities: tuple[str, ...]
    logged: NDArray[np.int64]
    executions: tuple[str, ...]
    step_s: float


def operator_tracks(dataset: Dataset, *, horizon_s: float, operator: Sequence[str] | None = None) -> OperatorTracks:
    """Return the tracks of all complete executions with an operator, each at least `horizon_s` long.

    Args:
        dataset: Where they were logged.
        horizon_s: Longest cycle that will be asked for.
        operator: Only executions in which the operator's tasks begin in this order.

    Raises:
        EstimateError: No execution has an operator track, or none matches `operator`.
    """
    step = 1.0 / float(dataset.card["rate_hz"])
    samples = dataset.samples()
    names = sorted(name for name in samples["human_task"].unique().to_list() if name is not None)
    code = {name: index for index, name in enumerate(names)}
    complete = set(dataset.executions.filter("complete")["execution"].to_list())
    tracks: dict[str, tuple[NDArray[np.float64], NDArray[np.int64], float, float]] = {}
    for (execution,), rows in samples.group_by(["execution"], maintain_order=True):
        xyz = rows.select("human_x_m", "human_y_m", "human_z_m").to_numpy()
        activity = np.array([code.get(name, -1) for name in rows["human_task"].to_list()])
        t = rows["t_s"].to_numpy()
        tracks[str(execution)] = (xyz, activity, float(t[0]), float(t[-1]))
    begins = [name for name in tracks if name in complete and np.isfinite(tracks[name][0]).any()]
    if not begins:
        seen = f"{dataset.path}: no complete execution has an operator track"
        raise EstimateError(seen, cure="Ingest the tracker's log together with the robot's.")
    if operator is not None:
        begins = _matching(dataset, tracks, begins, names, tuple(operator))
    ran_on = {name: _run_on(dataset, tracks, name, step) for name in begins}
    length = int(np.ceil(horizon_s / step)) + 2
    xyz, activity = _extended([ran_on[name] for name in begins], length)
    logged = np.array([len(tracks[name][0]) for name in begins])
    return OperatorTracks(xyz, activity, tuple(names), logged, tuple(begins), step)


def _matching(
    dataset: Dataset,
    tracks: dict[str, tuple[NDArray[np.float64], NDArray[np.int64], float, float]],
    begins: list[str],
    names: list[str],
    wanted: tuple[str, ...],
) -> list[str]:
    orders = {name: _order(tracks[name][1], names) for name in begins}
    found = [name for name in begins if orders[name][: len(wanted)] == wanted]
    if not found:
        common = max(orders.values(), key=list(orders.values()).count)
        seen = f"{dataset.path}: in no execution does the operator begin with {', '.join(wanted)}"
        raise EstimateError(seen, nearest=", ".join(common[: len(wanted)]), cure=f"Known: {', '.join(names)}.")
    return found


def _order(activity: NDArray[np.int64], names: list[str]) -> tuple[str, ...]:
    changes = np.flatnonzero(np.diff(activity, prepend=-2))
    return tuple(names[i] for i in activity[changes].tolist() if i >= 0)


def _run_on(
    dataset: Dataset,
    tracks: dict[str, tuple[NDArray[np.float64], NDArray[np.int64], float, float]],
    name: str,
    step: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The track of an execution and of those that follow it in the same session without a longer pause."""
    order = dataset.executions.filter(pl.col("session") == pl.lit(_session(dataset, name)))["execution"].to_list()
    xyz, activity, _, end = tracks[name]
    parts, doing = [xyz], [activity]
    for following in order[order.index(name) + 1 : order.index(name) + 3]:
        if following not in tracks or tracks[following][2] - end > RUN_ON_S:
            break
        next_xyz, next_activity, begin, next_end = tracks[following]
        pause = max(0, round((begin - end) / step) - 1)
        weight = (np.arange(1, pause + 1) / (pause + 1))[:, None]
        parts += [parts[-1][-1] * (1 - weight) + next_xyz[0] * weight, next_xyz]
        doing += [np.full(pause, doing[-1][-1]), next_activity]
        end = next_end
    return np.concatenate(parts), np.concatenate(doing)


def _session(dataset: Dataset, execution: str) -> str:
    row = dataset.executions.filter(pl.col("execution") == execution)
    return str(row["session"][0])


def _extended(
    tracks: list[tuple[NDArray[np.float64], NDArray[np.int64]]], length: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Lay the tracks on one grid of `length` samples, short ones continued by donors (see the module's text)."""
    count = len(tracks)
    xyz = np.full((count, length, 3), np.nan)
    activity = np.full((count, length), -1, dtype=np.int64)
    own = np.array([min(len(track), length) for track, _ in tracks])
    for k, (track, doing) in enumerate(tracks):
        xyz[k, : own[k]], activity[k, : own[k]] = track[:length], doing[:length]
    order = np.argsort(-own, kind="stable")
    for k in order.tolist():
        end = int(own[k])
        if end >= length:
            continue
        donor = _donor(xyz, activity, own, k, end - 1)
        if donor is None:
            xyz[k, end:], activity[k, end:] = xyz[k, end - 1], activity[k, end - 1]
        else:  # longer tracks were continued before, so the donor is complete
            xyz[k, end:], activity[k, end:] = xyz[donor, end:], activity[donor, end:]
    return xyz, activity


def _donor(
    xyz: NDArray[np.float64], activity: NDArray[np.int64], own: NDArray[np.int64], k: int, at: int
) -> int | None:
    running = np.flatnonzero(own > at + 1)
    if not len(running):
        return None
    here, there = xyz[k, at], xyz[running, at]
    absent = ~np.isfinite(there[:, 0])
    distance = np.where(absent, np.inf, np.linalg.norm(np.nan_to_num(there - here), axis=1))
    if not np.isfinite(here[0]):
        distance = np.where(absent, 0.0, np.inf)
    distance = distance + OTHER_TASK_M * (activity[running, at] != activity[k, at])
    best = int(distance.argmin())
    return int(running[best]) if np.isfinite(distance[best]) else None
