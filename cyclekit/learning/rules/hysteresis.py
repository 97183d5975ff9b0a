"""One hysteresis for the whole rule, unless its thresholds and edges show several.

Where few operators crossed an edge on their way out, where the robot speeds up again is known to decimetres only. A
safety system widens its fields by one margin, as a rule: what the other thresholds and edges show of that tells where
such an edge lies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.learning.rules.quantities import outwards, put, quantities

if TYPE_CHECKING:
    from collections.abc import Collection

    from cyclekit.dataset.cards.rule import LimitCard, MetresCard
    from cyclekit.learning.rules.quantities import RulePlace

    Edges = tuple[MetresCard | None, MetresCard | None]

Z95 = 1.96
"""Half a 95 % interval, standard errors."""
FAR_OFF = 4.0
SUREST_M = 0.001
"""No threshold or edge is known better than this."""


def with_one_hysteresis(limits: tuple[LimitCard, ...], known: Collection[RulePlace] = ()) -> tuple[LimitCard, ...]:
    """Return a rule whose regions to leave are wider than those to enter by one margin, as far as its intervals allow.

    Each pair of numbers is drawn to the mean margin of all pairs, weighed by how well each is known; one whose own
    margin differs by more than its interval stays, as do those that are `known` already.
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
    """Return a rule in which a margin that is FAR_OFF times the median one of the rule, or negative, is that one.

    A level that has another condition as well stays in force far beyond its distance: a fit of the distance alone takes
    that for hysteresis.
    """
    margins = _margins(limits)
    if len(margins) < 2:
        return limits
    values, usual_m = quantities(limits), max(0.0, float(np.median(list(margins.values()))))
    off = [place for place, margin_m in margins.items() if not 0.0 <= margin_m <= FAR_OFF * usual_m]
    found = {place._replace(until=True): _moved(values[place], outwards(place) * usual_m) for place in off}
    return put(limits, found) if found else limits


def with_edges_to_leave(limits: tuple[LimitCard, ...]) -> tuple[LimitCard, ...]:
    """Return a rule whose rectangles to leave have each edge of those to enter, the median margin of the rule away."""
    margins = _margins(limits)
    usual_m = max(0.0, float(np.median(list(margins.values())))) if margins else 0.0
    return tuple(_with_edges(limit, usual_m) for limit in limits)


def _margins(limits: tuple[LimitCard, ...]) -> dict[RulePlace, float]:
    """Return by how much each region to leave is wider than the one to enter, by the place in the latter, m."""
    values = quantities(limits)
    places = [place for place in values if not place.until and place._replace(until=True) in values]
    return {
        place: outwards(place) * (values[place._replace(until=True)].value - values[place].value) for place in places
    }


def _with_edges(limit: LimitCard, margin_m: float) -> LimitCard:
    """Return a limit whose region to leave has each edge of the one to enter."""
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
    """Return a number as it is known by itself and by another one that lies `by_m` off, give or take `by_error`."""
    weights = np.array([_error(mine), np.hypot(_error(other), by_error)]) ** -2.0
    value = float(weights @ [mine.value, other.value + by_m] / weights.sum())
    half_m = Z95 * float(weights.sum() ** -0.5)
    return structs.replace(mine, value=value, low=value - half_m, high=value + half_m)
