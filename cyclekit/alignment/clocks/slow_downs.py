"""Clocks by the slow-downs of the robot: it is slow while the operator is near, and changes its speed as he comes.

For a tracker whose clock nothing else relates to the robot's. A rough search finds the lag at which the robot is slow
while somebody is near. Where the distance decides the speed, all changes of the same kind come at the same distance;
that places the clock within hundredths of a second, over all sessions together. The reaction time of the safety
function cannot be separated from the offset: it becomes part of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.unknown_height import in_plane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Ints, Points, Vector


REACH_S = 120.0
"""Maximum offset, s."""
FINE_S, AROUND_S = 0.02, 3.0
"""Step of the fine search, s, and its reach around the rough offset, s."""
MIN_LAG_S, MAX_LAG_S = -0.3, 0.8
"""A lag between these may be the reaction time of the safety function, or chance, and no offset of the clock, s."""
FAR_M = 4.0
"""Maximum distance of a person, m; larger ones count as this."""
MAX_ROWS = 2000
"""Maximum number of samples in the rough search, of those with slow-down and of the others."""
MIN_SHARE = 0.6
"""Minimum share of the samples that both logs cover at a lag, and of the changes with a known distance."""
TOO_WEAK, AMBIGUOUS = 0.2, 0.9
"""Correlation below which there is no lag, and relative height of the second-best one from which a note is added."""
CLEAR_PEAK, CLEAR_SECOND = 0.4, 0.75
"""Minimum correlation at a rough lag that is clear, and maximum of the second-best lag relative to it."""
MIN_CHANGES, MIN_CHANGES_OF_KIND = 12, 8
"""Minimum number of changes of speed: of a session, and of a kind over all sessions."""
MAX_RATIO = 0.85
"""Maximum mean deviation of the distances at changes, relative to its median over all lags."""
SHARP_M, ROUGH_S = 0.12, 0.5
"""Mean deviation above which other things than the distance decide, m; the uncertainty of the lag then, s."""
CAP_M = 0.3
"""Maximum deviation of one distance, m: some changes have other causes."""
ROUNDS = 8
"""Maximum number of rounds of the fine search."""
SHIFT_S, HYSTERESIS_S = 1.5, 0.4
"""Reach of a common shift of all lags, s, and reach of the search once falls and rises are set apart, s."""
CHANGE, STARTED, KIND = 0.05, 0.01, 0.05
"""Minimum change of the scaling that counts, the part of it after which it has started, and the width of a kind."""
HALF_S, MOVES = 0.2, 0.012
"""The scaling changes where it differs by more than MOVES from HALF_S before to HALF_S after."""
MAX_GAP_S = 0.5
"""Maximum time between rows, s."""


class RoughLag(NamedTuple):
    """Lag of the robot's time behind the log's, s, correlation there, and the second-best lag with its correlation."""

    lag_s: float
    peak: float
    second_s: float | None
    second: float | None

    @property
    def is_clear(self) -> bool:
        """Whether the correlation is high, and much lower elsewhere."""
        return self.peak >= CLEAR_PEAK and (self.second or 0.0) <= CLEAR_SECOND * self.peak


@dataclass(frozen=True)
class SpeedChanges:
    """Starts of changes of speed: time (K,), s, and kind (K,): direction, and the level that is left or aimed at."""

    t_s: Vector
    kind: Ints


@dataclass(frozen=True)
class LagEvidence:
    """Slow-downs of one session against one log of people, at trial lags.

    Attributes:
        rough: Result of the rough search; None if it found nothing.
        lags_s: Trial lags, shape (L,), s; the last one is 0, a common start.
        apart_m: Distance at each change on the floor and in space, shape (2, L, K), m; NaN = unknown.
        kind: Kind of each change, shape (K,).
    """

    rough: RoughLag | None
    lags_s: Vector
    apart_m: Floats
    kind: Ints


class Lag(NamedTuple):
    """Lag of a session: how far the robot's time is behind the log's, s.

    Attributes:
        lag_s: The lag.
        spread_m: Mean deviation of the distances at changes of speed, m; None if the rough search alone gives the lag.
        residual_s: Uncertainty, s.
        certain: Whether a common start contradicts the slow-downs, and this lag fits them.
    """

    lag_s: float
    spread_m: float | None
    residual_s: float
    certain: bool


def rough_lag(people: Sequence[Points], tcp_m: Points, scaling: Vector, *, step_s: float) -> RoughLag | None:
    """Return the lag in whole samples at which the robot is slow while a person is near.

    Args:
        people: Position per sample since the start of the log, one array (N, 3) per person, base frame, m; NaN = not
            seen, which counts as far.
        tcp_m: TCP per sample since the start of the robot log, shape (M, 3), m.
        scaling: Speed scaling per sample, shape (M,); NaN = unknown.
        step_s: Sampling period, s.

    Returns:
        The lag from time since the first row of the log to time since the first row of the robot log; None if there
        is no correlation.
    """
    rows = np.flatnonzero(np.isfinite(scaling) & np.isfinite(tcp_m).all(axis=1))
    slow = scaling[rows] < 0.99
    rows = np.sort(np.concatenate([some[:: max(1, -(-len(some) // MAX_ROWS))] for some in (rows[slow], rows[~slow])]))
    reach, count = round(REACH_S / step_s), max((len(track) for track in people), default=0)
    least = MIN_SHARE * min(1.0, count / max(len(tcp_m), 1)) * len(rows)
    lags = np.arange(-min(reach, count), min(reach, len(tcp_m)) + 1)
    tracks, at_m = [np.asfortranarray(track) for track in people], np.asfortranarray(tcp_m[rows])  # 3 times as fast
    score = np.array([_agreement(tracks, at_m, 1.0 - scaling[rows], rows - lag, least) for lag in lags])
    if not np.isfinite(score).any() or float(np.nanmax(score)) < TOO_WEAK:
        return None
    best = int(np.nanargmax(score))
    elsewhere = np.where(np.abs(lags - lags[best]) * step_s > 5.0, score, np.nan)
    lag_s, peak = float(lags[best]) * step_s, float(score[best])
    if not np.isfinite(elsewhere).any():
        return RoughLag(lag_s, peak, None, None)
    second = int(np.nanargmax(elsewhere))
    return RoughLag(lag_s, peak, float(lags[second]) * step_s, float(score[second]))


def _agreement(people: Sequence[Points], tcp_m: Points, slow: Vector, rows: Ints, least: float) -> float:
    """Return Pearson's correlation of "near" with "slow", with the people at `rows`, which ascend, of their log."""
    first, last = np.searchsorted(rows, (0, max((len(track) for track in people), default=0)))
    if last - first < max(least, 20):
        return float("nan")
    rows, tcp_m = rows[first:last], tcp_m[first:last]
    near = np.full(len(rows), FAR_M)
    for track in people:
        x, y, z = (in_plane(tcp_m, track.T.take(rows, axis=1).T) - tcp_m).T
        near = np.fmin(near, np.sqrt(x * x + y * y + z * z))
    a, b = -near, slow[first:last]
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 1e-9 else float("nan")


