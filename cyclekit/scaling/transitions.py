"""Split a scaling into held levels and the transitions between them, rising or falling.

A safety system commands a level, and the ramps limit how fast the scaling gets there. So a transition between two
levels is no level, however long it takes; where it turns, the command changed before the level was reached.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.scaling.levels.plateaus import noise_of
from cyclekit.segmentation.motion import median

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Vector


ON_LEVEL = 0.01
"""Minimum tolerance for a scaling to be on a level."""
HELD_S = 0.05
"""Minimum time of a held level, s, in addition to the time a ramp takes to pass it."""
_SIGMAS = 4.0
_TURN = 0.015
"""Minimum reversal of the scaling for a turning point."""
_CLOSE_S = 0.5
"""Maximum time between changes of value, s, on a ramp (or in noise)."""
_FEW_ROWS = 20
"""Minimum number of such changes to recognise a log that repeats its values."""


class HeldLevel(NamedTuple):
    """A level held from row `first` to row `last`, inclusive."""

    level: int
    first: int
    last: int


class Transition(NamedTuple):
    """Transition: a rise or fall of the scaling.

    Attributes:
        rises: Whether the scaling rises.
        before, after: Levels held just before and after it; None: it starts or ends off a level.
        first, last: Its rows between them, inclusive; no rows (`last` < `first`) if the scaling jumps.
    """

    rises: bool
    before: int | None
    after: int | None
    first: int
    last: int


class RampRates(NamedTuple):
    """Fastest fall and rise of the scaling, 1/s; None: it jumps, or the rate is unknown."""

    down_per_s: float | None = None
    up_per_s: float | None = None

    def of(self, *, rises: bool) -> float | None:
        """Return the rate in one direction."""
        return self.up_per_s if rises else self.down_per_s


def repeats(t_s: Vector, scaling: Vector) -> int:
    """Return the number of rows for which the log repeats each value; 1: it does not.

    Args:
        t_s: Time, shape (T,), s.
        scaling: Shape (T,), NaN = unknown.
    """
    new = np.flatnonzero(np.diff(scaling) != 0) + 1
    new = new[np.isfinite(scaling[new]) & np.isfinite(scaling[new - 1])]
    rows = np.diff(new)
    rows = rows[np.diff(t_s[new]) < _CLOSE_S]
    return int(np.quantile(rows, 0.05)) if len(rows) >= _FEW_ROWS and np.quantile(rows, 0.05) >= 3 else 1


def fresh(scaling: Vector, every: int) -> NDArray[np.int64]:
    """Return the rows with new values in a log that writes each value `every` times.

    Args:
        scaling: Shape (T,).
        every: From `repeats`.
    """
    rows = np.arange(len(scaling))
    new = np.concatenate([[True], scaling[1:] != scaling[:-1]])
    since = rows - np.maximum.accumulate(np.where(new, rows, 0))
    return np.flatnonzero(since % every == 0)


def tolerance_of(scaling: Vector, levels: Vector) -> float:
    """Return the tolerance, from noise and the distance between levels, for a scaling to be on a level."""
    known = scaling[np.isfinite(scaling)]
    apart = float(np.diff(levels).min(initial=1.0))
    return min(max(ON_LEVEL, _SIGMAS * noise_of(known)), apart / 4) + 1e-9


def held_levels(
    t_s: Vector, scaling: Vector, levels: Vector, near: float, rates: RampRates, held_s: float = HELD_S
) -> list[HeldLevel]:
    """Return where the levels are held.

    Args:
        t_s: Time, shape (T,), s.
        scaling: Shape (T,), NaN = unknown.
        levels: Shape (P,), ascending.
        near: Tolerance for a scaling to be on a level.
        rates: Ramp rates, which give the time a ramp needs to pass a level.
        held_s: Minimum time of a held level in addition to that, s.
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
    for row in np.flatnonzero((label[first] >= 0) & (t_s[last] - t_s[first] >= least_s)).tolist():
        a, b = int(first[row]), int(last[row])
        ends = a == 0 or b == len(label) - 1 or np.isnan(scaling[a - 1]) or np.isnan(scaling[b + 1])
        passes = _is_on_ramp(t_s[a : b + 1], scaling[a : b + 1], rates) if ends else _passes(scaling, a, b, near)
        if not passes:
            found.append(HeldLevel(int(label[a]), a, b))
    return found


def _is_on_ramp(t_s: Vector, scaling: Vector, rates: RampRates) -> bool:
    """Return whether rows near a level, at an end of the known scaling, are on a ramp: at least half as steep."""
    if len(t_s) < 2:
        return False
    centred_s = t_s - t_s.mean()
    slope = float(centred_s @ (scaling - scaling.mean()) / (centred_s @ centred_s))
    rate = rates.of(rises=slope > 0)
    return rate is not None and abs(slope) > rate / 2


