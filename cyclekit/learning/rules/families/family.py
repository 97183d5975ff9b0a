"""Interface of a kind of rule."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclekit.dataset.cards.rule import RegionCard
    from cyclekit.learning.rules.cuts import LimitRows


class Family(NamedTuple):
    """One kind of rule.

    Attributes:
        fit: Returns the region that explains best which rows are slow. The second argument is a region of this kind to
            start from, whose conditions are kept.
        uses: Distances that it needs.
        mixed: Whether it combines two conditions.
        may_lag: Whether it supports hysteresis: one region to enter and one to leave.
    """

    fit: Callable[[LimitRows, RegionCard | None], RegionCard]
    uses: tuple[str, ...] = ()
    mixed: bool = False
    may_lag: bool = True
