"""Estimates one common hysteresis margin for a rule, unless its thresholds and edges differ.

If few operators crossed an edge on their way out, the position at which the robot speeds up again is known only to
decimetres. Safety systems usually enlarge all fields by one margin, so the margins of other thresholds and edges help
to locate it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.learning.rules.samples.quantities import outwards, put, quantities

if TYPE_CHECKING:
    from collections.abc import Collection

    from cyclekit.dataset.cards.rule import LimitCard, MetresCard
    from cyclekit.learning.rules.samples.quantities import RulePlace

    Edges = tuple[MetresCard | None, MetresCard | None]

Z95 = 1.96
"""Half-width of a 95 % interval, standard errors."""
FAR_OFF = 4.0
"""Maximum plausible margin, in medians of all margins of the rule."""
SUREST_M = 0.001
"""Minimum standard error of a threshold or edge, m."""


def with_one_hysteresis(limits: tuple[LimitCard, ...], known: Collection[RulePlace] = ()) -> tuple[LimitCard, ...]:
    """Return a rule whose regions to leave are larger than those to enter by one margin, as far as intervals allow.

    Each pair of values is shifted to the weighted mean margin of all pairs. A pair whose own margin differs by more
    than its interval keeps it, as do pairs in `known`.
    """
    values = quantities(limits)
    places = [place for place in values if not place.until and place._replace(until=True) in values]
    if len(places) < 2:
        return limits
    pairs = [(values[place], values[place._replace(until=True)]) for place in places]
    ways = [outwards(place) for place in places]
    margin = np.array([way * (outer.value - inner.value) for way, (inner, outer) in zip(ways, pairs, strict=True)])
    error = np.array([np.hypot(_error(inner), _error(outer)) for inner, outer in pairs])
    mean_m = float(np.average(margin, weights=error**-2.0))
    mean_error = float((error**-2.0).sum() ** -0.5)
    found: dict[RulePlace, MetresCard] = {}
    for number in np.flatnonzero(np.abs(margin - mean_m) <= Z95 * error).tolist():
        place, apart_m, (inner, outer) = places[number], ways[number] * mean_m, pairs[number]
        if place in known and place._replace(until=True) in known:
            continue
        found[place] = _joined(inner, outer, -apart_m, mean_error)
        found[place._replace(until=True)] = _joined(outer, inner, apart_m, mean_error)
    return put(limits, found)


def with_even_margins(limits: tuple[LimitCard, ...]) -> tuple[LimitCard, ...]:
    """Return a rule with implausible margins (negative, or above FAR_OFF medians) replaced by the median.

    A level that has a second condition lasts far beyond its distance; a fit of the distance alone takes this for
    hysteresis.
    """
    margins = _margins(limits)
    if len(margins) < 2:
        return limits
    values, usual_m = quantities(limits), max(0.0, float(np.median(list(margins.values()))))
    off = [place for place, margin_m in margins.items() if not 0.0 <= margin_m <= FAR_OFF * usual_m]
    found = {place._replace(until=True): _moved(values[place], outwards(place) * usual_m) for place in off}
    return put(limits, found) if found else limits


def with_edges_to_leave(limits: tuple[LimitCard, ...]) -> tuple[LimitCard, ...]:
    """Return a rule whose rectangles to leave have all edges of those to enter; missing ones by the median margin."""
    margins = _margins(limits)
    usual_m = max(0.0, float(np.median(list(margins.values())))) if margins else 0.0
    return tuple(_with_edges(limit, usual_m) for limit in limits)


def _margins(limits: tuple[LimitCard, ...]) -> dict[RulePlace, float]:
    """Return how much larger each region to leave is than the region to enter, m, by the place in the latter."""
    values = quantities(limits)
    places = [place for place in values if not place.until and place._replace(until=True) in values]
    return {
        place: outwards(place) * (values[place._replace(until=True)].value - values[place].value) for place in places
    }


def _with_edges(limit: LimitCard, margin_m: float) -> LimitCard:
    """Return a limit whose region to leave has all edges of the region to enter."""
    if limit.until is None or len(limit.until.rectangles) != len(limit.within.rectangles):
        return limit
    pairs = zip(limit.within.rectangles, limit.until.rectangles, strict=True)
    kept = tuple(
        structs.replace(
            outer,
            along=_edges(inner.along, outer.along, margin_m),
            across=_edges(inner.across, outer.across, margin_m),
        )
        for inner, outer in pairs
    )
    return structs.replace(limit, until=structs.replace(limit.until, rectangles=kept))


def _edges(inner: Edges, outer: Edges, margin_m: float) -> Edges:
    low, high = (
        edge if edge is not None or same is None else _moved(same, way * margin_m)
        for same, edge, way in zip(inner, outer, (-1.0, 1.0), strict=True)
    )
    return low, high


def _moved(metres: MetresCard, by_m: float) -> MetresCard:
    at = metres.value + by_m
    return structs.replace(metres, value=at, low=at, high=at)


def _error(metres: MetresCard) -> float:
    """Return the standard error of a threshold or edge with an interval, m."""
    width = 0.0 if metres.low is None or metres.high is None else metres.high - metres.low
    return max(width / 2 / Z95, SUREST_M)


def _joined(mine: MetresCard, other: MetresCard, by_m: float, by_error: float) -> MetresCard:
    """Return the weighted mean of a value and of another one shifted by `by_m` with standard error `by_error`."""
    weights = np.array([_error(mine), np.hypot(_error(other), by_error)]) ** -2.0
    value = float(weights @ [mine.value, other.value + by_m] / weights.sum())
    half_m = Z95 * float(weights.sum() ** -0.5)
    return structs.replace(mine, value=value, low=value - half_m, high=value + half_m)
