"""Who moved a set override: people, the program, or a hand, whoever was near. Each has the burden of proof.

A safety function changes as the cell changes: on held-out stretches of time, what the logs show of people and robot
explains how it changes within seconds. A program that sets its own speed at certain places is explained by the robot
alone. A hand turns it rarely, and nothing explains when. If none is shown, none is believed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from cyclekit.derive.causes.usual_levels import usual_levels
from cyclekit.derive.set_override.rows import ROBOT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.derive.set_override.rows import SetOverrideRows
    from cyclekit.schema import Floats, Ints, Vector

Mover = Literal["people", "program", "hand", "unknown"]

CHANGE_S = 10.0
"""Time over which changes are compared, s: longer than a reaction, shorter than what a hand leaves set.
Half of it changes none of the forty cells of benchmarks/set_override.py, twice of it decides the one left open."""
MOST = 0.5
"""Share of the changes above which something explains most of them."""
SURE = 2.0
"""Standard errors on either side of a share."""
BY_HAND_S, RARELY_S = 30.0, 600.0
"""Least mean time between two turns by a hand, s: where people were logged (their tracker's clock is known, or they
explain the other scaling) and explain none of the turns, and where the logs cannot show it. Half and twice of the first
change none of the forty cells."""
FOLDS, BLOCKS, MIN_BLOCK_S = 4, 24, 30.0
CLASSES = 10
STILL = 0.005
"""Largest change of an override that is noise or rounding."""
OFF = 0.1
"""Largest error of an override that counts."""
TOP, FITS = 0.95, 3


class Explained(NamedTuple):
    """Share of the changes of a value that the rest of the log explains on held-out time, and its standard error.

    Attributes:
        share, error: See above.
        value: The value as explained, shape (N,).
        left, whole: Squares of the changes in each block of time that are left, and before, shape (B,).
    """

    share: float
    error: float
    value: Vector
    left: Vector
    whole: Vector

    @property
    def surely_most(self) -> bool:
        """Whether it is surely above one half."""
        return self.share - SURE * self.error > MOST

    @property
    def surely_not_most(self) -> bool:
        """Whether it is surely below one half."""
        return self.share + SURE * self.error < MOST

    @property
    def by_chance(self) -> bool:
        """Whether it is not above zero beyond chance."""
        return self.share - SURE * self.error <= 0.0

    def is_more_than(self, other: Explained) -> bool:
        """Return whether it explains more than another of the same values, beyond chance."""
        share, error = _share(other.left - self.left, self.whole)
        return share - SURE * error > 0.0


class Verdict(NamedTuple):
    """Who moved the override.

    Attributes:
        mover: People, the program, a hand, or unknown.
        share: Share of its changes within CHANGE_S that the logs explain on held-out time; None if it never changes
            within a run.
        turns: Number of its changes within runs.
        hours: Time in the rows, h.
        hand: The slider that a hand set beside people, of each row of each session; None if it never changed.
    """

    mover: Mover
    share: float | None
    turns: int
    hours: float
    hand: Sequence[Vector] | None = None


def mover_of(sessions: Sequence[SetOverrideRows], step_s: float, told: Mover | None = None) -> Verdict:
    """Return who moved the override.

    Args:
        sessions: Rows of all sessions.
        step_s: Time between rows, s.
        told: What the cell file says; None: nothing.
    """
    run, override = _runs(sessions, step_s), np.concatenate([one.override for one in sessions])
    scaling = np.concatenate([one.scaling for one in sessions])
    same = (run[1:] == run[:-1]) & (np.abs(np.diff(override)) > STILL)
    turns, hours = int((same & ~np.append(False, same[:-1])).sum()), len(run) * step_s / 3600.0
    if not turns:
        return Verdict(told or "hand", None, 0, hours)
    features, robot = _features(sessions), _features(sessions, ROBOT)
    seen = explained(override, features, run, step_s)
    alone = told is None and seen.surely_most and not seen.is_more_than(explained(override, robot, run, step_s))
    if told == "program" or alone:
        return Verdict("program", seen.share, turns, hours)
    hand = _hand(override, seen.value, features, run, step_s)
    parts = None if hand is None else np.split(hand, np.cumsum([len(one.t_s) for one in sessions])[:-1])
    if told == "people" or (told is None and seen.surely_most):
        return Verdict("people", seen.share, turns, hours, parts)
    between_s = 3600.0 * hours / turns
    by_hand = seen.by_chance and between_s > RARELY_S
    if not by_hand and seen.by_chance and seen.surely_not_most and between_s > BY_HAND_S:
        by_hand = any(one.tracked for one in sessions) or explained(scaling, features, run, step_s).surely_most
    return Verdict("hand" if told or by_hand else "unknown", seen.share, turns, hours)


def explained(values: Vector, features: Floats, run: Ints, step_s: float) -> Explained:
    """Return how much of the changes of some values over CHANGE_S the features explain on held-out time.

    Args:
        values: Shape (N,), NaN = unknown.
        features: Shape (N, F).
        run: Number of the run of each row, shape (N,), ascending.
        step_s: Time between rows, s.
    """
    known = np.isfinite(values)
    told = np.full(len(values), np.nan)
    block = np.arange(len(values)) // max(round(MIN_BLOCK_S / step_s), -(-len(values) // BLOCKS))
    label = np.round(np.where(known, values, 0.0) * CLASSES).astype(np.int64)
    count, total = (np.bincount(label[known], weights, CLASSES + 1) for weights in (None, values[known]))
    mean = total / np.maximum(count, 1)
    for fold in range(FOLDS):
        others, mine = known & (block % FOLDS != fold), block % FOLDS == fold
        if others.any() and mine.any():
            group = np.unique(block[others], return_inverse=True)[1]
            tree = usual_levels(features[others], label[others], CLASSES + 1, group)
            told[mine] = tree.shares[tree.leaf(features[mine])] @ mean
    back = min(round(CHANGE_S / step_s), len(values))
    pairs = np.flatnonzero((run[back:] == run[: len(run) - back]) & known[back:] & known[: len(run) - back]) + back
    changes, told_changes = (one[pairs] - one[pairs - back] for one in (values, told))
    left, whole = (
        np.bincount(block[pairs], squares, int(block[-1]) + 1).astype(np.float64)
        for squares in ((changes - told_changes) ** 2, changes**2)
    )
    return Explained(*_share(whole - left, whole), told, left, whole)


def _share(part: Vector, whole: Vector) -> tuple[float, float]:
    """Return the share of a part, both by block, and its standard error (jackknife); 0 and infinity of nothing."""
    if not whole.sum() > 0.0:
        return 0.0, np.inf
    without = (part.sum() - part) / np.maximum(whole.sum() - whole, 1e-9)
    return float(part.sum() / whole.sum()), float(np.sqrt((len(without) - 1) * without.var()))


def _runs(sessions: Sequence[SetOverrideRows], step_s: float) -> Ints:
    """Return the number of the run of each row: rows farther apart than a step are of different runs."""
    begins = [np.diff(one.t_s, prepend=-np.inf) > 1.5 * step_s for one in sessions]
    return np.cumsum(np.concatenate([np.empty(0, np.bool_), *begins]))


def _features(sessions: Sequence[SetOverrideRows], beginning: str = "") -> Floats:
    names = dict.fromkeys(name for one in sessions for name in one.features if name.startswith(beginning))
    return np.column_stack(
        [np.concatenate([one.features.get(name, np.zeros(len(one.t_s))) for one in sessions]) for name in names]
    )


def _hand(override: Vector, told: Vector, features: Floats, run: Ints, step_s: float) -> Vector | None:
    """Return the slider that a hand set beside a safety function, shape (N,); None if it never changed.

    The override is this slider times what the rest of the log tells, each fitted with the other known. A turn has to
    mend the fit for longer than CHANGE_S.
    """
    hand = np.ones(len(override))
    for _ in range(FITS):
        hand = _turned(override, told / max(np.nanquantile(told, TOP), STILL), step_s)
        if np.ptp(hand) <= 2.0 * STILL:
            return None
        told = explained(np.clip(override / hand, 0.0, 1.0), features, run, step_s).value
    return hand


def _turned(override: Vector, told: Vector, step_s: float) -> Vector:
    """Return the slider with few turns, shape (N,), by which `told` is nearest to the override (Viterbi)."""
    positions = np.arange(1, 101) / 100.0
    best, back = np.zeros(100), np.zeros((len(override), 100), np.uint8)
    for row, (value, share) in enumerate(zip(override, told, strict=True)):
        from_best = best.min() + OFF * CHANGE_S
        turned = best > from_best
        back[row] = np.where(turned, best.argmin(), np.arange(100))
        best = np.where(turned, from_best, best) + step_s * np.nan_to_num(
            np.minimum(np.abs(value - share * positions), OFF)
        )
    at = int(best.argmin())
    hand = np.empty(len(override))
    for row in range(len(override) - 1, -1, -1):
        hand[row] = positions[at]
        at = int(back[row, at])
    return hand