def speed_changes(t_s: Vector, scaling: Vector) -> SpeedChanges:
    """Return when the scaling starts to fall or to rise.

    Args:
        t_s: Time, shape (T,), s.
        scaling: Shape (T,); NaN = unknown. A change that begins next to a gap is left out.
    """
    times: list[float] = []
    kinds: list[int] = []
    known = np.flatnonzero(np.isfinite(scaling))
    for part in np.split(known, np.flatnonzero((np.diff(known) > 1) | (np.diff(t_s[known]) > MAX_GAP_S)) + 1):
        for first, last in _ramps(t_s[part], scaling[part]):
            rows, times_s = scaling[part][first : last + 1], t_s[part][first : last + 1]
            gone = np.abs(rows - rows[0])
            well = int((gone >= CHANGE).argmax())
            began = int(np.flatnonzero(gone[: well + 1] < STARTED)[-1])
            slope = (gone[well] - gone[began]) / (times_s[well] - times_s[began])
            times.append(float(times_s[began] - gone[began] / slope))
            falls = bool(rows[-1] < rows[0])
            kinds.append(2 * round(float(rows[-1] if falls else rows[0]) / KIND) + falls)
    return SpeedChanges(np.array(times, float), np.array(kinds, np.int64))


def _ramps(t_s: Vector, scaling: Vector) -> list[tuple[int, int]]:
    """Return first and last rows of rises and falls by at least CHANGE, but one that is cut by the first row."""
    half = max(1, round(HALF_S / float(np.median(np.diff(t_s))))) if len(t_s) > 1 else 1
    if len(t_s) <= 2 * half:
        return []
    change = np.zeros(len(t_s))
    change[half:-half] = scaling[2 * half :] - scaling[: -2 * half]
    sign = np.sign(np.where(np.abs(change) > MOVES, change, 0.0))
    ends = np.append(np.flatnonzero(np.diff(sign)), len(sign) - 1)
    begins = np.append(0, ends[:-1] + 1)
    found = zip(begins.tolist(), ends.tolist(), strict=True)
    return [
        (a, b) for a, b in found if sign[a] and a > half and np.abs(scaling[a : b + 1] - scaling[a]).max() >= CHANGE
    ]