def _passes(scaling: Vector, first: int, last: int, near: float) -> bool:
    """Return whether rows near a level only pass it: the scaling changes there in the direction of the transition."""
    quarter = max(1, (last - first + 1) // 4)
    change = median(scaling[last + 1 - quarter : last + 1]) - median(scaling[first : first + quarter])
    through = float(scaling[last + 1] - scaling[first - 1])
    return abs(change) > near and change * through > 0


def transitions_of(scaling: Vector, holds: Sequence[HeldLevel], near: float) -> list[Transition]:
    """Return the transitions before, between and after held levels, in order of time.

    Args:
        scaling: Shape (T,), NaN = unknown; no transition extends across it.
        holds: From `held_levels`.
        near: As in `held_levels`.
    """
    around = [HeldLevel(-1, -1, -1), *holds, HeldLevel(-1, len(scaling), len(scaling))]
    return [ramp for one, other in pairwise(around) for ramp in _between(scaling, one, other, max(_TURN, 1.5 * near))]


def _between(scaling: Vector, one: HeldLevel, other: HeldLevel, turn: float) -> Iterator[Transition]:
    first, end = one.last + 1, other.first
    if first == end:
        if one.level not in {-1, other.level} and other.level >= 0:
            yield Transition(other.level > one.level, one.level, other.level, first, end - 1)
        return
    rows = np.flatnonzero(np.isfinite(scaling[first:end])) + first
    for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if not len(part):
            continue
        before = one.level if part[0] == first and one.level >= 0 else None
        after = other.level if part[-1] == end - 1 and other.level >= 0 else None
        yield from _split_at_turns(scaling, int(part[0]), int(part[-1]), before, after, turn)


def _split_at_turns(
    scaling: Vector, first: int, last: int, before: int | None, after: int | None, turn: float
) -> Iterator[Transition]:
    """Split rows without a held level at the turning points of the scaling."""
    ends = (max(first - (before is not None), 0), last + (after is not None))
    cuts = _turns(scaling[ends[0] : ends[1] + 1], turn)
    cuts = [cut + ends[0] for cut in cuts]
    edges = [ends[0], *cuts, ends[1]]
    for number, (a, b) in enumerate(pairwise(edges)):
        change = float(scaling[b] - scaling[a])
        is_first, is_last = number == 0, number == len(edges) - 2
        if abs(change) <= turn and not (is_first and is_last and None not in {before, after} and before != after):
            continue
        yield Transition(
            change > 0, before if is_first else None, after if is_last else None,
            max(a, first), min(b, last) if is_last else b - 1,
        )  # fmt: skip


def _turns(values: Vector, turn: float) -> list[int]:
    """Return the rows of the turning points: reversals by more than `turn`."""
    if min(_largest_fall(values), _largest_fall(-values)) <= turn:
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


def _largest_fall(values: Vector) -> float:
    """Return the maximum fall from a previous maximum."""
    return float((np.maximum.accumulate(values) - values).max(initial=0.0))


def begin_of(ramp: Transition, t_s: Vector, scaling: Vector, levels: Vector, rate: float | None) -> float:
    """Return the start of a transition, s: where its ramp leaves the level, else halfway between two rows.

    Args:
        ramp: One of `transitions_of`.
        t_s: Time, shape (T,), s.
        scaling: Shape (T,).
        levels: Shape (P,), ascending.
        rate: Change of the scaling per second; None: it jumps.
    """
    left_s = float(t_s[max(ramp.first - 1, 0)])
    if ramp.before is None:
        return left_s
    if ramp.last < ramp.first or rate is None:
        reached_s = float(t_s[min(ramp.first, len(t_s) - 1)])
        step = 0.0 if rate is None or ramp.after is None else abs(levels[ramp.after] - levels[ramp.before]) / rate
        return 0.5 * (left_s + max(left_s, reached_s - step))
    rows = slice(ramp.first, ramp.last + 1)
    gone = np.abs(scaling[rows] - levels[ramp.before])
    next_one = ramp.before + (1 if ramp.rises else -1)  # the command may have paused at this level
    step = abs(levels[next_one] - levels[ramp.before]) if 0 <= next_one < len(levels) else 0.0  # beyond all levels
    soon = gone < max(step - ON_LEVEL, float(gone[0]) + 1e-9)
    return float(np.median(t_s[rows][soon] - gone[soon] / rate))
