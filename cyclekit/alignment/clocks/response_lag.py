"""A lag refined to about 0.1 s, with its drift: the level asked for by where people are, as it is followed.

The robot is slowed at once and recovers slowly, so its level alone is late by seconds. Here the level asked for at each
place is followed at the rates at which the robot's level falls and rises, and compared with the logged one. A constant
reaction time cannot be told from the clock: it stays part of the lag.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import stdtrit

from cyclekit.alignment.clocks.explained import CHANCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Ints, Vector

FINE_S, AROUND_S = 0.05, 3.0
"""Step of the search, s, which a parabola refines, and its reach around the found lag, s: a slow recovery moves that by
up to 2 s."""
WINDOWS, WINDOW_S = 20, 180.0
"""Number of windows of the log that are compared, and their maximum length, s: an hour tells enough."""
MOVES, HALF_S, SHORT_S = 0.012, 0.2, 0.6
"""The level changes where it differs by more than MOVES from HALF_S before to HALF_S after; in a longer change than
SHORT_S, s, the level asked for is unknown."""
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


def refine_lag(grids: Sequence[Sequence[PlacesAndLevel]], lag_s: float) -> RefinedLag | None:
    """Return the refined lag near `lag_s`; None if the level never changes where the logs meet.

    Args:
        grids: The same sessions with each of some grids of cells: where a threshold lies in a cell is not known, and
            the mean over moved grids hardly depends on it (Scott, Annals of Statistics 13, 1985).
        lag_s: The lag so far.
    """
    reach = round(AROUND_S / FINE_S)
    lags = round(lag_s / FINE_S) + np.arange(-reach, reach + 1)
    misfits = []
    for sessions in grids:
        windows = [window for one in sessions for window in _windows(one, lags, -(-WINDOWS // len(sessions)))]
        some = windows[:: max(1, len(windows) // WINDOWS)]
        if not some:
            return None
        rates = _rates([window.level for window in some])
        misfits.append([_misfits(window, asked, rates) for window, asked in zip(some, _asked(some), strict=True)])
    wrong = np.mean(misfits, axis=0)
    at_s = np.array([window.at_s for window in some])
    if not (np.ptp(wrong, axis=1) > 0.0).any():
        return None
    about_s = float(at_s.mean())
    drifts = np.linspace(-MAX_DRIFT, MAX_DRIFT, 41)
    still = _along(wrong, np.zeros(len(some)))
    moved = [_along(wrong, drift * (at_s - about_s) / FINE_S) for drift in drifts]
    best = int(np.argmin([one.sum(axis=0).min() for one in moved]))
    better = still[:, still.sum(axis=0).argmin()] - moved[best][:, moved[best].sum(axis=0).argmin()]
    spread = float(better.std(ddof=1)) / np.sqrt(len(some)) if len(some) > 1 else np.inf
    drifts_apart = bool(better.mean() > stdtrit(max(len(some) - 1, 1), 1.0 - CHANCE) * spread)
    drift, chosen = (float(drifts[best]), moved[best]) if drifts_apart else (0.0, still)
    whole = chosen.sum(axis=0)
    without = np.array([_lowest(whole - one) for one in chosen]) * FINE_S
    error_s = float(np.sqrt((len(some) - 1) * without.var())) if len(some) > 1 else AROUND_S
    return RefinedLag(float(lags[0]) * FINE_S + _lowest(whole) * FINE_S, drift, about_s, max(error_s, FINE_S / 2))


class _Window(NamedTuple):
    """A stretch: cells of people (L, K, W) at each lag, cell of the robot (W,), level (W,), and its middle, s."""

    people: Ints
    robot: Ints
    level: Vector
    at_s: float


def _windows(one: PlacesAndLevel, lags: Ints, count: int) -> list[_Window]:
    """Return some windows of a session in which people are logged at all lags."""
    first = max(one.robot_at, one.people_at + int(lags[-1]))
    end = min(one.robot_at + len(one.level), one.people_at + one.people.shape[1] + int(lags[0]))
    length = min(round(WINDOW_S / FINE_S), max(end - first, 0) // count)
    if length * FINE_S < SHORT_S:
        return []
    begins = np.linspace(first, end - length, count).astype(int)
    found = []
    for begin in begins.tolist():
        rows = begin + np.arange(length)
        people = one.people[:, rows[None] - lags[:, None] - one.people_at].swapaxes(0, 1)
        mine = rows - one.robot_at
        found.append(_Window(people, one.robot[mine], one.level[mine], (begin + length / 2) * FINE_S))
    return found


def _asked(windows: Sequence[_Window]) -> list[Floats]:
    """Return the level asked for in each window at each lag, shape (L, W): the least of all people's."""
    robot = np.unique(np.concatenate([one.robot for one in windows]))
    people = np.unique(np.concatenate([one.people.ravel() for one in windows]))
    held, weight = zip(*(_held(one.level) for one in windows), strict=True)
    usual = float(np.nanmean(np.concatenate(held))) if np.isfinite(np.concatenate(held)).any() else 1.0
    numbers = [np.searchsorted(people, one.people) * len(robot) + np.searchsorted(robot, one.robot) for one in windows]
    made = [np.full((one.people.shape[0], len(one.level)), np.inf) for one in windows]
    for lag in range(windows[0].people.shape[0]):
        count, total = np.zeros(len(people) * len(robot)), np.zeros(len(people) * len(robot))
        for one, number, level, part in zip(windows, numbers, held, weight, strict=True):
            for slot in range(one.people.shape[1]):
                use = np.isfinite(level) & (one.people[lag, slot] >= 0)
                count += np.bincount(number[lag, slot][use], part[use], len(count))
                total += np.bincount(number[lag, slot][use], (part * level)[use], len(count))
        mean = np.where(count > 0.0, total / np.maximum(count, 1e-9), usual)
        for one, number, out in zip(windows, numbers, made, strict=True):
            there = np.where(one.people[lag] >= 0, mean[number[lag]], np.inf).min(axis=0)
            out[lag] = np.where(np.isfinite(there), there, usual)
    return made


