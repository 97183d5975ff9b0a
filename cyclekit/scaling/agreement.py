"""Find the reaction time at which the places of equal changes of level agree best.

A threshold is crossed at the same distance each time, or on the same line on the floor. So for each candidate reaction
time, two spreads are computed: of the distances at changes of one kind, and of the operator's places about the line
through their neighbours. At the right reaction time, the one that the safety function uses vanishes.
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
"""Maximum reaction time and step between candidates, s."""
LONGEST_S, COARSE_S = 3.5, 0.02
"""Maximum delay of a rise, including a hold time, and step between candidates above LATEST_S, s."""
LATENCIES_S = np.concatenate(
    [np.arange(0.0, LATEST_S + STEP_S / 2, STEP_S), np.arange(LATEST_S + COARSE_S, LONGEST_S, COARSE_S)]
)
_LATEST = round(LATEST_S / STEP_S)
HOLD_S = 0.06
"""Minimum hold time, s: minimum by which rises must be later than falls."""
_MAX_HOLD_RATIO = 0.4
"""Maximum ratio of the rising changes' spread with a hold time to the spread without one."""
MIN_CHANGES, MIN_CHANGES_OF_KIND = 20, 5
"""Minimum number of changes: in total, and of one kind."""
AGREE_M = 0.04
"""Maximum median deviation, m, at which places of one kind agree."""
MIN_HYSTERESIS_M = 0.01
"""Minimum hysteresis, m: smaller values are measurement error and count as 0."""
_COMMON_SHARE = 0.4
"""Minimum share of the changes of one kind at a common distance: a zone may cause the others."""
_NEIGHBOURS = 8
"""Number of neighbours for the line of a zone."""
_MAX_CHANGES_FOR_LINES = 400
"""Maximum number of changes of one kind used for lines."""
_EXACT_M, _BETTER = 0.005, 0.6
"""Spread, m, at which distances alone suffice; else, maximum ratio of the spread with lines to that without."""
_SHARPER = 0.6
"""Maximum ratio of the spread with lines to the median spread over all reaction times."""


@dataclass(frozen=True)
class PositionsBeforeChanges:
    """Positions of TCP and operator at L times before each of N changes.

    Attributes:
        change_kind: Threshold and direction, shape (N,): twice the index of the slower level, plus 1 for a rise.
        apart_m: Distance between TCP and operator, shape (N, L), m.
        floor_m: The operator's position on the floor, shape (N, L, 2), m.
        floor_apart_m: Horizontal distance between TCP and operator, shape (N, L), m.
        samples: Number of samples with a known distance.
    """

    change_kind: Ints
    apart_m: NDArray[np.float64]
    floor_m: NDArray[np.float64]
    floor_apart_m: NDArray[np.float64]
    samples: int

    @classmethod
    def before(
        cls, begin_s: Vector, change_kind: Ints, t_s: Vector, robot_m: Points, human_m: Points
    ) -> PositionsBeforeChanges:
        """Look up the places before changes that began at `begin_s` (N,), s, in samples at `t_s` (M,), s."""
        apart = np.linalg.norm(robot_m - in_plane(robot_m, human_m), axis=1) if len(t_s) else np.empty(0)
        known = np.isfinite(apart)
        at = begin_s[:, None] - LATENCIES_S[None]
        if not known.any() or not len(begin_s):
            none = np.empty((0, len(LATENCIES_S)))
            return cls(change_kind[:0], none, np.empty((*none.shape, 2)), none, int(known.sum()))
        on_floor = np.linalg.norm((robot_m - human_m)[known, :2], axis=1)
        look = [np.interp(at, t_s[known], values) for values in (apart[known], on_floor, *human_m[known, :2].T)]
        return cls(change_kind, look[0], np.stack(look[2:], axis=2), look[1], int(known.sum()))


