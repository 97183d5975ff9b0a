"""The lag of a condition, and own work, as the departures of a gate show them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.censored import whole_rows
from cyclekit.learning.coupling.conditions.candidates import HELD
from cyclekit.learning.coupling.conditions.conditions import KEPT, decided_by
from cyclekit.learning.coupling.conditions.lags import quantiles, reverse_kaplan_meier

if TYPE_CHECKING:
    from cyclekit.learning.coupling.conditions.departures import Condition, Departures, Gate
    from cyclekit.schema import Bools, Floats, Vector

TIE_S = 0.05
"""Tolerance of durations of stays that are equal, s."""
SELDOM = 0.2
"""Own work of the robot that decides at most this share of the stays must have decided short ones."""


def own_work_decides(gate: Gate, stays_s: Vector, own: Bools) -> bool:
    """Return whether own work ends some stays, and not only those whose event was not logged.

    Own work of the robot hardly varies. If it seldom decides, it does so in short stays: in the others the event came
    later.

    Args:
        gate: The gate.
        stays_s: Durations of the stays, shape (N,), s.
        own: Whether no event ended them, as far as that was logged, shape (N,).
    """
    if own.mean() <= 1.0 - HELD:  # the exceptions that the conditions allow
        return False
    if gate.agent == "operator" or own.mean() > SELDOM:
        return True
    return bool(np.median(stays_s[own]) <= np.quantile(stays_s[~own], 0.25) + TIE_S)


class LagSeen(NamedTuple):
    """The lag of a condition by its quantiles, s, the share of departures that need it, and which it decided (N,)."""

    quantiles_s: tuple[float, ...]
    needed: float
    decided: Bools


def lag_of(found: Departures, condition: Condition, seen_s: Vector, gate: Gate | None = None) -> LagSeen:
    """Return the lag of one condition of a gate, from the time since the event as a plan knows it.

    `gate`: the gate of the condition, if it is another one that shares departures.
    """
    step = -(-len(found.left_s) // KEPT)
    since = np.array([column[::step] for column in (found.left_s - found.own_s, *found.since_s.values())])
    row = 1 + list(found.since_s).index((gate or found.gate, condition))
    decided = decided_by(since) == row
    seen = np.where(np.isneginf(since[row]), -np.inf, seen_s[::step])
    mass = reverse_kaplan_meier(seen, decided * 1.0, ~np.isnan(seen))
    values = quantiles(seen, mass, shortest=not condition.partly)
    every = np.repeat(decided, step)[: len(found.left_s)]
    return LagSeen(values, min(1.0, round(float(mass.sum()), 4)), every)


def own_work(found: Departures, stays_s: Vector, decided: Bools) -> tuple[float, ...]:
    """Return the quantiles of own work that decided some departures; stays that are cut lasted at least so long.

    Args:
        found: The departures.
        stays_s: Duration of the stay before each of them, or some, shape (N,), s; NaN does not count.
        decided: Whether own work decided it, shape (N,).
    """
    if not len(found.stayed_s):
        return distribution(stays_s, decided.astype(np.float64))
    known, alone = np.isfinite(stays_s), not found.since_s
    cut = np.repeat([False, True], [int(known.sum()), len(found.stayed_s)])
    stays_s = np.append(stays_s[known], found.stayed_s)
    rows = whole_rows(stays_s, cut)
    ends = np.append(decided[known] | alone, np.full(len(found.stayed_s), alone))  # the longest may be a wait, too
    return distribution(stays_s[rows], ends[rows].astype(np.float64))


def distribution(since_s: Vector, decided: Floats) -> tuple[float, ...]:
    """Return the quantiles of own work that decided some stays, s."""
    known = np.isfinite(since_s)
    some = np.where(known, since_s, 0.0)
    return quantiles(some, reverse_kaplan_meier(some, decided * 1.0, known))