def fit_lags(evidence: Sequence[LagEvidence]) -> list[Lag | None]:
    """Return the lag of each session: the one at which the distances at changes of each kind agree over all sessions.

    Args:
        evidence: Evidence of each session.
    """
    found = [None if one.rough is None else Lag(one.rough.lag_s, None, 0.5, certain=False) for one in evidence]
    fitted = [_Fit.of(evidence, way) for way in (0, 1)]
    best = min((fit for fit in fitted if fit is not None), key=lambda fit: fit.spread_m, default=None)
    if best is None:
        return found
    for number, session, at in zip(best.numbers, best.sessions, best.at, strict=True):
        spreads = best.spreads(session)
        spread_m = float(spreads[at])
        if len(session.kind) < MIN_CHANGES or spread_m > MAX_RATIO * float(np.median(spreads[:-1])):
            continue
        lag_s, start_m, rough = float(session.lags_s[at]), float(spreads[-1]), evidence[number].rough
        moved = not MIN_LAG_S <= lag_s <= MAX_LAG_S and spread_m <= MAX_RATIO * start_m
        residual_s = max(best.residual_s(session, at), FINE_S if spread_m <= SHARP_M else ROUGH_S)
        found[number] = Lag(lag_s, spread_m, residual_s, certain=moved and rough is not None and rough.is_clear)
    if any(one is not None and one.certain for one in found):  # a reaction time would be the same in all sessions
        found = [one._replace(certain=one.spread_m is not None) if one is not None else None for one in found]
    return found


class _Session(NamedTuple):
    """Distances (L, K) at trial lags (L,), and the kinds (K,), of one session."""

    lags_s: Vector
    apart_m: Floats
    kind: Ints


