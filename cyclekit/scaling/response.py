"""The safety function in time, read from the logs: how late it reacts, how fast it ramps, how much farther it lets go.

A change of level begins some latency after the operator has crossed a threshold. Which threshold is unknown, but it is
the same each time: at the right latency the distances at which one level gives way to the next differ least. How steep
a change is, is its ramp. Where distance does not decide (zones, presence) the distances never agree, and latency and
hysteresis stay unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

ON_LEVEL = 0.01
"""A scaling so near to a level is on it."""
HELD_S = 0.05
"""A level holds if it lasts this long."""
RAMP_ROWS = 3
"""A change over fewer rows is a jump."""
LATEST_S, STEP_S = 1.0, 0.01
"""Latencies up to this are tried, in such steps."""
LATENCIES_S = np.arange(0.0, LATEST_S + STEP_S / 2, STEP_S)
LEAST = 20
"""Fewer changes say nothing."""
MOST = 20_000
"""More changes say no more."""
AGREE_M = 0.04
"""Distances at which the level changes agree if half of them are within this of their median."""


class LevelChange(NamedTuple):
    """One change of level: when it began, the step below the threshold that was crossed, and how fast it went.

    Attributes:
        t_s: Session time at which the level was last held.
        step: Index of the slower of the two levels between which the threshold lies.
        rises: The scaling rose.
        rate_per_s: Its change over time; None = at once.
    """

    t_s: float
    step: int
    rises: bool
    rate_per_s: float | None


@dataclass(frozen=True)
class SafetyResponse:
    """What is visible of the safety function in time; None = not visible.

    Attributes:
        latency_s: From the crossing of a threshold to the beginning of the change.
        ramp_down_per_s, ramp_up_per_s: Change of the scaling per second; None also where it jumps.
        hysteresis_m: How much farther than where it slowed the robot speeds up again.
        changes: How many changes of level were seen.
        spread_m: Median deviation of the distances at which levels change, at that latency.
    """

    latency_s: float | None
    ramp_down_per_s: float | None
    ramp_up_per_s: float | None
    hysteresis_m: float | None
    changes: int
    spread_m: float | None


def changes_of(t_s: Vector, scaling: Vector, levels: Sequence[float]) -> list[LevelChange]:
    """Return the changes of level of one unbroken stretch.

    Args:
        t_s: Time, shape (T,), native rate, seconds.
        scaling: Shape (T,), NaN = unknown.
        levels: Ascending.
    """
    if len(levels) < 2 or len(t_s) < 3:
        return []
    values = np.asarray(levels)
    nearest = np.searchsorted((values[1:] + values[:-1]) / 2, scaling).clip(max=len(values) - 1)
    on = np.abs(scaling - values[nearest]) < ON_LEVEL
    label = np.where(on, nearest, -1)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(label)) + 1, [len(label)]])
    held = [
        (int(label[a]), a, b - 1)
        for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        if label[a] >= 0 and t_s[b - 1] - t_s[a] >= HELD_S
    ]
    found = []
    for (before, _, left), (after, reached, _) in pairwise(held):
        if before == after or t_s[reached] - t_s[left] > LATEST_S:
            continue
        rises, way = after > before, slice(left + 1, reached)
        ramp = reached - left > RAMP_ROWS and np.isfinite(scaling[way]).all()
        rate = abs(float(np.polyfit(t_s[way] - t_s[left], scaling[way], 1)[0])) if ramp else None
        found.append(LevelChange(float(t_s[left]), before if rises else before - 1, rises, rate))
    return found


@dataclass(frozen=True)
class Changes:
    """The changes of level of one session, and how far apart operator and TCP were shortly before.

    Attributes:
        changes: All of them.
        kind: Of those whose distances are told: which threshold and direction, shape (N,).
        near_m: Their distances at each latency that is tried, shape (N, L), metres.
        samples: How many distances are known in all.
    """

    changes: list[LevelChange]
    kind: NDArray[np.int64]
    near_m: NDArray[np.float64]
    samples: int

    @classmethod
    def seen(cls, changes: Sequence[LevelChange], t_s: Vector, distance_m: Vector, most: int = MOST) -> Changes:
        """Look up the distances before changes of one session; of more than `most`, evenly spread, so many.

        Args:
            changes: In the order of time.
            t_s: Times of samples, shape (N,), ascending.
            distance_m: Distance of operator and TCP there, shape (N,), metres; NaN = unknown.
            most: Of so many changes at most.
        """
        known = np.isfinite(distance_m)
        told = changes[:: max(1, -(-len(changes) // most))] if known.any() else []
        at = np.array([change.t_s for change in told])[:, None] - LATENCIES_S[None]
        near_m = np.interp(at, t_s[known], distance_m[known]) if told else np.empty(at.shape)
        kind = np.array([2 * change.step + change.rises for change in told], np.int64)
        return cls(list(changes), kind, near_m, int(known.sum()))


def read_dynamics(seen: Sequence[Changes]) -> SafetyResponse:
    """Return what the changes of level of all sessions tell."""
    changes = [change for mine in seen for change in mine.changes]
    ramps = {
        rises: [change.rate_per_s for change in changes if change.rises is rises] for rises in (False, True)
    }  # fmt: skip
    down, up = (_usual(ramps[rises]) for rises in (False, True))
    kinds = np.concatenate([np.empty(0, np.int64), *(mine.kind for mine in seen)])
    if len(kinds) < LEAST or sum(mine.samples for mine in seen) < LEAST:
        return SafetyResponse(None, down, up, None, len(changes), None)
    near = np.concatenate([mine.near_m for mine in seen]).T
    off = np.full(near.shape, np.nan)
    for kind in np.unique(kinds):
        mine = kinds == kind
        if mine.sum() >= 5:
            off[:, mine] = np.abs(near[:, mine] - np.median(near[:, mine], axis=1, keepdims=True))
    if np.isnan(off).all():
        return SafetyResponse(None, down, up, None, len(changes), None)
    spread = np.nanmedian(off, axis=1)
    best = int(spread.argmin())
    if spread[best] > AGREE_M or best == len(LATENCIES_S) - 1:
        return SafetyResponse(None, down, up, None, len(changes), float(spread[best]))
    lag = [
        float(np.median(near[best][kinds == 2 * step + 1]) - np.median(near[best][kinds == 2 * step]))
        for step in np.unique(kinds // 2).tolist()
        if (kinds == 2 * step).sum() >= 5 and (kinds == 2 * step + 1).sum() >= 5
    ]
    hysteresis = max(0.0, float(np.median(lag))) if lag else None
    return SafetyResponse(float(LATENCIES_S[best]), down, up, hysteresis, len(changes), float(spread[best]))


def _usual(rates: Sequence[float | None]) -> float | None:
    """Return the usual rate of ramps; None where most changes happen at once."""
    ramps = [rate for rate in rates if rate is not None]
    return float(np.median(ramps)) if ramps and 2 * len(ramps) > len(rates) else None
