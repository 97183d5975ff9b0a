"""At which reaction time the places agree at which one level gives way to the next.

A threshold is crossed at the same distance each time, or on the same line across the floor. So for each time that may
have passed since, it is asked how near the distances at the changes of one kind lie to each other, and how near each
place of the operator lies to the line through those around it. At the right time both are exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.unknown_height import in_plane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Ints, Points, Vector


LATEST_S, STEP_S = 1.0, 0.01
"""Reaction times up to this are tried, in such steps."""
LONGEST_S, COARSE_S = 3.5, 0.02
"""With a hold time the robot speeds up as late as this; tried in such steps."""
LATENCIES_S = np.concatenate(
    [np.arange(0.0, LATEST_S + STEP_S / 2, STEP_S), np.arange(LATEST_S + COARSE_S, LONGEST_S, COARSE_S)]
)
_LATEST = round(LATEST_S / STEP_S)
HOLD_S = 0.06
"""A robot that speeds up later than it slows down by less than this is not held."""
_HELD = 0.4
"""Maximum ratio of the rising changes' spread with a hold time to the spread without one."""
LEAST, LEAST_KIND = 20, 5
"""Fewer changes in all, or of one kind, say nothing."""
AGREE_M = 0.04
"""Places agree if half of them are within this of where the others of their kind are."""
LEAST_M = 0.01
"""A hysteresis of less is the error of its reading."""
_SHARE = 0.4
"""Of the changes of one kind so many must share a distance: a zone may cause the others."""
_AROUND = 8
"""So many neighbours show the line of a zone."""
_MOST_AROUND = 400
"""More changes of one kind say no more about lines."""
_EXACT_M, _BETTER = 0.005, 0.6
"""Where distances alone agree so well nothing else is asked; else lines must make it so much better."""
_SHARPER = 0.6
"""A line must make the places agree so much better than the worst reaction time does."""


@dataclass(frozen=True)
class PlacesBefore:
    """Where TCP and operator were, at each time before N changes.

    Attributes:
        kind: Which threshold and direction, shape (N,): twice the slower level, one more where it rises.
        apart_m: Their distance, shape (N, L), metres.
        floor_m: The operator on the floor, shape (N, L, 2), metres.
        floor_apart_m: Their horizontal distance, shape (N, L), metres.
        samples: How many distances were known in all.
    """

    kind: Ints
    apart_m: NDArray[np.float64]
    floor_m: NDArray[np.float64]
    floor_apart_m: NDArray[np.float64]
    samples: int

    @classmethod
    def before(cls, begin_s: Vector, kind: Ints, t_s: Vector, robot_m: Points, human_m: Points) -> PlacesBefore:
        """Look up the places before changes that began at `begin_s` (N,), s, in samples at `t_s` (M,), s."""
        apart = np.linalg.norm(robot_m - in_plane(robot_m, human_m), axis=1) if len(t_s) else np.empty(0)
        known = np.isfinite(apart)
        at = begin_s[:, None] - LATENCIES_S[None]
        if not known.any() or not len(begin_s):
            none = np.empty((0, len(LATENCIES_S)))
            return cls(kind[:0], none, np.empty((*none.shape, 2)), none, int(known.sum()))
        on_floor = np.linalg.norm((robot_m - human_m)[known, :2], axis=1)
        look = [np.interp(at, t_s[known], values) for values in (apart[known], on_floor, *human_m[known, :2].T)]
        return cls(kind, look[0], np.stack(look[2:], axis=2), look[1], int(known.sum()))


@dataclass(frozen=True)
class Agreement:
    """What the places tell.

    Attributes:
        latency_s: At which they agree best; None: at none.
        falling_s, rising_s: That of the changes down and up; they differ by a hold time.
        hysteresis_m: How much farther than the falling changes the rising ones are; None where it is no distance.
        spread_m: Median deviation at `latency_s`.
    """

    latency_s: float | None
    falling_s: float | None
    rising_s: float | None
    hysteresis_m: float | None
    spread_m: float

    @property
    def held(self) -> bool:
        """Whether the robot speeds up later than it slows down."""
        return self.falling_s is not None and self.rising_s is not None and self.rising_s - self.falling_s > HOLD_S


def agreement_of(seen: Sequence[PlacesBefore]) -> Agreement | None:
    """Return at which reaction time the places agree; None where there are too few."""
    kind = np.concatenate([np.empty(0, np.int64), *(mine.kind for mine in seen)])
    if len(kind) < LEAST or sum(mine.samples for mine in seen) < LEAST:
        return None
    apart = np.concatenate([mine.apart_m for mine in seen])
    alone = _by_distance(apart, kind)
    if alone is None:
        return None
    if alone.latency_s is not None and alone.spread_m <= _EXACT_M:
        return alone
    on_floor_m = np.concatenate([mine.floor_apart_m for mine in seen])
    on_floor = _by_distance(on_floor_m, kind)
    if on_floor is not None and on_floor.latency_s is not None and on_floor.spread_m < _BETTER * alone.spread_m:
        apart, alone = on_floor_m, on_floor
    lines = _by_lines(apart, np.concatenate([mine.floor_m for mine in seen]), kind, alone.spread_m)
    return lines if lines.latency_s is not None and lines.spread_m < _BETTER * alone.spread_m else alone


