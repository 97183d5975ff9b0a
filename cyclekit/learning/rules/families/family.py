"""What the ladder asks of a kind of rule."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclekit.dataset.cards.rule import RegionCard
    from cyclekit.learning.rules.cuts import LimitRows


class Family(NamedTuple):
    """One kind of rule.

    Attributes:
        fit: Returns the region that explains best which rows are slow; `start` is one of this kind, nearby,
            whose conditions are kept: it says where to begin.
        uses: Distances that it needs.
        mixed: It joins two conditions.
        may_lag: It makes sense with hysteresis: two regions, one to enter and one to leave.
    """

    fit: Callable[[LimitRows, RegionCard | None], RegionCard]
    uses: tuple[str, ...] = ()
    mixed: bool = False
    may_lag: bool = True
