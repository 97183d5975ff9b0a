"""Which parts of a motion ran at full speed although few repetitions agree: where it reaches limits of other motions.

Motions of one program share a few limits: the leading joint's speed and acceleration. Slowed by k, a motion has k times
the speed and k squared times the acceleration (Hollerbach 1984), so one that reaches a limit that several confirmed
motions have in common was at full speed there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.scaling.infer.path import Path
    from cyclekit.scaling.infer.reference import Reference
    from cyclekit.schema import Bools, Vector

SHARED, ALIKE = 3, 0.02
"""A limit is reached by at least SHARED motions, within this part of it."""
SUSTAINED = 0.9
"""A motion's speed or acceleration is the quantile that it holds for a while: jumps of the reference are short."""
REACHED = 0.97
"""From this part of a limit on it is reached."""
BETWEEN_S = 0.3
"""Between speed limit and acceleration limit, and at its ends, a jerk-limited motion reaches none for so long."""
CONFIRMED = 0.9
"""A motion shows limits if at least this part of it is confirmed by its repetitions."""
HALF_S = 0.05
"""Half of the stretch over which speed and acceleration are fitted."""
CLEAR = 10.0
"""A limit that is less than so many times its noise does not count."""
_LEAST_ROWS = 2  # to either side


class _Demand(NamedTuple):
    """Greatest speed and acceleration of all axes at nominal times (K,), and what noise they have, in rad or m."""

    nominal_s: Vector
    speed: Vector
    force: Vector
    force_noise: float


def confirmed_by_limits(
    references: Mapping[str, Reference], others: Sequence[Reference], noise: Mapping[int, Vector]
) -> dict[str, Reference]:
    """Return references, confirmed also where they reach the limits of motions that their repetitions confirm.

    One repetition that reaches none is no reference.

    Args:
        references: By task.
        others: More references, of other paths.
        noise: Standard deviation of each coordinate, by how many there are, rad or m.
    """
    every = [*references.values(), *others]
    if all(one.confirmed.all() for one in references.values()):
        return dict(references)
    demands = [_demand(one.path, noise[one.path.points.shape[1]]) for one in every]
    done = {}
    for (task, one), demand in zip(references.items(), demands, strict=False):
        width = one.path.points.shape[1]
        shown = [
            there
            for other, there in zip(every, demands, strict=True)
            if there is not None and other.path.points.shape[1] == width and other.confirmed.mean() >= CONFIRMED
        ]
        if demand is not None and not one.confirmed.all():
            full = _at_full_speed(demand, shown)
            rows = np.interp(one.path.nominal_s, demand.nominal_s, full) > 0.5
            one = replace(one, confirmed=one.confirmed | rows)
        if one.alone or one.repetitions > 1 or one.confirmed.any():
            done[task] = one
    return done


def _demand(path: Path, noise: Vector) -> _Demand | None:
    """Return speed and acceleration along a path at its nominal pace; None where it is too short."""
    period = float(path.own_s[1] - path.own_s[0])
    lasts_s = float(path.nominal_s[-1])
    count = round(lasts_s / period)
    half = max(_LEAST_ROWS, round(HALF_S / period))
    if count < 4 * half:
        return None
    nominal = np.linspace(0.0, lasts_s, count + 1)
    step = lasts_s / count
    points = np.column_stack([np.interp(nominal, path.nominal_s, column) for column in (path.points * noise).T])
    padded = np.pad(points, ((half, half), (0, 0)), mode="edge")
    fit = np.linalg.pinv(np.vander(np.arange(-half, half + 1) * step, 4, increasing=True))
    stretches = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    speed, force = stretches @ fit[1], 2.0 * stretches @ fit[2]
    along = np.linalg.norm if points.shape[1] == 3 else _greatest  # the TCP goes along a line, joints each by itself
    return _Demand(
        nominal, along(speed, axis=1), along(force, axis=1), float(2.0 * np.linalg.norm(fit[2]) * noise.max())
    )


def _greatest(values: Vector, axis: int) -> Vector:
    return np.asarray(np.abs(values).max(axis=axis))


def _at_full_speed(demand: _Demand, shown: Sequence[_Demand]) -> Bools:
    """Tell where a motion reaches the limits that others show, shape (K,), and shortly between."""
    speed = _limit([float(np.quantile(one.speed, SUSTAINED)) for one in shown])
    force = _limit([float(np.quantile(one.force, SUSTAINED)) for one in shown])
    if force < CLEAR * demand.force_noise:
        force = np.inf
    reached = np.flatnonzero(np.maximum(demand.speed / speed, np.sqrt(demand.force / force)) >= REACHED)
    full = np.zeros(len(demand.speed), np.bool_)
    if not len(reached):
        return full
    full[reached] = True
    times = np.concatenate([[0.0], demand.nominal_s[reached], demand.nominal_s[-1:]])
    bounds = np.concatenate([[0], reached, [len(full) - 1]])
    for k in np.flatnonzero(np.diff(times) <= BETWEEN_S).tolist():
        full[bounds[k] : bounds[k + 1] + 1] = True
    return full


def _limit(values: Sequence[float]) -> float:
    """Return the greatest value that SHARED of some values have in common; infinite where there is none."""
    found = np.array(values)
    for value in np.sort(found)[::-1].tolist():
        alike = found[np.abs(found - value) <= ALIKE * value]
        if len(alike) >= SHARED:
            return float(np.median(alike))
    return float("inf")


__all__ = ["confirmed_by_limits"]
