"""A region whose edges may coincide, or that holds by chance, is left out of a rule."""

from __future__ import annotations

import numpy as np

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, NearerCard, RectangleCard, RegionCard
from cyclekit.learning.rules.cuts import LimitRows
from cyclekit.learning.rules.families import FAMILIES
from cyclekit.learning.rules.samples.distances import TO_TCP
from cyclekit.learning.rules.samples.positions import Positions
from cyclekit.learning.rules.samples.quantities import without_doubtful


def edges(from_m: tuple[float, float, float], to_m: tuple[float, float, float]) -> tuple[MetresCard, MetresCard]:
    first, last = (MetresCard(value=value, low=low, high=high) for low, value, high in (from_m, to_m))
    return first, last


def test_a_rectangle_that_may_have_no_extent_is_none_beside_a_distance() -> None:
    near = NearerCard(distance=TO_TCP, metres=MetresCard(value=0.8, low=0.79, high=0.81))
    strip = RectangleCard(along=edges((0.24, 0.25, 0.52), (0.27, 0.3, 0.43)), across=(None, None))
    zone = RectangleCard(
        along=edges((0.9, 0.91, 0.95), (2.2, 2.3, 2.31)), across=edges((-0.7, -0.6, -0.6), (1, 1.1, 1.2))
    )
    beside, alone = RegionCard(nearer=(near,), rectangles=(strip, zone)), RegionCard(rectangles=(strip,))
    limits = (LimitCard(scaling=0.0, within=beside, until=beside), LimitCard(scaling=0.5, within=alone))
    first, second = without_doubtful(limits)
    assert first.within.rectangles == (zone,)
    assert first.until is not None
    assert first.until.rectangles == (zone,)
    assert second == limits[1]


def test_a_rectangle_seen_by_chance_hides_no_distance() -> None:
    rng = np.random.default_rng(0)
    near, floor = rng.uniform(0.0, 1.0, 300), rng.uniform(-2.0, 2.0, (300, 2))
    rows = LimitRows(Positions({TO_TCP: near}, floor, np.zeros((300, 2))), near < 0.97, np.ones(300))
    chance = RectangleCard(along=edges((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)), across=(None, None))
    start = RegionCard(nearer=(NearerCard(distance=TO_TCP, metres=MetresCard(value=0.8)),), rectangles=(chance,))
    found = FAMILIES[f"{TO_TCP}, or rectangle on the floor"].fit(rows, start)
    assert rows.wrong(found) == 0.0
    assert found.nearer
