"""Finds the parts of a motion at full speed by limits of other motions, if few repetitions agree.

Motions of one program share a few limits: speed and acceleration of the leading joint. Slowed by k, a motion has k
times the speed and k squared times the acceleration (Hollerbach 1984). So a motion that reaches a limit shared by
several confirmed motions was at full speed there.
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
"""Minimum number of motions that share a limit; tolerance, as a share of the limit."""
SUSTAINED = 0.9
"""Quantile that serves as the maximum speed or acceleration of a motion; jumps of the reference are shorter."""
REACHED = 0.97
"""Minimum share of a limit at which it counts as reached."""
BETWEEN_S = 0.3
"""Maximum time, s, for which a jerk-limited motion at full speed reaches no limit: between limits, and at its ends."""
CONFIRMED = 0.9
"""Minimum share of a motion that its repetitions confirm, for it to define limits."""
HALF_S = 0.05
"""Half width of the window in which speed and acceleration are fitted, s."""
CLEAR = 10.0
"""Minimum ratio of an acceleration limit to its noise."""
_MIN_ROWS = 2  # on either side


class _Demand(NamedTuple):
    """Maximum speed and acceleration over all axes at nominal times (K,), noise of the acceleration; rad or m, s."""

    nominal_s: Vector
    speed: Vector
    acceleration: Vector
    acceleration_noise: float


def confirmed_by_limits(
    references: Mapping[str, Reference], others: Sequence[Reference], noise: Mapping[int, Vector]
) -> dict[str, Reference]:
    """Return references that are also confirmed where they reach the limits of confirmed motions.

    A single repetition that reaches no limit is left out.

    Args:
        references: References by task.
        others: References of other paths.
        noise: Standard deviation of each coordinate by the number of coordinates, rad or m.
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
    """Return speed and acceleration along a path at its nominal pace; None if it is too short."""
    period = float(path.own_s[1] - path.own_s[0])
    lasts_s = float(path.nominal_s[-1])
    count = round(lasts_s / period)
    half = max(_MIN_ROWS, round(HALF_S / period))
    if count < 4 * half:
        return None
    nominal = np.linspace(0.0, lasts_s, count + 1)
    step = lasts_s / count
    points = np.column_stack([np.interp(nominal, path.nominal_s, column) for column in (path.points * noise).T])
    padded = np.pad(points, ((half, half), (0, 0)), mode="edge")
    fit = np.linalg.pinv(np.vander(np.arange(-half, half + 1) * step, 4, increasing=True))
    stretches = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    speed, acceleration = stretches @ fit[1], 2.0 * stretches @ fit[2]
    along = np.linalg.norm if points.shape[1] == 3 else _greatest  # TCP: along its path; joints: each on its own
    return _Demand(
        nominal, along(speed, axis=1), along(acceleration, axis=1), float(2.0 * np.linalg.norm(fit[2]) * noise.max())
    )


def _greatest(values: Vector, axis: int) -> Vector:
    return np.asarray(np.abs(values).max(axis=axis))


def _at_full_speed(demand: _Demand, shown: Sequence[_Demand]) -> Bools:
    """Return where a motion reaches the limits of others, and the short times between, shape (K,)."""
    speed = _limit([float(np.quantile(one.speed, SUSTAINED)) for one in shown])
    acceleration = _limit([float(np.quantile(one.acceleration, SUSTAINED)) for one in shown])
    if acceleration < CLEAR * demand.acceleration_noise:
        acceleration = np.inf
    reached = np.flatnonzero(np.maximum(demand.speed / speed, np.sqrt(demand.acceleration / acceleration)) >= REACHED)
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
    """Return the maximum value that at least SHARED values have in common; infinite if there is none."""
    found = np.array(values)
    for value in np.sort(found)[::-1].tolist():
        alike = found[np.abs(found - value) <= ALIKE * value]
        if len(alike) >= SHARED:
            return float(np.median(alike))
    return float("inf")


__all__ = ["confirmed_by_limits"]
