"""Infer the speed override of a log that did not record it.

The source paper defines it as "the ratio between the measured velocity and the velocity obtained from a run without
the human presence". That ratio is computed as the rate at which the nominal time of the path advances. Each repetition
of a motion is matched to the path by place (`path`). The nominal time comes from runs with nobody in the cell, or from
the fastest pace of all repetitions at each place (`reference`). The rate is fitted as piecewise constant with ramps
(`rate_along_path`). Where it cannot be determined, it is unknown, with the reason.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.scaling.infer.full_speed import confirmed_by_limits
from cyclekit.scaling.infer.path import match_to_path
from cyclekit.scaling.infer.rate_along_path import rate_along_path
from cyclekit.scaling.infer.reference import (
    AMONG,
    Reference,
    Repetition,
    is_common_stop,
    is_elsewhere,
    reference_of,
    takes_another,
    with_dynamics,
)
from cyclekit.segmentation.motion import NEVER_FULL, NO_REFERENCE, OTHER_PATH, STANDING, TOO_SLOW, InferredScaling

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cyclekit.schema import Bools, Points, Vector
    from cyclekit.segmentation.executions import Execution
    from cyclekit.segmentation.stored_run import Run


__all__ = ["Reference", "infer_overrides"]

UNSURE = 0.1
"""Maximum standard deviation of an inferred scaling; above, it is unknown."""
MIN_SD = 3e-4
"""Standard deviation of the reference."""
EDGE_SD = 0.05
"""Maximum standard deviation added for the change from row to row (ramps, edges)."""
SLOW = 0.2
"""Minimum logged scaling for a row to be used for the speed at full override."""
PATHS = 4
"""Maximum number of different paths between two places."""
MIN_NOISE = 1e-6
"""Minimum noise of a coordinate, rad or m: the resolution of written logs."""
HALTED, CRAWL_M_S = 0.02, 6e-3
"""Maximum scaling of a stopped robot; maximum TCP speed of one, m/s, or 2 * HALTED of its usual speed if larger."""
BRAKING_S, BRAKES, SMOOTH = 1.0, 0.98, 5
"""Maximum time, s, in which a robot brakes for a wait on its way, and starts after it; the scaling then lies below the
second value; number of rows over which its speed is smoothed."""
_NOISE_MOTIONS, _NOISE_ROWS = 40, 4000
_AT_ONCE = 64
_NONE, _NO_GAPS = np.empty(0), np.empty(0, np.int8)


class _Motion(NamedTuple):
    """A motion between two visits: rows `first` to `last` of a run, its duration, and the rows of a wait on the way."""

    task: str
    run: int
    first: int
    last: int
    lasts_s: float
    wait: tuple[int, int] | None = None


def infer_overrides(
    runs: Sequence[Run],
    executions: Sequence[Execution],
    alone: Sequence[int] = (),
    progress: Callable[[float], None] = lambda _: None,
    engine: Engine = LOCAL,
) -> tuple[list[list[InferredScaling]], dict[str, list[Reference]]]:
    """Return the scaling during motions of each run that did not log it.

    Args:
        runs: All runs; those with a logged scaling serve as references too.
        executions: Their executions, from `find_executions`.
        alone: Indices of runs recorded with nobody in the cell; they are the reference for motions that occur there.
        progress: Called with the fraction done.
        engine: Matches the motions to their references.

    Returns:
        The inferred parts of each run (none for a run with a logged scaling), and the references of each task, one
        per path.
    """
    left = _motions(runs, executions)
    noise = _noise(runs, left)
    found: dict[str, list[Reference]] = {motion.task: [] for motion in left}
    parts: list[tuple[_Motion, InferredScaling, int]] = []
    asked, motions = set(found), len(left)
    for attempt in range(PATHS):
        tried = _references(runs, [motion for motion in left if motion.task in asked], set(alone), noise)
        tried = confirmed_by_limits(tried, [reference for mine in found.values() for reference in mine], noise)
        todo = _chunks(runs, [motion for motion in left if motion.task in tried])
        results: dict[_Motion, InferredScaling | None] = {}
        for done in engine.map(partial(_matched, references=tried, noise=noise), todo):
            results |= zip(done.item.motions, done.get(), strict=True)
            progress(1.0 - (len(left) - len(results)) / motions)
        parts += [(motion, part, attempt) for motion in left if (part := results.get(motion)) is not None]
        others = [motion for motion in left if results.get(motion) is None]
        asked = {motion.task for motion, _, which in parts if which == attempt}
        for task in asked:
            found[task].append(tried[task])
        left = others
        if not asked or not left:
            break
    references = _with_shares({task: mine for task, mine in found.items() if mine})
    return _told(runs, parts, left, references), references


def _motions(runs: Sequence[Run], executions: Sequence[Execution]) -> list[_Motion]:
    """Return every motion, in order of time."""
    motions = []
    for execution in sorted(executions, key=lambda e: (e.run, e.visits[0].first if e.visits else 0)):
        run = runs[execution.run]
        for start, goal in pairwise(execution.visits):
            if goal.first - start.last >= 4:
                lasts_s = run.time_at(goal.first) - run.time_at(start.last)
                motions.append(
                    _Motion(
                        f"{start.place}->{goal.place}", execution.run, start.last, goal.first, lasts_s, goal.reached
                    )
                )
    return motions


class _Chunk(NamedTuple):
    """Motions of one run that are processed together."""

    run: Run
    motions: list[_Motion]


def _chunks(runs: Sequence[Run], motions: Sequence[_Motion]) -> list[_Chunk]:
    """Return motions in chunks, in order of time, so that each part of a log is read once."""
    found: list[_Chunk] = []
    for _, mine in groupby(motions, key=lambda motion: motion.run):
        every = list(mine)
        found += [_Chunk(runs[every[0].run], every[i : i + _AT_ONCE]) for i in range(0, len(every), _AT_ONCE)]
    return found


def _matched(
    chunk: _Chunk, *, references: Mapping[str, Reference], noise: Mapping[int, Vector]
) -> list[InferredScaling | None]:
    return [_inferred(chunk.run, motion, references[motion.task], noise) for motion in chunk.motions]


def _noise(runs: Sequence[Run], motions: Sequence[_Motion]) -> dict[int, Vector]:
    """Return the noise of each coordinate, by number of coordinates, from third differences (smooth motion cancels)."""
    thirds: dict[int, list[Points]] = {}
    for motion in motions[:: max(1, len(motions) // _NOISE_MOTIONS)]:
        points, _ = runs[motion.run].posture(motion.first, min(motion.last, motion.first + _NOISE_ROWS))
        fresh = points[np.concatenate([[True], (np.diff(points, axis=0) != 0).any(axis=1)])]
        if len(fresh) > 8:
            thirds.setdefault(points.shape[1], []).append(np.diff(fresh, 3, axis=0))
    spread = {
        count: 1.4826 * np.nanmedian(np.abs(np.concatenate(parts)), axis=0) / np.sqrt(20.0)
        for count, parts in thirds.items()
    }
    return {count: np.maximum(values, MIN_NOISE) for count, values in spread.items()}


def _repetition(run: Run, motion: _Motion, noise: Mapping[int, Vector]) -> Repetition | None:
    """Return a motion; None if any of its coordinates is unknown."""
    part = run.window(motion.first, motion.last)
    points, slider = run.posture(motion.first, motion.last)
    if points.shape[1] not in noise or not np.isfinite(points).all():
        return None
    known = part.scaling if run.knows_scaling else np.ones(len(slider))
    over_noise = points / noise[points.shape[1]]
    return Repetition(part.t_s, over_noise, part.xyz_m, slider * np.where(known >= SLOW, known, np.nan))


def _references(
    runs: Sequence[Run], motions: Sequence[_Motion], alone: set[int], noise: Mapping[int, Vector]
) -> dict[str, Reference]:
    """Return the reference of each task for the path of its fastest repetitions, if there is one."""
    by_task: dict[str, list[_Motion]] = {}
    for motion in motions:
        by_task.setdefault(motion.task, []).append(motion)
    found = {}
    for task, mine in by_task.items():
        sure = [motion for motion in mine if motion.run in alone or runs[motion.run].knows_scaling]
        fastest = sorted(sure or mine, key=lambda motion: motion.lasts_s)[: 2 * AMONG]
        in_order = sorted(fastest, key=lambda motion: (motion.run, motion.first))
        repetitions = [_repetition(runs[motion.run], motion, noise) for motion in in_order]
        reference = reference_of([r for r in repetitions if r is not None], alone=bool(sure))
        if reference is not None:
            found[task] = reference
    return found


def _with_shares(found: Mapping[str, Sequence[Reference]]) -> dict[str, list[Reference]]:
    """Return the references with the share of full speed that each motion never exceeded."""
    shares = iter(with_dynamics([reference for mine in found.values() for reference in mine]))
    return {task: [replace(reference, slowed=next(shares)) for reference in mine] for task, mine in found.items()}


def _told(
    runs: Sequence[Run],
    parts: Sequence[tuple[_Motion, InferredScaling, int]],
    left: Sequence[_Motion],
    found: Mapping[str, Sequence[Reference]],
) -> list[list[InferredScaling]]:
    """Return the parts of each run without a logged scaling; for motions without a reference, only the reason."""
    told: list[list[InferredScaling]] = [[] for _ in runs]
    for motion, part, number in parts:
        never_full = found[motion.task][number].slowed < 1.0
        told[motion.run].append(_unknown(motion, NEVER_FULL) if never_full else part)
    for motion in left:
        told[motion.run].append(_unknown(motion, OTHER_PATH if motion.task in found else NO_REFERENCE))
    return [[] if run.knows_scaling else mine for run, mine in zip(runs, told, strict=True)]


def _unknown(motion: _Motion, why: int) -> InferredScaling:
    nothing = np.full(motion.last + 1 - motion.first, np.nan, np.float32)
    return InferredScaling(motion.first, nothing, nothing, np.full(len(nothing), why, np.int8))


def _inferred(run: Run, motion: _Motion, reference: Reference, noise: Mapping[int, Vector]) -> InferredScaling | None:
    """Return the scaling of one repetition, with the reason where it is unknown.

    None if it takes another path, or if its coordinates are unknown. Empty for a run with a logged scaling.
    """
    repetition = _repetition(run, motion, noise)
    if repetition is None or repetition.points.shape[1] != reference.path.points.shape[1]:
        return None
    if run.knows_scaling:
        elsewhere = takes_another(reference.path, repetition)
        return None if elsewhere else InferredScaling(motion.first, _NONE, _NONE, _NO_GAPS)
    match = match_to_path(reference.path, repetition.t_s, repetition.points)
    if is_elsewhere(reference.path, match.off):
        return None
    nominal = np.interp(match.own_s, reference.path.own_s, reference.path.nominal_s)
    rate, deviation = rate_along_path(repetition.t_s, nominal, match.variance_s2)
    rate, deviation = rate / repetition.slider, deviation / repetition.slider
    deviation = np.hypot(np.hypot(deviation, MIN_SD), np.minimum(np.abs(np.gradient(rate)), EDGE_SD))
    row = np.clip(np.searchsorted(reference.path.own_s, match.own_s), 0, len(reference.confirmed) - 1)
    gap = np.zeros(len(rate), np.int8)
    gap[deviation > UNSURE] = TOO_SLOW
    gap[~reference.confirmed[row] | is_common_stop(reference, repetition.t_s, rate, match.own_s)] = NO_REFERENCE
    gap[(rate < HALTED) & _goes(run.window(motion.first, motion.last).speed_m_s)] = NO_REFERENCE
    for halt in run.halts:
        gap[max(halt.first - motion.first, 0) : max(halt.last + 1 - motion.first, 0)] = halt.gap
    known = np.where(gap == 0, np.array([np.clip(rate, 0.0, 1.0), deviation]), np.nan).astype(np.float32)
    if motion.wait is not None and motion.wait[0] < motion.wait[1]:  # unknown, as at a place
        begin, end = motion.wait[0] - motion.first, motion.wait[1] - motion.first
        rows = _around(begin, end, repetition.t_s, run.window(motion.first, motion.last).speed_m_s, rate)
        known[:, rows], gap[rows] = np.nan, STANDING
    return InferredScaling(motion.first, known[0], known[1], gap)


def _around(first: int, last: int, t_s: Vector, speed_m_s: Vector, rate: Vector) -> slice:
    """Return the rows of a wait on the way, with those in which the robot brakes before it and starts after it.

    Args:
        first: First row of the standstill.
        last: Its last row.
        t_s: Times of the motion, shape (T,).
        speed_m_s: Its TCP speeds, shape (T,).
        rate: How fast nominal time advances, shape (T,): full where no repetition passes without a stop.
    """
    speed, slow = np.convolve(speed_m_s, np.ones(SMOOTH) / SMOOTH, "same"), rate < BRAKES
    begin, end = first, last
    while begin > 0 and slow[begin - 1] and speed[begin - 1] >= speed[begin] and t_s[first] - t_s[begin] < BRAKING_S:
        begin -= 1
    while end + 1 < len(speed) and slow[end + 1] and speed[end + 1] >= speed[end] and t_s[end] - t_s[last] < BRAKING_S:
        end += 1
    return slice(begin, end + 1)


def _goes(speed_m_s: Vector) -> Bools:
    """Return the rows of a motion, with speeds (T,), in which the robot is too fast to be stopped, shape (T,)."""
    usual = float(np.nanquantile(speed_m_s, 0.9)) if np.isfinite(speed_m_s).any() else 0.0
    return np.asarray(speed_m_s > max(CRAWL_M_S, 2.0 * HALTED * usual))
