"""The lag between two logs at which what one of them shows explains the other best: no frame, distance or identity.

The state of one log is a label at each instant: the cell of the floor where somebody is, or the states of a PLC's
signals. At the true lag the label tells the robot's level of speed, motion and signals; at any other it tells next to
nothing. The measure is the likelihood of the levels, each predicted by the mean of all others with the same label.
Every other lag shows what chance and repetition can do: a lag is certain only if it beats them all, stretch by stretch.
`response_lag` refines a lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import fft
from scipy.special import stdtrit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Ints, Vector

CELL_M = 0.35
"""Width of a cell of the floor, m: a step. Half and twice of it find the same lags in ten simulated pairs of 5 to
28 min; half leaves one of them unsure."""
STEP_S = 0.5
"""Time between instants, s: a person crosses a cell in it. Half and twice of it and of the three counts and times below
find the same lags in ten simulated pairs of 8 to 18 min, all certain, and none in eight pairs of different days."""
CHANCE = 0.01
"""Level of the test of a lag against each other peak. Of 52 simulated pairs (2.5 to 28 min) half of it leaves 2 more
unsure, and twice of it 2 or 3 fewer; of 40 pairs of different days none is certain at any of these."""
STRETCHES, STRETCH_S = 20, 10.0
"""Number of stretches that a lag is tested on, and their minimum length, s: longer than somebody stays in a cell."""
MIN_S = 60.0
"""Minimum time that both logs cover at a lag, s."""
NEAR_S = 1.0
"""Lags that clocks as they are may have, s: a reaction time and a step. Half and twice of it contradict 44 and 43 of
143 wrong clocks of cyclic cells, this 44 (4 of them are not certain otherwise), and none of 286 right or unrelated."""
RIVALS = 10
"""Number of other peaks that a lag is tested against, the highest ones."""
LEAST = 1e-3
"""Minimum unexplained share: signals that agree exactly would have an infinite likelihood."""
_AT_ONCE = 1 << 23
"""Maximum number of values in one block of transforms: it stays in memory."""
_LAGS = 1 << 14
"""Minimum number of lags in a block: a limit of memory. Half and twice of it find the same 18 lags in traces of twelve
days beside logs of 15 min, in 0.8 and 1.3 times the time."""


class Instants(NamedTuple):
    """One session on a common grid of instants, in the clocks that are to be tested.

    Attributes:
        label: State of the log, shape (K, N), a row for each of K people at once, or signals; negative = unknown.
        label_at: Number of its first instant.
        level: Levels of the robot, shape (R, M), a row for each quantity; NaN = unknown.
        level_at: Number of its first instant.
    """

    label: Ints
    label_at: int
    level: Floats
    level_at: int


@dataclass(frozen=True)
class FoundLag:
    """The lag that explains the robot's levels best.

    Attributes:
        lag_s: Time to be added to the log's, s.
        explained: Share of the variance that the log explains there.
        next_best: The same at the best other peak.
        next_s: That peak, s.
        here: The same as the clocks are; None if the logs do not cover enough time together.
        certain: Whether it beats every other peak, stretch by stretch.
        contradicts: Whether it so beats each lag within `NEAR_S` of the clocks as they are, by a test for as many lags
            as were tried: then these are wrong, also where other lags are as good, as in a cell that repeats itself.
    """

    lag_s: float
    explained: float
    next_best: float
    next_s: float
    here: float | None
    certain: bool
    contradicts: bool


def cells_of(xy_m: Floats, cell_m: float = CELL_M, moved: tuple[float, float] = (0.0, 0.0)) -> Ints:
    """Return the number of the floor's cell of each position (..., 2), m, shape (...); -1 = unknown.

    Args:
        xy_m: The positions.
        cell_m: Width of a cell, m.
        moved: By how many widths of a cell the grid is moved.
    """
    cell = np.floor(xy_m / cell_m + np.array(moved))
    seen = np.asarray(np.isfinite(cell).all(axis=-1))
    numbers = np.where(seen[..., None], cell, 0.0).astype(np.int64)
    return np.where(seen, (numbers[..., 0] + 2**20) * 2**21 + numbers[..., 1] + 2**20, -1)


def numbered(labels: Sequence[Ints]) -> list[Ints]:
    """Return labels as numbers from 0, the same in all arrays; negative ones stay."""
    known = np.unique(np.concatenate([np.empty(0, np.int64), *(label.ravel() for label in labels)]))
    known = known[known >= 0]
    return [np.where(label >= 0, np.searchsorted(known, label), -1) for label in labels]


def find_lag(sessions: Sequence[Instants], step_s: float = STEP_S) -> FoundLag | None:
    """Return the best common lag of all sessions, over all lags at which the logs meet; None if there is none.

    Args:
        sessions: The sessions; their labels mean the same.
        step_s: Time between instants, s.
    """
    labels = numbered([one.label for one in sessions])
    sessions = [one._replace(label=label) for one, label in zip(sessions, labels, strict=True) if label.size]
    count = max((int(one.label.max()) + 1 for one in sessions), default=0)
    if count < 2:
        return None
    lags, likelihood, explained = _over_all_lags(sessions, count, round(MIN_S / step_s))
    if not np.isfinite(likelihood).any():
        return None
    best = int(np.argmax(likelihood))
    rivals = _rivals(likelihood, best)
    of_robot = sum(one.level.shape[1] for one in sessions) < sum(one.label.shape[1] for one in sessions)
    mine = stretches(sessions, int(lags[best]), count, step_s, of_robot=of_robot)

    def beats(others: Ints, chance: float) -> bool:
        for other in others.tolist():
            better = mine - stretches(sessions, int(lags[other]), count, step_s, of_robot=of_robot)
            spread = float(better.std(ddof=1)) / np.sqrt(len(better))
            if not better.mean() > stdtrit(len(better) - 1, 1.0 - chance) * spread:
                return False
        return len(others) > 0

    tried = np.isfinite(likelihood)
    some = len(mine) > 1 and bool(likelihood[best] > 0.0)
    near = np.flatnonzero((np.abs(lags) * step_s <= NEAR_S) & tried)
    here = np.flatnonzero((lags == 0) & np.isfinite(likelihood))
    other = int(rivals[0]) if len(rivals) else best
    return FoundLag(
        float(lags[best]) * step_s,
        float(explained[best]),
        float(explained[other]) if len(rivals) else 0.0,
        float(lags[other]) * step_s,
        float(explained[here[0]]) if len(here) else None,
        some and beats(rivals, CHANCE),
        some and best not in near.tolist() and beats(near, CHANCE / int(tried.sum())),
    )


def _over_all_lags(sessions: Sequence[Instants], count: int, least: int) -> tuple[Ints, Vector, Vector]:
    """Return all lags, the log likelihood at each (-inf: nothing to compare), and the explained share.

    A trace of weeks beside logs of minutes is taken block by block; a block in which no label changes tells nothing.
    """
    low = min(one.level_at - one.label_at - one.label.shape[1] + 1 for one in sessions)
    high = max(one.level_at - one.label_at + one.level.shape[1] - 1 for one in sessions)
    block = max(_LAGS, 2 * max(one.level.shape[1] for one in sessions))
    if high - low < block:
        return _over_lags(sessions, count, least)
    lags = np.arange(low, high + 1)
    likelihood, explained = np.full(len(lags), -np.inf), np.zeros(len(lags))
    for first in range(low, high + 1, block):
        last = min(first + block - 1, high)
        some = [part for one in sessions if (part := _meeting(one, first, last)).label.size]
        if all((part.label == part.label[:, :1]).all() for part in some):
            continue
        mine, its_likelihood, its_explained = _over_lags(some, count, least)
        inside = (mine >= first) & (mine <= last)
        likelihood[mine[inside] - low], explained[mine[inside] - low] = its_likelihood[inside], its_explained[inside]
    return lags, likelihood, explained


def _meeting(one: Instants, first: int, last: int) -> Instants:
    """Return a session with the labels alone that meet its levels at lags from `first` to `last`."""
    begin = max(one.level_at - last - one.label_at, 0)
    end = max(one.level_at + one.level.shape[1] - first - one.label_at, begin)
    return one._replace(label=one.label[:, begin:end], label_at=one.label_at + begin)


def _over_lags(sessions: Sequence[Instants], count: int, least: int) -> tuple[Ints, Vector, Vector]:
    """Return all lags, the log likelihood at each (-inf: too short), and the explained share, by Fourier transforms."""
    apart = [one.level_at - one.label_at for one in sessions]
    low = min(by - one.label.shape[1] + 1 for by, one in zip(apart, sessions, strict=True))
    high = max(by + one.level.shape[1] - 1 for by, one in zip(apart, sessions, strict=True))
    size = fft.next_fast_len(high - low + 1, real=True)
    lags = np.arange(low, high + 1)
    likelihood, unexplained, all_variance = (np.zeros(len(lags)) for _ in range(3))
    covered = np.zeros(len(lags), bool)
    for row in range(sessions[0].level.shape[0]):
        level = [one.level[row] for one in sessions]
        known = np.concatenate([values[np.isfinite(values)] for values in level])
        if len(known) == 0 or not (scale := float(known.std())) > 0.0:
            continue
        spectra = [_spectra((values - known.mean()) / scale, by, size) for values, by in zip(level, apart, strict=True)]
        rest, total, squares, rows = (np.zeros(size, np.float32) for _ in range(4))
        for first in range(0, count, block := max(1, _AT_ONCE // size)):
            some = range(first, min(first + block, count))
            n, s, q = (np.zeros((len(some), size), np.float32) for _ in range(3))
            for one, mine in zip(sessions, spectra, strict=True):
                is_it = np.zeros((len(some), one.label.shape[1]), np.float32)
                for slot in one.label:
                    at = np.flatnonzero((slot >= some.start) & (slot < some.stop))
                    np.add.at(is_it, (slot[at] - some.start, at), 1.0)
                shape = np.conj(fft.rfft(is_it, size, axis=1))
                n, s, q = (
                    known + fft.irfft(shape * of, size, axis=1) for known, of in zip((n, s, q), mine, strict=True)
                )
            n = np.round(n)
            within = np.maximum(q - s * s / np.maximum(n, 1.0), 0.0) * (n / np.maximum(n - 1.0, 1.0)) ** 2
            rest += np.where(n > 1.5, within, q).sum(axis=0)
            total, squares, rows = total + s.sum(axis=0), squares + q.sum(axis=0), rows + n.sum(axis=0)
        variance = np.maximum(squares - total * total / np.maximum(rows, 1.0), 0.0)
        enough = (rows >= least) & (variance > LEAST * rows)
        ratio = np.clip(rest / np.where(enough, variance, 1.0), LEAST, None)
        gain = np.where(enough, -0.5 * rows * np.log(ratio), 0.0)
        likelihood += gain[lags % size]
        unexplained += np.where(enough, rest, 0.0)[lags % size]
        all_variance += np.where(enough, variance, 0.0)[lags % size]
        covered |= enough[lags % size]
    return lags, np.where(covered, likelihood, -np.inf), 1.0 - unexplained / np.where(covered, all_variance, 1.0)


def _spectra(level: Vector, by: int, size: int) -> list[Floats]:
    """Return the transforms of "known", the level and its square, `by` instants later."""
    known = np.isfinite(level)
    value = np.where(known, level, 0.0)
    rows = (np.arange(len(level)) + by) % size
    found = []
    for values in (known.astype(float), value, value * value):
        padded = np.zeros(size, np.float32)
        padded[rows] = values
        found.append(fft.rfft(padded))
    return found


def _rivals(likelihood: Vector, best: int) -> Ints:
    """Return the highest other peaks: those beyond where the likelihood has fallen to half of the best one's."""
    low = ~(likelihood > 0.5 * likelihood[best])
    before, after = np.flatnonzero(low[: best + 1]), np.flatnonzero(low[best:])
    rest = likelihood.copy()
    rest[int(before[-1]) + 1 if len(before) else 0 : best + int(after[0]) if len(after) else len(rest)] = -np.inf
    padded = np.concatenate([[-np.inf], rest, [-np.inf]])
    peaks = np.flatnonzero((rest > -np.inf) & (rest >= padded[:-2]) & (rest > padded[2:]))
    return np.asarray(peaks[np.argsort(-rest[peaks], kind="stable")][:RIVALS])


