"""A scaling as what it is made of: levels that are held, and the ways between them, rising or falling.

A safety system heads for a level; ramps decide how soon the scaling gets there. So a way between two levels is no
level, however long it takes, and where it turns the safety system has changed its mind before a level was reached.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.scaling.levels.plateaus import noise_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Vector


ON_LEVEL = 0.01
"""A scaling so near to a level is on it, even without noise."""
HELD_S = 0.05
"""A level holds if it lasts this much longer than a ramp takes to pass it."""
_SIGMAS = 4.0
_TURN = 0.015
"""A scaling that rises must fall by more than this to have turned."""
_CLOSE_S = 0.5
"""Values that change again within this time are on a ramp (or noisy)."""
_FEW_ROWS = 20
"""Fewer such changes do not tell a log that repeats its values."""


class Hold(NamedTuple):
    """A level held from row `first` to row `last`, inclusive."""

    level: int
    first: int
    last: int


class Way(NamedTuple):
    """A rise or fall of the scaling.

    Attributes:
        rises: The scaling rises.
        before, after: The levels held just before and after it; None: it begins or ends elsewhere.
        first, last: Its rows between them, inclusive; no rows (`last` < `first`) where the scaling jumps.
    """

    rises: bool
    before: int | None
    after: int | None
    first: int
    last: int


class RampRates(NamedTuple):
    """Fastest fall and rise of the scaling per second; None: it jumps, or is not known."""

    down_per_s: float | None = None
    up_per_s: float | None = None

    def of(self, *, rises: bool) -> float | None:
        """Return that of one direction."""
        return self.up_per_s if rises else self.down_per_s


def repeats(t_s: Vector, scaling: Vector) -> int:
    """Return of how many rows each has the same value because the log repeats it; 1: it does not.

    Args:
        t_s: Time, shape (T,), seconds.
        scaling: Shape (T,), NaN = unknown.
    """
    new = np.flatnonzero(np.diff(scaling) != 0) + 1
    new = new[np.isfinite(scaling[new]) & np.isfinite(scaling[new - 1])]
    rows = np.diff(new)
    rows = rows[np.diff(t_s[new]) < _CLOSE_S]
    return int(np.quantile(rows, 0.05)) if len(rows) >= _FEW_ROWS and np.quantile(rows, 0.05) >= 3 else 1


def fresh(scaling: Vector, every: int) -> NDArray[np.int64]:
    """Return the rows whose values are new, of a log that writes each value `every` times.

    Args:
        scaling: Shape (T,).
        every: From `repeats`.
    """
    rows = np.arange(len(scaling))
    new = np.concatenate([[True], scaling[1:] != scaling[:-1]])
    since = rows - np.maximum.accumulate(np.where(new, rows, 0))
    return np.flatnonzero(since % every == 0)


def tolerance_of(scaling: Vector, levels: Vector) -> float:
    """Return how far from a level noise may carry a scaling that is on it."""
    known = scaling[np.isfinite(scaling)]
    apart = float(np.diff(levels).min(initial=1.0))
    return min(max(ON_LEVEL, _SIGMAS * noise_of(known)), apart / 4) + 1e-9


def holds_of(
    t_s: Vector, scaling: Vector, levels: Vector, near: float, rates: RampRates, held_s: float = HELD_S
) -> list[Hold]:
    """Return where the levels are held.

    Args:
        t_s: Time, shape (T,), seconds.
        scaling: Shape (T,), NaN = unknown.
        levels: Shape (P,), ascending.
        near: A scaling so near to a level is on it.
        rates: A ramp is on the levels that it passes or turns at for so long.
        held_s: A level holds if it lasts so much longer than that.
    """
    nearest = np.searchsorted((levels[1:] + levels[:-1]) / 2, scaling).clip(max=len(levels) - 1)
    label = np.where(np.abs(scaling - levels[nearest]) <= near, nearest, -1)
    stray = (label == -1) & np.isfinite(scaling) & (np.roll(label, 1) == np.roll(label, -1))
    stray[[0, -1]] = False
    label = np.where(stray, np.roll(label, 1), label)  # one noisy row
    edges = np.concatenate([[0], np.flatnonzero(np.diff(label)) + 1, [len(label)]])
    first, last = edges[:-1], edges[1:] - 1
    least_s = held_s + sum(near / rate for rate in rates if rate)
    found = []
    for row in np.flatnonzero((label[first] >= 0) & (t_s[last] - t_s[first] >= held_s)).tolist():
        a, b = int(first[row]), int(last[row])
        ends = a == 0 or b == len(label) - 1 or np.isnan(scaling[a - 1]) or np.isnan(scaling[b + 1])
        passes = _slopes(t_s[a : b + 1], scaling[a : b + 1], rates) if ends else _passes(scaling, a, b, near)
        if t_s[b] - t_s[a] >= least_s and not passes:
            found.append(Hold(int(label[a]), a, b))
    return found


def _slopes(t_s: Vector, scaling: Vector, rates: RampRates) -> bool:
    """Tell whether rows near a level, at an end of what is known, are the end of a ramp: as steep as half of one."""
    if len(t_s) < 2:
        return False
    way = t_s - t_s.mean()
    slope = float(way @ (scaling - scaling.mean()) / (way @ way))
    rate = rates.of(rises=slope > 0)
    return rate is not None and abs(slope) > rate / 2


def _passes(scaling: Vector, first: int, last: int, near: float) -> bool:
    """Tell whether rows near a level only pass it: in between two others, and no flatter than the way."""
    quarter = max(1, (last - first + 1) // 4)
    change = float(np.median(scaling[last + 1 - quarter : last + 1]) - np.median(scaling[first : first + quarter]))
    through = float(scaling[last + 1] - scaling[first - 1])
    return abs(change) > near and change * through > 0


def ways_of(scaling: Vector, holds: Sequence[Hold], near: float) -> list[Way]:
    """Return the ways before, between and after levels that are held, in the order of time.

    Args:
        scaling: Shape (T,), NaN = unknown; no way leads past that.
        holds: From `holds_of`.
        near: As there.
    """
    around = [Hold(-1, -1, -1), *holds, Hold(-1, len(scaling), len(scaling))]
    return [way for one, other in pairwise(around) for way in _between(scaling, one, other, max(_TURN, 1.5 * near))]


def _between(scaling: Vector, one: Hold, other: Hold, turn: float) -> Iterator[Way]:
    first, end = one.last + 1, other.first
    if first == end:
        if one.level not in {-1, other.level} and other.level >= 0:
            yield Way(other.level > one.level, one.level, other.level, first, end - 1)
        return
    rows = np.flatnonzero(np.isfinite(scaling[first:end])) + first
    for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if not len(part):
            continue
        before = one.level if part[0] == first and one.level >= 0 else None
        after = other.level if part[-1] == end - 1 and other.level >= 0 else None
        yield from _one_way(scaling, int(part[0]), int(part[-1]), before, after, turn)


def _one_way(
    scaling: Vector, first: int, last: int, before: int | None, after: int | None, turn: float
) -> Iterator[Way]:
    """Divide rows without a held level where the scaling turns."""
    ends = (max(first - (before is not None), 0), last + (after is not None))
    cuts = _turns(scaling[ends[0] : ends[1] + 1], turn)
    cuts = [cut + ends[0] for cut in cuts]
    edges = [ends[0], *cuts, ends[1]]
    for number, (a, b) in enumerate(pairwise(edges)):
        change = float(scaling[b] - scaling[a])
        is_first, is_last = number == 0, number == len(edges) - 2
        if abs(change) <= turn and not (is_first and is_last and None not in {before, after} and before != after):
            continue
        yield Way(
            change > 0, before if is_first else None, after if is_last else None,
            max(a, first), min(b, last) if is_last else b - 1,
        )  # fmt: skip


def _turns(values: Vector, turn: float) -> list[int]:
    """Return at which rows values that rise begin to fall, or those that fall to rise, by more than `turn`."""
    if min(_back(values), _back(-values)) <= turn:
        return []
    found: list[int] = []
    low = high = 0
    rises: bool | None = None
    for row, value in enumerate(values.tolist()):
        if value > values[high]:
            high = row
        if value < values[low]:
            low = row
        if rises is not False and values[high] - value > turn:
            found += [high] if rises else ([high] if high else [])
            rises, low, high = False, row, row
        elif rises is not True and value - values[low] > turn:
            found += [low] if rises is False else ([low] if low else [])
            rises, low, high = True, row, row
    return found


def _back(values: Vector) -> float:
    """Return by how much values that should rise fall."""
    return float((np.maximum.accumulate(values) - values).max(initial=0.0))


def begin_of(way: Way, t_s: Vector, scaling: Vector, levels: Vector, rate: float | None) -> float:
    """Return when a way begins, seconds: where its ramp leaves the level, else half way between two rows.

    Args:
        way: One of `ways_of`.
        t_s: Time, shape (T,), seconds.
        scaling: Shape (T,).
        levels: Shape (P,), ascending.
        rate: Change of the scaling per second; None: it jumps.
    """
    left_s = float(t_s[max(way.first - 1, 0)])
    if way.before is None:
        return left_s
    if way.last < way.first or rate is None:
        reached_s = float(t_s[min(way.first, len(t_s) - 1)])
        step = 0.0 if rate is None or way.after is None else abs(levels[way.after] - levels[way.before]) / rate
        return 0.5 * (left_s + max(left_s, reached_s - step))
    rows = slice(way.first, way.last + 1)
    gone = np.abs(scaling[rows] - levels[way.before])
    next_one = way.before + (1 if way.rises else -1)  # where the command may have paused
    soon = gone < max(abs(levels[next_one] - levels[way.before]) - ON_LEVEL, float(gone[0]) + 1e-9)
    return float(np.median(t_s[rows][soon] - gone[soon] / rate))
