"""A lag refined to less than 0.1 s, with its drift: the instants at which the robot's level begins to answer people.

The level follows what is asked for through a filter: it falls and rises at limited rates. While it rises, more is asked
for than it has reached; while it falls, less; otherwise just that. So each instant bounds the level asked for, and the
bounds of the other windows give its distribution at each place (the estimate of Turnbull, JRSS B 38, 1976, for interval
censored data). A lag is judged where a move begins: just before a fall at least the level so far is asked for, just
after it less, and the reverse for a rise. How long a ramp lasts then does not matter. A constant reaction time cannot
be told from the clock: it stays part of the lag.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import stdtrit

from cyclekit.alignment.clocks.explained import CHANCE, STEP_S, stretches

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.alignment.clocks.explained import Instants
    from cyclekit.schema import Floats, Ints, Vector

FINE_CELL_M = 0.25
"""Width of a cell of the floor, m. The largest error of 14 simulated pairs is 0.05 s, with 0.18 m as well, and 0.07 s
with 0.35 m."""
FINE_S = 0.05
"""Step of the search, s, which a parabola refines. In six walks of 15 min, sharp and with slow ramps, the largest error
is 0.025 s with a bound of 0.07 s; half and twice give 0.021 and 0.035 s with bounds of 0.04 and 0.14 s."""
COARSE_S, AROUND_S = 0.25, 3.0
"""Step of the first search, s, and its reach around the found lag, which a slow recovery moves by up to 2 s. The second
search reaches one step around the best lag of the first. Half and twice of the step, with a reach of 0.5 s, find the
same lags in these walks; a reach of two or four steps the same to 0.001 s, of two to 0.006 s with a drift of 0.9 s."""
NEAR_S = 1.0
"""Maximum time before and after the begin of a move that is compared, s: somebody crosses a cell in less. Half of it
gives the same largest error in six pairs with slow ramps."""
WINDOWS, WINDOW_S, FOLDS = 20, 180.0, 5
"""Number of windows of the log that are compared, and their maximum length, s: an hour tells enough. Each is predicted
by those of the other folds. Half and twice of the number give largest errors of 0.028 and 0.022 s in these walks."""
STATES, PERCENT = 21, 0.01
"""Maximum number of levels that are told apart, and the resolution of a level: overrides are logged in percent.
Half and twice of each find the same lags in these walks of two to five levels."""
STEPS, SPREAD = 8, 2.0
"""Steps of the estimate at each place, and the weight of what is known without the robot's place, in instants.
Half and twice of each move the lags of these walks by at most 0.002 s."""
LEAST = 0.01
"""Minimum probability of what is compared: nothing is impossible."""
MAX_DRIFT = 200e-6
"""Maximum drift between two clocks that is searched; quartz is good to 100e-6."""


class PlacesAndLevel(NamedTuple):
    """One session on a grid of FINE_S, in the clocks as they are.

    Attributes:
        people: Cell of each of K people, shape (K, N); negative = unknown. `nobody` counts as a cell.
        people_at: Number of its first instant.
        robot: Cell of the TCP, shape (M,).
        level: Level of the robot, shape (M,); NaN = unknown.
        robot_at: Number of its first instant.
    """

    people: Ints
    people_at: int
    robot: Ints
    level: Vector
    robot_at: int


class RefinedLag(NamedTuple):
    """A lag as a line: added to a log's time t it is lag_s + drift * (t - about_s); residual_s: its standard error."""

    lag_s: float
    drift: float
    about_s: float
    residual_s: float

    @property
    def bound_s(self) -> float:
        """Maximum error of the lag, s, at the level CHANCE."""
        return float(stdtrit(WINDOWS - 1, 1.0 - CHANCE / 2.0)) * self.residual_s


def refine_lag(grids: Sequence[Sequence[PlacesAndLevel]], lag_s: float) -> RefinedLag | None:
    """Return the refined lag near `lag_s`; None if the level never changes where the logs meet.

    Args:
        grids: The same sessions with each of some grids of cells: where a threshold lies in a cell is not known, and
            the mean over moved grids hardly depends on it (Scott, Annals of Statistics 13, 1985).
        lag_s: The lag so far.
    """
    windows = list(_windows(grids[0], _lags(lag_s, AROUND_S + COARSE_S, FINE_S)))
    if not windows:
        return None
    moves = _moves([grids[0][number].level[rows - grids[0][number].robot_at] for number, rows in windows])
    if moves.told < 2 or not len(moves.row):
        return None
    coarse = _lags(lag_s, AROUND_S, COARSE_S)
    about = coarse[_misfits(grids[:1], windows, moves, coarse).sum(axis=0).argmin()]
    lags = _lags(float(about) * FINE_S, COARSE_S, FINE_S)
    wrong = _misfits(grids, windows, moves, lags)
    return _line(wrong, lags, np.array([(rows[0] + rows[-1]) / 2.0 for _, rows in windows]) * FINE_S)


