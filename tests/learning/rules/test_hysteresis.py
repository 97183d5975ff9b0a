"""One margin by which regions to leave are wider than those to enter, unless the rule shows several."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, NearerCard, RectangleCard, RegionCard
from cyclekit.learning.rules.edges.hysteresis import with_edges_to_leave, with_even_margins, with_one_hysteresis
from cyclekit.learning.rules.samples.distances import TO_TCP
from cyclekit.learning.rules.samples.quantities import outwards, quantities


def known(value: float, give_or_take_m: float) -> MetresCard:
    return MetresCard(value=value, low=value - give_or_take_m, high=value + give_or_take_m)


def region(metres: MetresCard, edge: MetresCard) -> RegionCard:
    box = RectangleCard(along=(known(0.9, 0.02), edge), across=(None, None))
    return RegionCard(nearer=(NearerCard(distance=TO_TCP, metres=metres),), rectangles=(box,))


def rule(edge: MetresCard) -> tuple[LimitCard, ...]:
    """A threshold left 0.1 m farther out than it is entered, and an edge."""
    within, until = region(known(1.2, 0.004), known(2.3, 0.02)), region(known(1.3, 0.004), edge)
    return (LimitCard(scaling=0.3, within=within, until=until),)


def left_at(limits: tuple[LimitCard, ...]) -> MetresCard:
    return next(
        m for place, m in quantities(limits).items() if place.until and (place.kind, place.edge) == ("rectangle", 1)
    )


def test_an_edge_that_few_crossed_on_their_way_out_lies_where_the_others_say() -> None:
    found = left_at(with_one_hysteresis(rule(known(2.53, 0.2))))
    assert found.value == pytest.approx(2.4, abs=0.01)
    assert found.low is not None
    assert found.high is not None
    assert found.low < 2.4 < found.high
    assert found.high - found.low < 0.1


def test_an_edge_with_a_hysteresis_of_its_own_keeps_it() -> None:
    assert left_at(with_one_hysteresis(rule(known(2.53, 0.03)))).value == 2.53


def test_a_rule_without_hysteresis_stays() -> None:
    limits = (LimitCard(scaling=0.3, within=region(known(1.2, 0.004), known(2.3, 0.02))),)
    assert with_one_hysteresis(limits) == limits


@given(st.floats(2.3, 2.8), st.floats(0.0, 0.5))
def test_every_number_stays_within_its_own_interval(value: float, give_or_take_m: float) -> None:
    limits = rule(known(value, give_or_take_m))
    before, after = quantities(limits), quantities(with_one_hysteresis(limits))
    for place, own in before.items():
        assert own.low is not None
        assert own.high is not None
        least = 0.002 if own.high - own.low < 0.002 else 0.0  # no better known than to a millimetre
        assert own.low - least <= after[place].value <= own.high + least
        assert np.isfinite(outwards(place) * after[place].value)


def crossed(at_m: float | None) -> MetresCard | None:
    return None if at_m is None else MetresCard(value=at_m, low=at_m, high=at_m)


def nearer(level: float, at_m: float, until_m: float) -> LimitCard:
    def region_of(metres: float) -> RegionCard:
        return RegionCard(nearer=(NearerCard(distance=TO_TCP, metres=known(metres, 0.0)),))

    return LimitCard(scaling=level, within=region_of(at_m), until=region_of(until_m))


def test_a_margin_far_off_the_others_is_theirs() -> None:
    given = (nearer(0.0, 0.8, 0.95), nearer(0.3, 1.2, 3.7), nearer(0.7, 1.7, 1.87))
    found = with_even_margins(given)
    assert found[::2] == given[::2]
    assert found[1].until == nearer(0.3, 1.2, 1.37).until
    assert with_even_margins(given[::2]) == given[::2]


def test_a_rectangle_is_left_across_each_edge_by_which_it_is_entered() -> None:
    def box(left_m: float | None, top_m: float | None) -> RegionCard:
        sides = {"along": (crossed(left_m), None), "across": (None, crossed(top_m))}
        return RegionCard(rectangles=(RectangleCard(angle_rad=0.0, **sides),))

    (found,) = with_edges_to_leave((LimitCard(scaling=0.5, within=box(-1.0, 2.0), until=box(-1.2, None)),))
    assert found.within == box(-1.0, 2.0)
    assert found.until is not None
    left, top = found.until.rectangles[0].along[0], found.until.rectangles[0].across[1]
    assert left is not None
    assert top is not None
    assert (left.value, top.value) == pytest.approx((-1.2, 2.2))
