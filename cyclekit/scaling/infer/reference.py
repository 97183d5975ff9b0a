"""The reference of a motion: nominal time along its path, from runs with nobody in the cell or from all repetitions.

Without runs in an empty cell, the repetitions give the reference: as no scaling exceeds 1, the fastest pace at each
place of the path is the nominal one, if it was ever reached. Two checks: a pace that few repetitions reached is not
accepted; and a motion that was slowed by k in every repetition shows in its dynamics, as speed scales with k and
acceleration with k² (time scaling; Hollerbach 1984), while a program that moves slowly on purpose accelerates as usual.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.scaling.infer.limits import limits_along
from cyclekit.scaling.infer.path import SMOOTH_S, Path, match_to_path, path_of
from cyclekit.scaling.infer.rate_along_path import rate_along_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Bools, Ints, Points, Vector


AMONG = 60
"""Number of repetitions, the fastest ones, from which the nominal pace is taken."""
TOP = 0.05
"""Share of the repetitions that must reach the nominal pace, so that one outlier does not set it."""
WITNESSES = 3
"""Minimum number of repetitions at a pace; fewer may share a level below full speed."""
SAME = 0.02
"""Relative tolerance for equal paces, in addition to their noise."""
VAGUE_SD = 0.1
OFF = 0.03
"""Maximum distance from the path, as share of its length, for a repetition of it."""
SLOWED, ALIKE = 0.97, 0.06
"""A motion was slowed in every repetition if speed and root of acceleration are below SLOWED of every limit, and
differ by less than ALIKE."""
STOP_S, STILL = 0.2, 0.02
"""Minimum duration of a stop, s, and maximum rate of advance in it; stops within STOP_S on the path are one."""
CLEAR = 10.0
"""Minimum limit of speed or acceleration, in units of its noise."""
STRAIGHT = 0.01
"""Maximum distance from the straight line to the goal, as share of its length, for a straight motion of the TCP."""
LOOKED_AT = 60
"""Number of rows by which the path of a repetition is identified."""


@dataclass(frozen=True)
class Repetition:
    """One motion from a place to the next.

    Attributes:
        t_s: Time, shape (T,), strictly increasing, s.
        points: Joint angles or TCP positions in units of their noise, shape (T, D).
        tcp_m: TCP, shape (T, 3), m; NaN = unknown.
        slider: Logged slow-down, shape (T,), in (0, 1]: the operator's slider, times the scaling if it was logged;
            NaN = slowed too much to give the pace.
    """

    t_s: Vector
    points: Points
    tcp_m: Points
    slider: Vector


@dataclass(frozen=True)
class Reference:
    """One motion at full speed.

    Attributes:
        path: Places and nominal times.
        confirmed: Per row of the path, whether WITNESSES repetitions reached the pace, the cell was empty, or the
            motion reaches a limit that other motions reach (`full_speed`).
        repetitions: Number of repetitions.
        stops: Stops shared by every repetition, as `own_s` of the path; they may be programmed.
        alone: Whether it was recorded with nobody in the cell.
        peak: Maximum speed and acceleration at nominal pace, (2, D + 1): of each joint (or axis), in units of its
            noise, and of the TCP along its path, m/s and m/s² (NaN: TCP unknown).
        noise: Standard deviation of `peak` by the noise of the log, (2, D + 1); 0 for the TCP.
        straight: Whether the TCP moves straight to its goal.
        slowed: Share of full speed that no repetition exceeded; 1 = no sign of slowing.
    """

    path: Path
    confirmed: Bools
    stops: Vector
    alone: bool
    peak: Points
    noise: Points
    straight: bool
    repetitions: int
    slowed: float = 1.0


def reference_of(repetitions: Sequence[Repetition], *, alone: bool) -> Reference | None:
    """Return the reference of a motion; None without repetitions.

    Args:
        repetitions: Repetitions of one motion between two places; those that take another path are ignored, and those
            of logs without joint angles where most have them, or the other way round.
        alone: Whether they were recorded with nobody in the cell.
    """
    if not repetitions:
        return None
    ((width, _),) = Counter(each.points.shape[1] for each in repetitions).most_common(1)
    alike = (each for each in repetitions if each.points.shape[1] == width)
    fastest = sorted(alike, key=lambda r: float(r.t_s[-1] - r.t_s[0]))[:AMONG]
    path = path_of(fastest[0].t_s, fastest[0].points)
    rates, deviations, stops, ways = [], [], [], []
    for repetition in fastest:
        found = match_to_path(path, repetition.t_s, repetition.points)
        if is_elsewhere(path, found.off):
            continue
        rate, deviation = rate_along_path(repetition.t_s, found.own_s, found.variance_s2)
        stops.append(_stops(repetition.t_s, rate, found.own_s))
        rows = np.searchsorted(np.maximum.accumulate(found.own_s), path.own_s, side="right") - 1
        rows = np.clip(rows, 0, len(rate) - 1)
        ways.append(_tcp_along(path, found.own_s, repetition.tcp_m))
        rates.append(rate[rows] / repetition.slider[rows])
        deviations.append(deviation[rows] / repetition.slider[rows])
    pace, agreeing = _top(np.array(rates), np.array(deviations), 0.5 if alone else TOP)
    pace = pace / limits_along(_integral(1.0 / pace, path.own_s), path.points)
    return Reference(
        path.retimed(_integral(1.0 / pace, path.own_s)),
        np.full(len(pace), True) if alone else agreeing >= WITNESSES,
        _common(stops) if not alone else np.empty(0),
        alone,
        np.column_stack([_peak(path, pace), _tcp_peak(path, pace, ways[0])]),
        np.column_stack([np.tile(_peak_noise(path), (path.points.shape[1], 1)).T, np.zeros(2)]),
        _is_straight(ways[0]),
        len(rates),
    )


def takes_another(path: Path, repetition: Repetition) -> bool:
    """Return whether a repetition takes another path between the same places."""
    thin = np.unique(np.linspace(0, len(repetition.t_s) - 1, LOOKED_AT).astype(np.int64))
    return is_elsewhere(path, match_to_path(path, repetition.t_s[thin], repetition.points[thin]).off)


def is_elsewhere(path: Path, off: Vector) -> bool:
    """Return whether rows with distance `off` from a path, shape (T,), in units of the noise, are of another path."""
    return bool(np.quantile(off, 0.95) > max(OFF * path.length, 20.0))


def _top(rates: Points, deviations: Points, top: float) -> tuple[Vector, Ints]:
    """Return the pace reached at each row of the path and the number of repetitions at it, from (N, M) rates."""
    count, rows = rates.shape
    known = np.isfinite(rates) & (deviations < VAGUE_SD * np.maximum(rates, 0.1))
    rates = np.where(known, rates, 0.0)
    sure = np.where(known, rates - 2.0 * deviations, -np.inf)
    column = np.arange(rows)
    rank = count - np.maximum(1, np.ceil(top * known.sum(axis=0)).astype(np.int64))
    best = np.argsort(sure, axis=0)[rank, column]
    pace, deviation = rates[best, column], deviations[best, column]
    near = known & (np.abs(rates - pace) <= SAME * np.abs(pace) + 3.0 * np.hypot(deviations, deviation))
    weight = np.where(near, 1.0 / (deviations**2 + 1e-6), 0.0)
    total = weight.sum(axis=0)
    found = np.flatnonzero(total > 0)
    if not len(found):
        return np.ones(rows), np.zeros(rows, np.int64)
    mean = np.divide((weight * rates).sum(axis=0), total, out=np.ones(rows), where=total > 0)
    filled = np.interp(column, found, mean[found])  # near the ends, where the pace is unknown, the nearest known one
    nearest = found[np.clip(np.searchsorted(found, column), 0, len(found) - 1)]
    return np.maximum(filled, 1e-3), near.sum(axis=0)[nearest]


def _stops(t_s: Vector, rate: Vector, own_s: Vector) -> Vector:
    """Return the places on the path, as `own_s`, at which a repetition stops for at least STOP_S."""
    still = np.concatenate([[False], rate < STILL, [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8))).reshape(-1, 2)
    lasting = edges[t_s[edges[:, 1] - 1] - t_s[edges[:, 0]] > STOP_S]
    return np.array([float(np.median(own_s[a:b])) for a, b in lasting.tolist()])


def _common(stops: Sequence[Vector]) -> Vector:
    """Return the stops that all repetitions share."""
    kept = [s for s in stops[0].tolist() if all((np.abs(other - s) < STOP_S).any() for other in stops)]
    return np.array(kept)


def is_common_stop(reference: Reference, t_s: Vector, rate: Vector, own_s: Vector) -> Bools:
    """Return which rows, shape (T,), belong to a stop shared by every repetition."""
    near = (np.abs(own_s[:, None] - reference.stops[None]) < STOP_S).any(axis=1)
    return np.asarray(near & (rate < STILL) & (t_s > t_s[0]))


def _integral(rate: Vector, s: Vector) -> Vector:
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(s))])


def _peak(path: Path, pace: Vector) -> Points:
    over = max(1, min(round(SMOOTH_S / float(path.own_s[1])), len(pace) // 4))
    change = (path.slope[2 * over :] - path.slope[: -2 * over]) / (2 * over * float(path.own_s[1]))
    both = np.abs(path.slope * pace[:, None]), np.abs(change * pace[over:-over, None] ** 2)
    return np.array([np.quantile(values, 0.98, axis=0) for values in both])


def _peak_noise(path: Path) -> Vector:
    """Return the standard deviation of the speed and acceleration of `_peak`, shape (2,), for points with noise 1."""
    period = float(path.own_s[1])
    over = max(2, round(SMOOTH_S / period))
    speed = 2.7 * over**-1.5 / period  # of the slope of a cubic over 2 over + 1 rows
    return np.array([speed, speed / (np.sqrt(2.0) * over * period)])


def _tcp_along(path: Path, own_s: Vector, tcp_m: Points) -> Points:
    """Return the TCP at each row of a path, shape (M, 3), interpolated from a repetition matched to it."""
    place, first = np.unique(np.maximum.accumulate(own_s), return_index=True)
    return np.column_stack([np.interp(path.own_s, place, tcp_m[first, axis]) for axis in range(3)])


def _tcp_peak(path: Path, pace: Vector, tcp_m: Points) -> Vector:
    """Return maximum speed and acceleration of the TCP along its path, shape (M, 3), at nominal pace, shape (2,)."""
    if len(pace) < 5:
        return np.full(2, np.nan)
    over = max(1, min(round(SMOOTH_S / float(path.own_s[1])), len(pace) // 5))
    nominal = _integral(1.0 / pace, path.own_s)
    lasts = nominal[2 * over :] - nominal[: -2 * over]
    speed = np.linalg.norm(tcp_m[2 * over :] - tcp_m[: -2 * over], axis=1) / lasts
    force = (speed[2 * over :] - speed[: -2 * over]) / lasts[over:-over]
    return np.array([np.quantile(speed, 0.98), np.quantile(np.abs(force), 0.98)])


def _is_straight(tcp_m: Points) -> bool:
    """Return whether the TCP, shape (M, 3), moves straight to its goal."""
    way = tcp_m[-1] - tcp_m[0]
    length = float(np.linalg.norm(way))
    if not length > 0.0:  # NaN: unknown
        return False
    off = tcp_m - tcp_m[0]
    return bool(np.linalg.norm(off - np.outer(off @ way, way) / length**2, axis=1).max() < STRAIGHT * length)


def with_dynamics(references: Sequence[Reference]) -> list[float]:
    """Return for each reference the share of full speed that its motion never exceeded; 1 = no sign of slowing.

    A straight motion is compared only by the limits of the TCP's speed and acceleration, as its joint motion depends on
    where it is; any other motion is compared by the limits of its joints too. A motion that reaches any of these
    limits was at full speed, and so was one recorded in an empty cell.
    """
    shares = [1.0] * len(references)
    for width in {reference.peak.shape[1] for reference in references}:
        mine = [i for i, reference in enumerate(references) if reference.peak.shape[1] == width]
        curved = [references[i] for i in mine if not references[i].straight]
        joints = _limits(curved, slice(-1)) if curved else np.full((2, width - 1), np.nan)
        tcp = _limits([references[i] for i in mine], slice(-1, None))
        for i in mine:
            one = references[i]
            limits = np.column_stack([np.full_like(joints, np.nan) if one.straight else joints, tcp])
            shares[i] = 1.0 if one.alone else _share(one.peak / limits)
    return shares


def _limits(references: Sequence[Reference], columns: slice) -> Points:
    """Return the speed and acceleration that at least two motions reached, (2, C); NaN where it is only noise.

    A single motion proves no limit.
    """
    peaks = np.array([reference.peak[:, columns] for reference in references])
    if len(peaks) < 2:
        return np.full_like(references[0].peak[:, columns], np.nan)
    noise = np.median([reference.noise[:, columns] for reference in references], axis=0)
    second = np.sort(np.where(np.isnan(peaks), 0.0, peaks), axis=0)[-2]
    return np.where(second > CLEAR * noise, second, np.nan)


def _share(part: Points) -> float:
    """Return the share of full speed from peaks (2, D) as shares of their limits; NaN = no limit."""
    known = np.isfinite(part).all(axis=0)
    speed, force = part[0, known], part[1, known] ** 0.5
    if not known.any() or max(speed.max(), force.max()) >= SLOWED:
        return 1.0
    leading = int(speed.argmax())
    return float(speed[leading]) if abs(speed[leading] - force[leading]) < ALIKE else 1.0
