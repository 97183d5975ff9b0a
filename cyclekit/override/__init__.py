"""Infer the speed override of a log that did not record it.

The source paper: "the ratio between the measured velocity and the velocity obtained from a run without the human
presence". Here that ratio is the rate at which the nominal time of the motion's path advances: each repetition of a
motion is matched to the path by place (`path`), the path's nominal time comes from runs with nobody in the cell or from
the fastest pace of all repetitions at each place (`reference`), and the rate is fitted as what it is, piecewise
constant with ramps (`advance`). Where it cannot be known it is unknown, with the reason.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.motion import NEVER_FULL, NO_REFERENCE, OTHER_PATH, TOO_SLOW, Part
from cyclekit.override.advance import advance
from cyclekit.override.path import along
from cyclekit.override.reference import (
    Reference,
    Repetition,
    is_common_stop,
    reference_of,
    takes_another,
    with_dynamics,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.motion import Run
    from cyclekit.segment import Execution

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]

__all__ = ["Reference", "infer_overrides"]

UNSURE = 0.1
"""An inferred scaling of a larger standard deviation is not told."""
LEAST_SD = 3e-4
"""What the reference itself is known to."""
EDGE_SD = 0.05
"""In a ramp one scaling for several rows is wrong by up to what it changes from row to row; at an edge by this."""
SLOW = 0.2
"""A repetition whose logged scaling is lower tells nothing about the pace at full speed."""
PATHS = 4
"""Between two places so many different paths are looked for."""
LEAST_NOISE = 1e-6
"""Noise of a coordinate (rad or m) that shows none: logs are written with so many digits."""
_NOISE_LEGS, _NOISE_ROWS = 40, 4000


class _Leg(NamedTuple):
    """A motion between two visits: rows `first` to `last` of a run."""

    run: int
    first: int
    last: int


def infer_overrides(
    runs: Sequence[Run],
    executions: Sequence[Execution],
    alone: Sequence[int] = (),
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[list[list[Part]], dict[str, list[Reference]]]:
    """Return the scaling of each run that does not know it, where the robot was on its way.

    Args:
        runs: All runs; those that know their scaling serve as references too.
        executions: Their executions, from `segment`.
        alone: Numbers of runs recorded with nobody in the cell: where a motion occurs there, they are the reference.
        progress: Told the fraction done.

    Returns:
        Of each run its parts (none for a run that knows its scaling); and the references of each task, one per path.
    """
    legs = _legs(executions)
    noise = _noise(runs, [leg for found in legs.values() for leg in found])
    found: dict[str, list[Reference]] = {}
    members: dict[str, list[tuple[_Leg, int | None]]] = {}
    for number, (task, mine) in enumerate(legs.items()):
        progress(0.5 * number / len(legs))
        members[task], found[task] = _references(runs, mine, set(alone), noise)
    flat = [(task, i) for task, references in found.items() for i in range(len(references))]
    shares = with_dynamics([found[task][i] for task, i in flat])
    for (task, i), share in zip(flat, shares, strict=True):
        found[task][i] = replace(found[task][i], slowed=share)
    parts: list[list[Part]] = [[] for _ in runs]
    for number, (task, assigned) in enumerate(members.items()):
        progress(0.5 + 0.5 * number / len(members))
        for leg, which in assigned:
            if not runs[leg.run].knows_scaling:
                reference = None if which is None else found[task][which]
                parts[leg.run].append(_inferred(runs, leg, reference, noise, bool(found[task])))
    return parts, {task: references for task, references in found.items() if references}


def _legs(executions: Sequence[Execution]) -> dict[str, list[_Leg]]:
    legs: dict[str, list[_Leg]] = {}
    for execution in executions:
        for start, goal in pairwise(execution.visits):
            if goal.first - start.last >= 4:
                legs.setdefault(f"{start.place}->{goal.place}", []).append(_Leg(execution.run, start.last, goal.first))
    return legs


def _noise(runs: Sequence[Run], legs: Sequence[_Leg]) -> dict[int, Vector]:
    """Return the noise of each coordinate, by their number: third differences are free of any smooth motion."""
    thirds: dict[int, list[Points]] = {}
    for leg in legs[:: max(1, len(legs) // _NOISE_LEGS)]:
        points, _ = runs[leg.run].posture(leg.first, min(leg.last, leg.first + _NOISE_ROWS))
        fresh = points[np.concatenate([[True], (np.diff(points, axis=0) != 0).any(axis=1)])]
        if len(fresh) > 8:
            thirds.setdefault(points.shape[1], []).append(np.diff(fresh, 3, axis=0))
    spread = {
        count: 1.4826 * np.nanmedian(np.abs(np.concatenate(parts)), axis=0) / np.sqrt(20.0)
        for count, parts in thirds.items()
    }
    return {count: np.maximum(values, LEAST_NOISE) for count, values in spread.items()}


def _repetition(runs: Sequence[Run], leg: _Leg, noise: Mapping[int, Vector]) -> Repetition | None:
    """Return a motion, None where its coordinates are not known all along."""
    part = runs[leg.run].window(leg.first, leg.last)
    points, slider = runs[leg.run].posture(leg.first, leg.last)
    if points.shape[1] not in noise or not np.isfinite(points).all():
        return None
    known = part.scaling if runs[leg.run].knows_scaling else np.ones(len(slider))
    return Repetition(part.t_s, points / noise[points.shape[1]], slider * np.where(known >= SLOW, known, np.nan))


def _references(
    runs: Sequence[Run], legs: Sequence[_Leg], alone: set[int], noise: Mapping[int, Vector]
) -> tuple[list[tuple[_Leg, int | None]], list[Reference]]:
    """Sort the repetitions of a task by the path they take; return each with the number of its path, and the paths."""
    left, sorted_out, references = list(legs), list[tuple[_Leg, int | None]](), list[Reference]()
    while left and len(references) < PATHS:
        sure = [leg for leg in left if leg.run in alone or runs[leg.run].knows_scaling]
        among = sorted(sure or left, key=lambda leg: _lasts(runs, leg))
        repetitions = (_repetition(runs, leg, noise) for leg in among[: 2 * PATHS * 10])
        reference = reference_of([r for r in repetitions if r is not None], alone=bool(sure))
        if reference is None:
            break
        others = []
        for leg in left:
            repetition = _repetition(runs, leg, noise)
            same = repetition is not None and repetition.points.shape[1] == reference.path.points.shape[1]
            if repetition is None or not same or takes_another(reference.path, repetition):
                others.append(leg)
            else:
                sorted_out.append((leg, len(references)))
        if len(others) == len(left):
            break
        references.append(reference)
        left = others
    return [*sorted_out, *((leg, None) for leg in left)], references


def _lasts(runs: Sequence[Run], leg: _Leg) -> float:
    return runs[leg.run].time_at(leg.last) - runs[leg.run].time_at(leg.first)


def _inferred(
    runs: Sequence[Run], leg: _Leg, reference: Reference | None, noise: Mapping[int, Vector], other: bool
) -> Part:
    """Return the scaling of one repetition, unknown with its reason where it cannot be known."""
    count = leg.last + 1 - leg.first
    repetition = _repetition(runs, leg, noise) if reference is not None else None
    if reference is None or repetition is None:
        nothing = np.full(count, np.nan)
        return Part(leg.first, nothing, nothing, np.full(count, OTHER_PATH if other else NO_REFERENCE, np.int8))
    place = along(reference.path, repetition.t_s, repetition.points)
    nominal = np.interp(place.own_s, reference.path.own_s, reference.path.nominal_s)
    rate, deviation = advance(repetition.t_s, nominal, place.variance_s2)
    rate, deviation = rate / repetition.slider, deviation / repetition.slider
    deviation = np.hypot(np.hypot(deviation, LEAST_SD), np.minimum(np.abs(np.gradient(rate)), EDGE_SD))
    row = np.clip(np.searchsorted(reference.path.own_s, place.own_s), 0, len(reference.confirmed) - 1)
    gap = np.zeros(count, np.int8)
    gap[deviation > UNSURE] = TOO_SLOW
    gap[~reference.confirmed[row] | is_common_stop(reference, repetition.t_s, rate, place.own_s)] = NO_REFERENCE
    if reference.slowed < 1.0:
        gap[:] = NEVER_FULL
    return Part(
        leg.first, np.where(gap == 0, np.clip(rate, 0.0, 1.0), np.nan), np.where(gap == 0, deviation, np.nan), gap
    )