@dataclass(frozen=True)
class Agreement:
    """Reaction time and hysteresis from the places of changes.

    Attributes:
        latency_s: Reaction time at which the places agree best, s; None if they agree at none.
        falling_s, rising_s: Reaction time of falls and of rises, s; they differ by a hold time.
        hysteresis_m: Distance of rises minus distance of falls, m; None unless the thresholds are distances.
        spread_m: Median deviation at `latency_s`, m.
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


def agreement_of(seen: Sequence[PositionsBeforeChanges]) -> Agreement | None:
    """Return the reaction time at which the places agree; None if there are too few changes."""
    change_kind = np.concatenate([np.empty(0, np.int64), *(mine.change_kind for mine in seen)])
    if len(change_kind) < MIN_CHANGES or sum(mine.samples for mine in seen) < MIN_CHANGES:
        return None
    apart = np.concatenate([mine.apart_m for mine in seen])
    alone = _by_distance(apart, change_kind)
    if alone is None:
        return None
    if alone.latency_s is not None and alone.spread_m <= _EXACT_M:
        return alone
    on_floor_m = np.concatenate([mine.floor_apart_m for mine in seen])
    on_floor = _by_distance(on_floor_m, change_kind)
    if on_floor is not None and on_floor.latency_s is not None and on_floor.spread_m < _BETTER * alone.spread_m:
        apart, alone = on_floor_m, on_floor
    lines = _by_lines(apart, np.concatenate([mine.floor_m for mine in seen]), change_kind, alone.spread_m)
    return lines if lines.latency_s is not None and lines.spread_m < _BETTER * alone.spread_m else alone


def _by_distance(apart: NDArray[np.float64], change_kind: Ints) -> Agreement | None:
    """Return the reaction time at which distances (N, L), m, agree; None if changes of each kind are too rare."""
    spreads = _deviations(apart, change_kind)
    if spreads is None:
        return None
    found = _agreement(spreads, change_kind)
    if found.latency_s is None:
        return found
    both = (found.falling_s, found.rising_s) if found.held else (found.latency_s, found.latency_s)
    return replace(found, hysteresis_m=_hysteresis_m(_at(apart, change_kind, both), change_kind))


def _agreement(spreads: NDArray[np.float64], change_kind: Ints, max_m: float = AGREE_M) -> Agreement:
    """Return the reaction time with the smallest median of `spreads`, shape (N, L); without hysteresis."""
    falls, rises = spreads[change_kind % 2 == 0, : _LATEST + 1], spreads[change_kind % 2 == 1]
    falling, rising = _best_latency_s(falls), _best_latency_s(rises)
    apart = Agreement(falling, falling, rising, None, 0.0)
    if apart.held and _is_held(rises, falling, rising):
        return replace(apart, spread_m=float(np.nanmedian(_at(spreads, change_kind, (falling, rising)))))
    spread = np.nanmedian(spreads[:, : _LATEST + 1], axis=0)
    best = int(spread.argmin())
    if spread[best] <= max_m and best < _LATEST:
        latency_s = float(LATENCIES_S[best])
        return Agreement(latency_s, latency_s, latency_s, None, float(spread[best]))
    return Agreement(None, None, None, None, float(spread[best]))


def _is_held(spreads: NDArray[np.float64], falling: float | None, rising: float | None) -> bool:
    """Return whether rising changes (N, L) agree much better at their own time than at that of the falling ones."""
    column = np.searchsorted(LATENCIES_S, np.array((falling, rising), np.float64) - 1e-9)
    at_once, late = np.nanmedian(spreads[:, column], axis=0)
    return bool(late < _MAX_HOLD_RATIO * at_once)


def _at(values: NDArray[np.float64], change_kind: Ints, late_s: tuple[float | None, float | None]) -> Vector:
    """Return values (N, L) at the reaction time of falls or rises, by the kind of change, shape (N,)."""
    column = np.searchsorted(LATENCIES_S, np.array(late_s, np.float64) - 1e-9)
    return np.asarray(values[np.arange(len(values)), column[change_kind % 2]])


def _best_latency_s(spreads: NDArray[np.float64]) -> float | None:
    known = spreads[np.isfinite(spreads).all(axis=1)]
    if len(known) < MIN_CHANGES:
        return None
    spread = np.median(known, axis=0)
    best = int(spread.argmin())
    return float(LATENCIES_S[best]) if spread[best] <= AGREE_M and best < len(spread) - 1 else None


def _deviations(apart: NDArray[np.float64], change_kind: Ints) -> NDArray[np.float64] | None:
    """Return the deviation of each change from the median of its kind, shape (N, L); NaN for rare kinds."""
    deviation = np.full(apart.shape, np.nan)
    for one in np.unique(change_kind):
        mine = change_kind == one
        if mine.sum() >= MIN_CHANGES_OF_KIND:
            deviation[mine] = np.abs(apart[mine] - np.median(apart[mine], axis=0))
    return None if np.isnan(deviation).all() else deviation


def _by_lines(apart: NDArray[np.float64], floor: NDArray[np.float64], change_kind: Ints, spread_m: float) -> Agreement:
    """Return the reaction time at which places agree on a line on the floor, or on a common distance."""
    every = [np.flatnonzero(change_kind == one) for one in np.unique(change_kind)]
    every = [mine[:: -(-len(mine) // _MAX_CHANGES_FOR_LINES)] for mine in every if len(mine) > 2 * _NEIGHBOURS]
    if sum(len(mine) for mine in every) < MIN_CHANGES:
        return Agreement(None, None, None, None, spread_m)
    deviation = [
        np.minimum(_deviation_from_lines(floor[mine]), _deviation_from_common_distance(apart[mine])) for mine in every
    ]
    spreads = np.concatenate(deviation)
    usual_m = float(np.median(np.median(spreads[:, : _LATEST + 1], axis=0)))
    found = _agreement(spreads, np.concatenate([change_kind[mine] for mine in every]), min(AGREE_M, _SHARPER * usual_m))
    if found.latency_s is None or found.spread_m > _SHARPER * usual_m:
        return Agreement(None, None, None, None, min(spread_m, found.spread_m))
    return found


def _deviation_from_lines(floor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the deviation of places (N, L, 2) from the line through their neighbours, shape (N, L), m."""
    deviation = np.empty(floor.shape[:2])
    for number in range(floor.shape[1]):
        at = floor[:, number]
        away = ((at[:, None] - at[None]) ** 2).sum(axis=2)
        around = at[np.argpartition(away, _NEIGHBOURS, axis=1)[:, : _NEIGHBOURS + 1]]
        around = around - around.mean(axis=1, keepdims=True)
        deviation[:, number] = np.linalg.svd(around, compute_uv=False)[:, 1] / np.sqrt(_NEIGHBOURS)
    return deviation


def _deviation_from_common_distance(apart: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the deviation of distances (N, L) from the most common one, shape (N, L), m."""
    ordered = np.sort(apart, axis=0)
    count = max(2, int(_COMMON_SHARE * len(apart)))
    width = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    first = width.argmin(axis=0)
    middle = ordered[first + count // 2, np.arange(apart.shape[1])]
    return np.asarray(np.abs(apart - middle))


def _hysteresis_m(apart: Vector, change_kind: Ints) -> float | None:
    """Return the hysteresis: distance at which the robot speeds up minus distance at which it slows, m."""
    differences = [
        float(np.median(apart[change_kind == 2 * step + 1]) - np.median(apart[change_kind == 2 * step]))
        for step in np.unique(change_kind // 2).tolist()
        if (change_kind == 2 * step).sum() >= MIN_CHANGES_OF_KIND
        and (change_kind == 2 * step + 1).sum() >= MIN_CHANGES_OF_KIND
    ]
    if not differences:
        return None
    return float(np.median(differences)) if np.median(differences) >= MIN_HYSTERESIS_M else 0.0