@dataclass
class _Fit:
    """Lags of several sessions by one kind of distance.

    A common shift of all lags hides in the distances of falls and rises: both move, in opposite directions. So the
    first rounds take falls to a level and rises from it for one kind, without hysteresis; the last ones set them apart
    and search near.

    Attributes:
        numbers: Numbers of the sessions.
        sessions: Their distances.
        at: Index of the lag of each.
        usual_m: Usual distance of each kind.
    """

    numbers: list[int]
    sessions: list[_Session]
    at: list[int]
    usual_m: dict[int, float]

    @classmethod
    def of(cls, evidence: Sequence[LagEvidence], way: int) -> _Fit | None:
        """Return the best lags; None without enough changes."""
        numbers = [n for n, one in enumerate(evidence) if one.rough is not None and len(one.kind)]
        if not numbers:
            return None
        kinds, count = np.unique(np.concatenate([evidence[n].kind for n in numbers]), return_counts=True)
        usual = kinds[count >= MIN_CHANGES_OF_KIND]
        if not len(usual):
            return None
        sessions = []
        for one in (evidence[n] for n in numbers):
            some = np.isin(one.kind, usual)
            sessions.append(_Session(one.lags_s, one.apart_m[way][:, some], one.kind[some]))
        levels = [one._replace(kind=one.kind // 2) for one in sessions]
        rough = cls(numbers, levels, [len(one.lags_s) // 2 for one in sessions], {})
        rough.improve(SHIFT_S, AROUND_S)
        fine = cls(numbers, sessions, rough.at, {})
        fine.improve(HYSTERESIS_S, HYSTERESIS_S)
        return fine

    @property
    def spread_m(self) -> float:
        """The mean deviation of the distances at the present lags, m."""
        weights = [len(one.kind) for one in self.sessions]
        there = [one._replace(apart_m=one.apart_m[[at]]) for one, at in zip(self.sessions, self.at, strict=True)]
        spreads = [self.spreads(one)[0] for one in there]
        return float(np.average(np.nan_to_num(spreads, nan=CAP_M), weights=weights)) if sum(weights) else np.inf

    def improve(self, shift_s: float, reach_s: float) -> None:
        """Choose in turn a common shift of all lags, and each lag alone by the usual distances, until nothing changes.

        Args:
            shift_s: Reach of the common shift, s.
            reach_s: Reach around the present lag of each session, s.
        """
        shift, reach, begun = round(shift_s / FINE_S), round(reach_s / FINE_S), list(self.at)
        for _ in range(ROUNDS):
            before = list(self.at)
            self._take(min((self._moved(before, by) for by in range(-shift, shift + 1)), key=self._spread_at))
            near = [_near(self.spreads(one), at, reach) for one, at in zip(self.sessions, begun, strict=True)]
            self._take([int(np.argmin(scores)) for scores in near])
            if self.at == before:
                break

    def _moved(self, at: Sequence[int], by: int) -> list[int]:
        return [min(max(one + by, 0), len(mine.lags_s) - 2) for one, mine in zip(at, self.sessions, strict=True)]

    def _spread_at(self, at: list[int]) -> float:
        self._take(at)
        return self.spread_m

    def _take(self, at: list[int]) -> None:
        """Set the lags, and the usual distances at them."""
        self.at = at
        apart = np.concatenate([one.apart_m[k] for one, k in zip(self.sessions, at, strict=True)])
        kind = np.concatenate([one.kind for one in self.sessions])
        order = np.lexsort((apart, kind))
        order = order[np.isfinite(apart[order])]
        kinds, first, count = np.unique(kind[order], return_index=True, return_counts=True)
        low, high = apart[order][first + (count - 1) // 2], apart[order][first + count // 2]
        self.usual_m = dict(zip(kinds.tolist(), ((low + high) / 2.0).tolist(), strict=True))  # medians

    def spreads(self, session: _Session) -> Vector:
        """Return the mean deviation of the distances from the usual ones at each lag of a session, shape (L,), m."""
        usual = np.array([self.usual_m.get(int(kind), np.nan) for kind in session.kind])
        off = np.minimum(np.abs(session.apart_m - usual), CAP_M)
        known = np.isfinite(off).sum(axis=1)
        enough = known >= max(1.0, MIN_SHARE * len(session.kind))
        return np.where(enough, np.nansum(off, axis=1) / np.maximum(known, 1), CAP_M)

    def residual_s(self, session: _Session, at: int) -> float:
        """Return half the difference of the lags by two halves of a session's changes, s."""
        reach = round(HYSTERESIS_S / FINE_S)
        halves = [session._replace(apart_m=session.apart_m[:, k::2], kind=session.kind[k::2]) for k in (0, 1)]
        first, other = (session.lags_s[int(np.argmin(_near(self.spreads(one), at, reach)))] for one in halves)
        return abs(float(first - other)) / 2


def _near(scores: Vector, at: int, reach: int) -> Vector:
    """Return the scores, infinite farther than `reach` from `at` and for the common start, which comes last."""
    near = np.abs(np.arange(len(scores)) - at) <= reach
    near[-1] = False
    return np.where(near, scores, np.inf)