def stretches(sessions: Sequence[Instants], lag: int, count: int, step_s: float, *, of_robot: bool = False) -> Vector:
    """Return the log likelihood of each of some stretches at a lag, shape (S,), with `count` labels.

    They are those of the log, or of the robot's where that is shorter: of a trace of weeks it would lie in one stretch.
    """
    gain = [np.zeros((one.level if of_robot else one.label).shape[1]) for one in sessions]
    for row in range(sessions[0].level.shape[0]):
        pairs = [_met(one, row, lag) for one in sessions]
        label, level = (np.concatenate([pair[part] for pair in pairs]) for part in (1, 2))
        if len(level) < 2 or not (variance := float(level.var())) > 0.0:
            continue
        n, s = np.bincount(label, minlength=count), np.bincount(label, level, count)
        alone = n[label] < 2
        others = np.where(alone, level.mean(), (s[label] - level) / np.maximum(n[label] - 1, 1))
        left = (level - others) ** 2
        rest = max(float(left.mean()), LEAST * variance)
        value = 0.5 * ((level - level.mean()) ** 2 / variance - left / rest + np.log(variance / rest))
        ends = np.cumsum([len(pair[0]) for pair in pairs])[:-1]
        for one, mine, pair, values in zip(sessions, gain, pairs, np.split(value, ends), strict=True):
            np.add.at(mine, pair[0] + (one.label_at + lag - one.level_at if of_robot else 0), values)
    every = np.concatenate(gain)
    stretches = min(STRETCHES, int(len(every) * step_s / STRETCH_S))
    return np.array([part.sum() for part in np.array_split(every, stretches)]) if stretches else np.empty(0)


def _met(one: Instants, row: int, lag: int) -> tuple[Ints, Ints, Vector]:
    """Return instant of the log, label and level wherever both are known at a lag, shape (N,) each."""
    part = _meeting(one, lag, lag)
    slot, at = np.nonzero(part.label >= 0)
    at = at + part.label_at - one.label_at
    level = one.level[row][at + one.label_at + lag - one.level_at]
    known = np.isfinite(level)
    return at[known], one.label[slot[known], at[known]], level[known]