def _changes(level: Vector) -> list[tuple[int, int]]:
    """Return the rows before the first and of the last step of each rise and fall."""
    half = round(HALF_S / FINE_S)
    change = np.zeros(len(level))
    change[half:-half] = np.nan_to_num(level[2 * half :] - level[: -2 * half])
    sign = np.where(np.abs(change) > MOVES, np.sign(change), 0.0)
    ends = np.append(np.flatnonzero(np.diff(sign)), len(sign) - 1)
    begins = np.append(0, ends[:-1] + 1)
    found = []
    for begin, end in zip(begins[sign[begins] != 0].tolist(), ends[sign[begins] != 0].tolist(), strict=True):
        steps = np.flatnonzero(np.abs(np.diff(level[begin : end + 1])) > MOVES * FINE_S / HALF_S)
        if len(steps):
            found.append((begin + int(steps[0]), begin + int(steps[-1]) + 1))
    return found


def _held(level: Vector) -> tuple[Vector, Vector]:
    """Return the level asked for, shape (W,), and its weight: that of a long change is little known."""
    asked, weight = level.copy(), np.ones(len(level))
    for begin, end in _changes(level):
        asked[begin + 1 : end + 1] = level[end]
        if (end - begin) * FINE_S > SHORT_S:
            weight[begin + 1 : end] = 0.01
    return asked, weight


def _rates(levels: Sequence[Vector]) -> tuple[float, float]:
    """Return how fast the level falls and rises, per FINE_S: medians over the changes."""
    fall, rise = [1.0], [1.0]
    for level in levels:
        for begin, end in _changes(level):
            by = float(level[end] - level[begin])
            (rise if by > 0 else fall).append(abs(by) / (end - begin))
    return float(np.median(fall[1:] or fall)), float(np.median(rise[1:] or rise))


def _misfits(window: _Window, asked: Floats, rates: tuple[float, float]) -> Vector:
    """Return the summed squared differences between the logged and the followed level, shape (L,)."""
    known = np.isfinite(window.level)
    now = np.full(len(asked), window.level[known][0] if known.any() else 1.0)
    followed = np.empty_like(asked)
    before = asked[:, 0]
    for row in range(len(window.level)):
        by = np.clip(asked[:, row] - now, -rates[0], rates[1])
        begins = (now == before) & (np.abs(asked[:, row] - now) > 1.5 * np.abs(by))  # a ramp, not a jump
        now = now + np.where(begins, by / 2.0, by)  # it begins within the step
        followed[:, row], before = now, asked[:, row]
    return np.asarray(((followed[:, known] - window.level[known]) ** 2).sum(axis=1))


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
