"""Noise floors of the error: the true safety function at the noisy position, and the Bayes estimate.

The plug-in estimate uses the noisy position as the true one. The Bayes estimate is E[s | noisy position] under a flat
prior of the true position: the mean of the levels under the noise around the measured position, in closed form.
"""

from __future__ import annotations

from math import erf
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

_erf = np.vectorize(erf, otypes=[np.float64])


def plug_in(safety: Mapping[str, Any], robot_m: Vector, human_m: Vector) -> Vector:
    """Return the true scaling for these positions, shape (N,).

    Args:
        safety: Safety function from `truth.json` of a simulation: a staircase of the distance, or zones on the floor.
        robot_m: Positions of the TCP, shape (N, 3), m.
        human_m: Positions of the operator, shape (N, 3), m.
    """
    levels = np.array(safety["levels"])
    if safety["kind"] == "DistanceStaircase":
        apart = np.linalg.norm(robot_m - human_m, axis=1)
        return np.asarray(levels[np.searchsorted(np.array(safety["thresholds_m"]), apart, side="left")])
    step = np.full(len(human_m), len(levels) - 1)
    for zone in _zones(safety):
        inside = np.ones(len(human_m), np.bool_)
        for axis, (low, high) in enumerate((zone["x_m"], zone["y_m"])):
            inside &= (human_m[:, axis] >= low) & (human_m[:, axis] <= high)
        step[inside] = np.minimum(step[inside], int(zone["step"]))
    return np.asarray(levels[step])


def bayes(safety: Mapping[str, Any], robot_m: Vector, human_m: Vector, delta_m: float) -> Vector:
    """Return E[s | noisy position] under a flat prior, shape (N,).

    Args:
        safety: As in `plug_in`.
        robot_m: Exact positions of the TCP, shape (N, 3), m.
        human_m: Positions of the operator with white noise, shape (N, 3), m.
        delta_m: Standard deviation of that noise per axis, m.
    """
    if delta_m == 0:
        return plug_in(safety, robot_m, human_m)
    levels = np.array(safety["levels"])
    if safety["kind"] == "DistanceStaircase":
        apart = np.linalg.norm(robot_m - human_m, axis=1)
        beyond = [1 - _within(apart, threshold, delta_m) for threshold in safety["thresholds_m"]]
        return np.asarray(levels[0] + np.diff(levels) @ np.array(beyond))
    # Zones are nested, slower ones inside: the level is that of the innermost zone that contains the operator.
    scaling = np.full(len(human_m), levels[-1])
    zones = sorted(_zones(safety), key=lambda zone: -int(zone["step"]))
    steps = [int(zone["step"]) for zone in zones]
    for zone, step, outer in zip(zones, steps, [len(levels) - 1, *steps], strict=False):
        inside = np.ones(len(human_m))
        for axis, (low, high) in enumerate((zone["x_m"], zone["y_m"])):
            inside *= _below((high - human_m[:, axis]) / delta_m) - _below((low - human_m[:, axis]) / delta_m)
        scaling -= (levels[outer] - levels[step]) * inside
    return scaling


def _zones(safety: Mapping[str, Any]) -> list[dict[str, Any]]:
    if safety["kind"] != "FloorZones":
        msg = f"no floor is known for a safety function of kind {safety['kind']!r}"
        raise DatasetError(msg)
    return list(safety["zones"])


def _within(apart: Vector, radius: float, delta: float) -> Vector:
    """Return the probability that a point with noise around one at distance `apart` from the centre is within `radius`.

    Distance / delta is non-central chi with three degrees of freedom, whose distribution function has a closed form.
    """
    ratio, mean = radius / delta, np.maximum(apart / delta, 1e-9)
    density = np.exp(-((mean - ratio) ** 2) / 2) - np.exp(-((mean + ratio) ** 2) / 2)
    return np.asarray(_below(ratio - mean) - _below(-ratio - mean) - density / (mean * np.sqrt(2 * np.pi)))


def _below(z: Vector) -> Vector:
    """Return the standard normal distribution function."""
    return np.asarray(0.5 * (1 + _erf(z / 2**0.5)))