def _by_distance(apart: NDArray[np.float64], kind: Ints) -> Agreement | None:
    """Return at which reaction time distances (N, L) agree, m; None if changes of each kind are too rare."""
    spreads = _spreads(apart, kind)
    if spreads is None:
        return None
    found = _agreement(spreads, kind)
    if found.latency_s is None:
        return found
    both = (found.falling_s, found.rising_s) if found.held else (found.latency_s, found.latency_s)
    return replace(found, hysteresis_m=_lag(_at(apart, kind, both), kind))


def _agreement(spreads: NDArray[np.float64], kind: Ints, most_m: float = AGREE_M) -> Agreement:
    """Return at which time changes agree, of how far each is from the others, shape (N, L); hysteresis is left out."""
    falling, rising = _best(spreads[kind % 2 == 0, : _LATEST + 1]), _best(spreads[kind % 2 == 1])
    apart = Agreement(falling, falling, rising, None, 0.0)
    if apart.held and _is_held(spreads[kind % 2 == 1], falling, rising):
        return replace(apart, spread_m=float(np.nanmedian(_at(spreads, kind, (falling, rising)))))
    spread = np.nanmedian(spreads[:, : _LATEST + 1], axis=0)
    best = int(spread.argmin())
    if spread[best] <= most_m and best < _LATEST:
        latency_s = float(LATENCIES_S[best])
        return Agreement(latency_s, latency_s, latency_s, None, float(spread[best]))
    return Agreement(None, None, None, None, float(spread[best]))


def _is_held(spreads: NDArray[np.float64], falling: float | None, rising: float | None) -> bool:
    """Return whether rising changes (N, L) agree much better at their own time than at that of the falling ones."""
    column = np.searchsorted(LATENCIES_S, np.array((falling, rising), np.float64) - 1e-9)
    at_once, late = np.nanmedian(spreads[:, column], axis=0)
    return bool(late < _HELD * at_once)


def _at(values: NDArray[np.float64], kind: Ints, late_s: tuple[float | None, float | None]) -> Vector:
    """Return values (N, L) at the times of falling and of rising changes, shape (N,)."""
    column = np.searchsorted(LATENCIES_S, np.array(late_s, np.float64) - 1e-9)
    return np.asarray(values[np.arange(len(values)), column[kind % 2]])


def _best(spreads: NDArray[np.float64]) -> float | None:
    told = spreads[np.isfinite(spreads).all(axis=1)]
    if len(told) < LEAST:
        return None
    spread = np.median(told, axis=0)
    best = int(spread.argmin())
    return float(LATENCIES_S[best]) if spread[best] <= AGREE_M and best < len(spread) - 1 else None


def _spreads(apart: NDArray[np.float64], kind: Ints) -> NDArray[np.float64] | None:
    """Return how far each change is from the others of its kind, shape (N, L); NaN of kinds that are too rare."""
    off = np.full(apart.shape, np.nan)
    for one in np.unique(kind):
        mine = kind == one
        if mine.sum() >= LEAST_KIND:
            off[mine] = np.abs(apart[mine] - np.median(apart[mine], axis=0))
    return None if np.isnan(off).all() else off


def _by_lines(apart: NDArray[np.float64], floor: NDArray[np.float64], kind: Ints, spread_m: float) -> Agreement:
    """Return at which reaction time places agree that share a line on the floor, or a distance that others have too."""
    every = [np.flatnonzero(kind == one) for one in np.unique(kind)]
    every = [mine[:: -(-len(mine) // _MOST_AROUND)] for mine in every if len(mine) > 2 * _AROUND]
    if sum(len(mine) for mine in every) < LEAST:
        return Agreement(None, None, None, None, spread_m)
    off = [np.minimum(_off_lines(floor[mine]), _off_shared(apart[mine])) for mine in every]
    spreads = np.concatenate(off)
    usual_m = float(np.median(np.median(spreads[:, : _LATEST + 1], axis=0)))
    found = _agreement(spreads, np.concatenate([kind[mine] for mine in every]), min(AGREE_M, _SHARPER * usual_m))
    if found.latency_s is None or found.spread_m > _SHARPER * usual_m:
        return Agreement(None, None, None, None, min(spread_m, found.spread_m))
    return found


def _off_lines(floor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far places (N, L, 2) are from the line through those around them, shape (N, L)."""
    off = np.empty(floor.shape[:2])
    for number in range(floor.shape[1]):
        at = floor[:, number]
        away = ((at[:, None] - at[None]) ** 2).sum(axis=2)
        around = at[np.argpartition(away, _AROUND, axis=1)[:, : _AROUND + 1]]
        around = around - around.mean(axis=1, keepdims=True)
        off[:, number] = np.linalg.svd(around, compute_uv=False)[:, 1] / np.sqrt(_AROUND)
    return off


def _off_shared(apart: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far distances (N, L) are from the one that most of them are near, shape (N, L)."""
    ordered = np.sort(apart, axis=0)
    count = max(2, int(_SHARE * len(apart)))
    width = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    first = width.argmin(axis=0)
    middle = ordered[first + count // 2, np.arange(apart.shape[1])]
    return np.asarray(np.abs(apart - middle))


def _lag(apart: Vector, kind: Ints) -> float | None:
    """Return how much farther than it slows the robot speeds up again."""
    lag = [
        float(np.median(apart[kind == 2 * step + 1]) - np.median(apart[kind == 2 * step]))
        for step in np.unique(kind // 2).tolist()
        if (kind == 2 * step).sum() >= LEAST_KIND and (kind == 2 * step + 1).sum() >= LEAST_KIND
    ]
    if not lag:
        return None
    return float(np.median(lag)) if np.median(lag) >= LEAST_M else 0.0