def refine_states(sessions: Sequence[Instants], lag_s: float) -> RefinedLag | None:
    """Return the refined lag near `lag_s` of states that the robot's levels answer at once, on a grid of FINE_S."""
    most = round(WINDOWS * WINDOW_S / FINE_S) // len(sessions)
    cuts = [max(one.label.shape[1] - most, 0) // 2 for one in sessions]  # the middle
    sessions = [
        one._replace(label=one.label[:, cut : cut + most], label_at=one.label_at + cut)
        for one, cut in zip(sessions, cuts, strict=True)
    ]
    count = 1 + max(int(one.label.max()) for one in sessions)
    lags = _lags(lag_s, STEP_S + COARSE_S, FINE_S)
    wrong = -np.array([stretches(sessions, lag, count, FINE_S) for lag in lags.tolist()]).T
    at = np.concatenate([one.label_at + np.arange(one.label.shape[1]) for one in sessions])
    return _line(wrong, lags, np.array([part.mean() for part in np.array_split(at, len(wrong))]) * FINE_S)


def _line(wrong: Floats, lags: Ints, at_s: Vector) -> RefinedLag:
    """Return the line of lags at which the misfits (B, L) of some parts of a log, around times (B,), are least."""
    about_s = float(at_s.mean())
    drifts = np.linspace(-MAX_DRIFT, MAX_DRIFT, 41)
    still = _along(wrong, np.zeros(len(at_s)))
    moved = [_along(wrong, drift * (at_s - about_s) / FINE_S) for drift in drifts]
    best = int(np.argmin([one.sum(axis=0).min() for one in moved]))
    better = still[:, still.sum(axis=0).argmin()] - moved[best][:, moved[best].sum(axis=0).argmin()]
    spread = float(better.std(ddof=1)) / np.sqrt(len(at_s)) if len(at_s) > 1 else np.inf
    drifts_apart = bool(better.mean() > stdtrit(max(len(at_s) - 1, 1), 1.0 - CHANCE) * spread)
    drift, chosen = (float(drifts[best]), moved[best]) if drifts_apart else (0.0, still)
    whole = chosen.sum(axis=0)
    without = np.array([_lowest(whole - one) for one in chosen]) * FINE_S
    error_s = float(np.sqrt((len(at_s) - 1) * without.var())) if len(at_s) > 1 else AROUND_S
    return RefinedLag(float(lags[0]) * FINE_S + _lowest(whole) * FINE_S, drift, about_s, max(error_s, FINE_S / 2))


def _lags(about_s: float, reach_s: float, step_s: float) -> Ints:
    """Return the lags within a reach, in steps of FINE_S."""
    reach, step = round(reach_s / FINE_S), round(step_s / FINE_S)
    return round(about_s / FINE_S) + np.arange(-reach, reach + 1, step)


def _windows(sessions: Sequence[PlacesAndLevel], lags: Ints) -> Iterator[tuple[int, Ints]]:
    """Yield the session and the instants of some windows in which people are logged at all lags."""
    found = []
    count = -(-WINDOWS // len(sessions))
    for number, one in enumerate(sessions):
        first = max(one.robot_at, one.people_at + int(lags[-1]))
        end = min(one.robot_at + len(one.level), one.people_at + one.people.shape[1] + int(lags[0]))
        length = min(round(WINDOW_S / FINE_S), max(end - first, 0) // count)
        if length * FINE_S >= NEAR_S:
            begins = np.linspace(first, end - length, count).astype(int)
            found += [(number, begin + np.arange(length)) for begin in begins.tolist()]
    yield from found[:: max(1, len(found) // WINDOWS)]


class _Moves(NamedTuple):
    """What the instants of all windows bound, and what is compared where moves begin, as numbers of levels.

    Attributes:
        told: Number of levels told apart.
        low, high: Lowest and highest level that may be asked for at each instant, shape (T,).
        row: Instant of each comparison, shape (C,).
        first, last: Levels of which one is asked for there, shape (C,).
    """

    told: int
    low: Ints
    high: Ints
    row: Ints
    first: Ints
    last: Ints


def _moves(levels: Sequence[Vector]) -> _Moves:
    """Return the moves of all windows of levels."""
    steps = [np.nan_to_num(np.diff(level, prepend=level[0])) for level in levels]
    rates = [_rate(np.concatenate([sign * step for step in steps])) for sign in (-1.0, 1.0)]
    ways = [_way(step, *rates) for step in steps]
    still = [level[1:][np.abs(step[1:]) < PERCENT / 2.0] for level, step in zip(levels, steps, strict=True)]
    held = np.unique(np.round(np.concatenate(still) / PERCENT)) * PERCENT
    held = held[np.isfinite(held)] if np.isfinite(held).any() else np.zeros(1)
    states = held[np.unique(np.linspace(0, len(held) - 1, STATES).round().astype(int))]
    most, begin = len(states) - 1, 0
    found = []
    for level, step, way in zip(levels, steps, ways, strict=True):
        near = np.searchsorted((states[1:] + states[:-1]) / 2.0, level)
        above = np.minimum(np.searchsorted(states, level), most)
        below = np.maximum(np.searchsorted(states, level, side="right") - 1, 0)
        known = np.isfinite(level)
        low = np.where(known & (way >= 0), np.where(way > 0, above, near), 0)
        high = np.where(known & (way <= 0), np.where(way < 0, below, near), most)
        turns = np.where(way != 0, way, np.sign(step) * (np.abs(step) > PERCENT / 2.0)).astype(int)
        row, first, last = _compared(low, high, turns, most)
        found.append((low, high, row + begin, first, last))
        begin += len(level)
    return _Moves(len(states), *(np.concatenate(part) for part in zip(*found, strict=True)))


def _rate(steps: Vector) -> float:
    """Return the rate of change, per FINE_S: half of the whole way upwards is gone in steps at least as large."""
    up = np.sort(steps[steps > PERCENT / 2.0])
    way = np.cumsum(up)
    return float(up[np.searchsorted(way, way[-1] / 2.0)]) if len(up) else 1.0


def _way(step: Vector, fall: float, rise: float) -> Ints:
    """Return where the level falls (-1) and rises (1) at its rate, from the smaller step in which that begins."""
    way = np.zeros(len(step), int)
    for sign, rate in ((-1, fall), (1, rise)):
        full = sign * step > rate / 2.0
        way[full | (np.append(full[1:], False) & (sign * step > 0.0))] = sign
    return way


def _compared(low: Ints, high: Ints, turns: Ints, most: int) -> tuple[Ints, Ints, Ints]:
    """Return instants (C,) around each begin of a move, and the first and last of the levels asked for there."""
    begins = np.flatnonzero((turns[1:] != 0) & (turns[1:] != turns[:-1])) + 1
    ends = [0, *begins.tolist(), len(turns)]
    found = [np.empty((3, 0), int)]
    for before, begin, after in zip(ends[:-2], ends[1:-1], ends[2:], strict=True):
        near = min(round(NEAR_S / FINE_S), begin - before, after - begin)
        falls = turns[begin] < 0
        level = int(low[begin - 1]) if falls else int(high[begin - 1]) + 1  # the lowest of those above the threshold
        if 0 < level <= most:
            for rows, above in ((np.arange(begin - near, begin), falls), (np.arange(begin, begin + near), not falls)):
                ends_of = (level, most) if above else (0, level - 1)
                found.append(np.stack([rows, *(np.full(near, end) for end in ends_of)]))
    row, first, last = np.concatenate(found, axis=1)
    return row, first, last


def _misfits(
    grids: Sequence[Sequence[PlacesAndLevel]], windows: Sequence[tuple[int, Ints]], moves: _Moves, lags: Ints
) -> Floats:
    """Return the negative log likelihood of what is asked for where moves begin, shape (W, L)."""
    window = np.repeat(np.arange(len(windows)), [len(rows) for _, rows in windows])
    wrong = np.zeros((len(windows), len(lags)))
    robots = [np.concatenate([grid[s].robot[rows - grid[s].robot_at] for s, rows in windows]) for grid in grids]
    robots = [np.unique(robot, return_inverse=True)[1] for robot in robots]
    for number, lag in enumerate(lags.tolist()):
        chance = np.zeros(len(moves.row))
        for grid, robot in zip(grids, robots, strict=True):
            people = [grid[s].people[:, rows - lag - grid[s].people_at] for s, rows in windows]
            at_least = _at_least(np.concatenate(people, axis=1), robot, window % FOLDS, moves)
            chance += at_least[moves.first, np.arange(len(chance))] - at_least[moves.last + 1, np.arange(len(chance))]
        cost = -np.log(np.maximum(chance / len(grids), LEAST))
        wrong[:, number] = np.bincount(window[moves.row], cost, len(windows))
    return wrong


def _at_least(people: Ints, robot: Ints, fold: Ints, moves: _Moves) -> Floats:
    """Return the chance that at least each of the levels is asked for where moves are compared, shape (told + 1, C).

    It is that of the person who asks for least, known from the other folds.
    """
    count = moves.told
    slot, at = np.nonzero(people >= 0)
    _, place = np.unique(people[slot, at], return_inverse=True)
    cells = int(robot.max()) + 1
    pairs, pair = np.unique(place * cells + robot[at], return_inverse=True)
    number = np.full(people.shape, len(pairs))  # nobody known
    number[slot, at] = pair
    here = number[:, moves.row]
    bounds, bound = np.unique((pair * count + moves.low[at]) * count + moves.high[at], return_inverse=True)
    in_fold = np.bincount(bound * FOLDS + fold[at], minlength=len(bounds) * FOLDS).reshape(-1, FOLDS)
    of_pair, asked = np.divmod(bounds, count**2)
    of_place = _together(pairs[of_pair] // cells * count**2 + asked, in_fold)
    of_all = _together(asked, in_fold)
    found = np.empty((count + 1, len(moves.row)))
    for one in range(FOLDS):
        mine = np.flatnonzero(fold[moves.row] == one)
        used, row = np.unique(np.append(here[:, mine].ravel(), len(pairs)), return_inverse=True)
        pair_row = np.full(len(pairs), -1)  # of the shares; only those of pairs that are compared are needed
        pair_row[used[:-1]] = np.arange(len(used) - 1)
        kept = pair_row[of_pair] >= 0
        anywhere = _shares(*_others(*of_all, one, count), np.full((1, count), 1.0 / count))
        at_place = _shares(*_others(*of_place, one, count), np.repeat(anywhere, int(place.max()) + 1, axis=0))
        key = pair_row[of_pair[kept]] * count**2 + asked[kept]
        at_pair = _shares(*_others(key, in_fold[kept], one, count), at_place[pairs[used[:-1]] // cells])
        shares = np.concatenate([at_pair, anywhere])
        least = np.zeros((len(shares), count + 1))
        least[:, :-1] = np.cumsum(shares[:, ::-1], axis=1)[:, ::-1]
        rows = row[:-1].reshape(len(here), -1)
        somebody = (rows < len(used) - 1) | (rows == len(used) - 1).all(axis=0)
        found[:, mine] = np.where(somebody[..., None], least[rows], 1.0).min(axis=0).T
    return found


def _together(keys: Ints, in_fold: Ints) -> tuple[Ints, Ints]:
    """Return the keys that occur (K,), and how often in each fold, shape (K, FOLDS)."""
    found, number = np.unique(keys, return_inverse=True)
    return found, np.stack([np.bincount(number, times, len(found)) for times in in_fold.T], axis=1)


def _others(keys: Ints, in_fold: Ints, one: int, count: int) -> tuple[Ints, Ints, Ints, Ints]:
    """Return place, lowest and highest level of keys, and how often they occur in the other folds."""
    return keys // count**2, keys // count % count, keys % count, in_fold.sum(axis=1) - in_fold[:, one]


def _shares(place: Ints, low: Ints, high: Ints, times: Ints, before: Floats) -> Floats:
    """Return how often each level is asked for at each place, shape (P, count), from bounds: by expectation steps."""
    places, width = len(before), before.shape[1] + 1
    rows = np.bincount(place, times, places)[:, None]
    begin, end = place * width + low, place * width + high + 1
    shares = before
    for _ in range(STEPS):
        below = np.zeros((places, width))
        np.cumsum(shares, axis=1, out=below[:, 1:])
        each = times / (below.ravel()[end] - below.ravel()[begin])
        inside = np.bincount(begin, each, places * width) - np.bincount(end, each, places * width)
        expected = shares * np.cumsum(inside.reshape(places, width), axis=1)[:, :-1]
        shares = (expected + SPREAD * before) / (rows + SPREAD)
    return shares


def _along(wrong: Floats, shifts: Vector) -> Floats:
    """Return the misfits (B, L) of each window at its lag plus its shift (B,), in steps."""
    steps = np.arange(wrong.shape[1])
    return np.array([np.interp(steps + shift, steps, one) for one, shift in zip(wrong, shifts, strict=True)])


def _lowest(misfit: Vector) -> float:
    """Return where a curve is lowest, in steps, refined by a parabola."""
    best = int(misfit.argmin())
    if not 0 < best < len(misfit) - 1:
        return float(best)
    left, low, right = misfit[best - 1 : best + 2]
    bend = left - 2 * low + right
    return best + (0.5 * float((left - right) / bend) if bend > 0 else 0.0)
