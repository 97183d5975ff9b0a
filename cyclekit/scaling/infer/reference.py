"""The reference of a motion: nominal time along its path, from runs with nobody in the cell or from all repetitions.

Where nobody recorded an empty cell, the repetitions themselves tell: at each place of the path somebody ran fastest,
and since no scaling exceeds 1, that was the nominal pace if it was ever reached there. Whether it was is looked at
twice: a pace that hardly any repetition reached is not believed, and a motion that was slowed by k in every repetition
gives itself away by dynamics, since speed scales with k and acceleration with k squared (time scaling; Hollerbach
1984). A robot program that moves slowly on purpose accelerates as usual.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.scaling.infer.advance import advance
from cyclekit.scaling.infer.limits import limits_along
from cyclekit.scaling.infer.path import SMOOTH_S, Path, along, path_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Bools, Ints, Points, Vector


AMONG = 60
"""The envelope is taken over this many repetitions, the fastest ones."""
TOP = 0.05
"""The nominal pace is what this fraction of the repetitions reached, so that one outlier does not set it."""
WITNESSES = 3
"""A pace that fewer repetitions reached may be a level below full speed that they had in common."""
SAME = 0.02
"""Paces that differ by less (or by their noise) are the same pace."""
VAGUE_SD = 0.1
OFF = 0.03
"""A repetition whose way leaves the path by more than this fraction of its length takes another path."""
SLOWED, ALIKE = 0.97, 0.06
"""A motion was slowed in every repetition if speed and root of acceleration are below this part of every limit, and
alike."""
STOP_S, STILL = 0.2, 0.02
"""A repetition stands where it advances slower than STILL for longer than STOP_S; stops so near in it are one."""
CLEAR = 10.0
"""A limit of speed or acceleration that is less than this many times its noise does not count."""
STRAIGHT = 0.01
"""A TCP that never leaves the straight line to its goal by more than this fraction of its length goes straight."""
LOOKED_AT = 60
"""Rows of a repetition by which its path is identified."""


@dataclass(frozen=True)
class Repetition:
    """One motion from a place to the next.

    Attributes:
        t_s: Time, shape (T,), strictly increasing, seconds.
        points: Joint angles or TCP positions over their noise, shape (T, D).
        tcp_m: TCP, shape (T, 3), metres; NaN where it is not known.
        slider: What is known to have slowed it, shape (T,), in (0, 1]: the operator's slider, and the scaling where it
            was logged; NaN = it was slowed too much to tell the pace.
    """

    t_s: Vector
    points: Points
    tcp_m: Points
    slider: Vector


@dataclass(frozen=True)
class Reference:
    """What one motion is at full speed.

    Attributes:
        path: Places and nominal times.
        confirmed: Per row of the path, whether WITNESSES repetitions reached the pace, or it is that of an empty cell.
        stops: Where every repetition stands for a while, `own_s` of the path: the program may want it so.
        alone: It was recorded with nobody in the cell.
        peak: Greatest speed and acceleration at nominal pace, (2, D + 1): of each joint (or axis), in units of its
            noise, and of the TCP along its path, m/s and m/s² (NaN: the TCP is not known).
        noise: Its standard deviation by the noise of the log, (2, D + 1); that of the TCP is taken for 0.
        straight: The TCP goes straight to its goal.
        slowed: Share of full speed at which every repetition ran; 1 = no sign of slowing.
    """

    path: Path
    confirmed: Bools
    stops: Vector
    alone: bool
    peak: Points
    noise: Points
    straight: bool
    slowed: float = 1.0


def reference_of(repetitions: Sequence[Repetition], *, alone: bool) -> Reference | None:
    """Return the reference of a motion; None where one repetition of unknown speed is all there is.

    Args:
        repetitions: Of one motion between two places; those that take another path are not regarded.
        alone: They were recorded with nobody in the cell.
    """
    fastest = sorted(repetitions, key=lambda r: float(r.t_s[-1] - r.t_s[0]))[:AMONG]
    if not fastest or (len(fastest) == 1 and not alone):
        return None
    path = path_of(fastest[0].t_s, fastest[0].points)
    rates, deviations, stops, ways = [], [], [], []
    for repetition in fastest:
        found = along(path, repetition.t_s, repetition.points)
        if is_elsewhere(path, found.off):
            continue
        rate, deviation = advance(repetition.t_s, found.own_s, found.variance_s2)
        stops.append(_stops(repetition.t_s, rate, found.own_s))
        rows = np.searchsorted(np.maximum.accumulate(found.own_s), path.own_s, side="right") - 1
        rows = np.clip(rows, 0, len(rate) - 1)
        ways.append(_tcp_along(path, found.own_s, repetition.tcp_m))
        rates.append(rate[rows] / repetition.slider[rows])
        deviations.append(deviation[rows] / repetition.slider[rows])
    if len(rates) < 2 and not alone:
        return None
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
    )


def takes_another(path: Path, repetition: Repetition) -> bool:
    """Tell whether a repetition takes another path between the same places."""
    thin = np.unique(np.linspace(0, len(repetition.t_s) - 1, LOOKED_AT).astype(np.int64))
    return is_elsewhere(path, along(path, repetition.t_s[thin], repetition.points[thin]).off)


def is_elsewhere(path: Path, off: Vector) -> bool:
    """Tell whether rows so far off a path, shape (T,), in units of the noise, are of another path."""
    return bool(np.quantile(off, 0.95) > max(OFF * path.length, 20.0))


def _top(rates: Points, deviations: Points, top: float) -> tuple[Vector, Ints]:
    """Return the pace reached at each row of the path and how many repetitions agree, from (N, M) rates."""
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
    filled = np.interp(column, found, mean[found])  # near the ends, where nothing is known, the nearest pace
    nearest = found[np.clip(np.searchsorted(found, column), 0, len(found) - 1)]
    return np.maximum(filled, 1e-3), near.sum(axis=0)[nearest]


def _stops(t_s: Vector, rate: Vector, own_s: Vector) -> Vector:
    """Return where on the path a repetition stands for at least STOP_S."""
    still = np.concatenate([[False], rate < STILL, [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8))).reshape(-1, 2)
    lasting = edges[t_s[edges[:, 1] - 1] - t_s[edges[:, 0]] > STOP_S]
    return np.array([float(np.median(own_s[a:b])) for a, b in lasting.tolist()])


def _common(stops: Sequence[Vector]) -> Vector:
    """Return those stops of the first repetition that all others have too."""
    kept = [s for s in stops[0].tolist() if all((np.abs(other - s) < STOP_S).any() for other in stops)]
    return np.array(kept)


def is_common_stop(reference: Reference, t_s: Vector, rate: Vector, own_s: Vector) -> Bools:
    """Tell which rows, shape (T,), belong to a stop that every repetition has."""
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
    """Return the standard deviation of speed and acceleration as `_peak` takes them, shape (2,), points having 1."""
    period = float(path.own_s[1])
    over = max(2, round(SMOOTH_S / period))
    speed = 2.7 * over**-1.5 / period  # of the slope of a cubic over 2 over + 1 rows
    return np.array([speed, speed / (np.sqrt(2.0) * over * period)])


def _tcp_along(path: Path, own_s: Vector, tcp_m: Points) -> Points:
    """Return the TCP at each row of a path, shape (M, 3), from that of a repetition at rows of known place."""
    place, first = np.unique(np.maximum.accumulate(own_s), return_index=True)
    return np.column_stack([np.interp(path.own_s, place, tcp_m[first, axis]) for axis in range(3)])


def _tcp_peak(path: Path, pace: Vector, tcp_m: Points) -> Vector:
    """Return greatest speed and acceleration of the TCP, shape (M, 3), along its path at nominal pace, shape (2,)."""
    if len(pace) < 5:
        return np.full(2, np.nan)
    over = max(1, min(round(SMOOTH_S / float(path.own_s[1])), len(pace) // 5))
    nominal = _integral(1.0 / pace, path.own_s)
    lasts = nominal[2 * over :] - nominal[: -2 * over]
    speed = np.linalg.norm(tcp_m[2 * over :] - tcp_m[: -2 * over], axis=1) / lasts
    force = (speed[2 * over :] - speed[: -2 * over]) / lasts[over:-over]
    return np.array([np.quantile(speed, 0.98), np.quantile(np.abs(force), 0.98)])


def _is_straight(tcp_m: Points) -> bool:
    """Tell whether the TCP, shape (M, 3), goes straight to its goal."""
    way = tcp_m[-1] - tcp_m[0]
    length = float(np.linalg.norm(way))
    if not length > 0.0:  # NaN: not known
        return False
    off = tcp_m - tcp_m[0]
    return bool(np.linalg.norm(off - np.outer(off @ way, way) / length**2, axis=1).max() < STRAIGHT * length)


def with_dynamics(references: Sequence[Reference]) -> list[float]:
    """Return for each reference the share of full speed at which its motion was always run; 1 = no sign of that.

    Like is compared with like: a straight motion has a limit of the TCP's speed and acceleration along its path, and
    what its joints do follows from where it lies; any other motion has limits of its joints too. A motion that reaches
    any of these limits was at full speed, and so was one that was recorded in an empty cell.
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
    """Return the speed and acceleration that two motions at least have reached, (2, C); NaN where that is but noise.

    One motion alone proves no limit.
    """
    peaks = np.array([reference.peak[:, columns] for reference in references])
    if len(peaks) < 2:
        return np.full_like(references[0].peak[:, columns], np.nan)
    noise = np.median([reference.noise[:, columns] for reference in references], axis=0)
    second = np.sort(np.where(np.isnan(peaks), 0.0, peaks), axis=0)[-2]
    return np.where(second > CLEAR * noise, second, np.nan)


def _share(part: Points) -> float:
    """Return the share of full speed that peaks (2, D), as parts of their limits, tell; NaN = there is no limit."""
    known = np.isfinite(part).all(axis=0)
    speed, force = part[0, known], part[1, known] ** 0.5
    if not known.any() or max(speed.max(), force.max()) >= SLOWED:
        return 1.0
    leading = int(speed.argmax())
    return float(speed[leading]) if abs(speed[leading] - force[leading]) < ALIKE else 1.0
