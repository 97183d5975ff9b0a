"""One kind of rule fitted to rows: a region for each level, with hysteresis two."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import LimitCard, RegionCard
from cyclekit.learning.rules.cuts import LimitRows

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.rules.families.family import Family
    from cyclekit.learning.rules.rows import RuleRows

    Limits = tuple[LimitCard, ...]


def fit_limits(
    rows: RuleRows,
    levels: Sequence[float],
    family: Family,
    *,
    lag: bool,
    weight: NDArray[np.float64] | None = None,
    start: Mapping[float, LimitCard] | None = None,
) -> Limits:
    """Return the limits that explain the commanded levels best.

    The slowest level is fitted first; the next one to the rows that it leaves. With hysteresis the region that slows
    the robot is fitted to samples before which it was faster, the region to leave to those before which it was not.

    Args:
        rows: What is known.
        levels: Of the speed scaling, ascending.
        family: Which kind.
        lag: With hysteresis.
        weight: How often each row counts, shape (N,); None: once.
        start: Limits of the same kind nearby, by their level.
    """
    counts = np.ones(len(rows)) if weight is None else weight
    earlier = np.where(rows.before >= 0, rows.level[rows.before], -1)
    found = []
    for step, level in enumerate(levels[:-1]):
        open_to = (rows.level >= step) & (counts > 0)
        if not (open_to & (rows.level == step)).any():
            continue
        begin = (start or {}).get(level)
        if begin is None:
            region = family.fit(_part(rows, open_to, step, counts), None)
            begin = LimitCard(scaling=level, within=region, until=region)
            regions = [region]
        if lag or start:
            parts = (open_to & (earlier > step), open_to & (earlier >= 0) & (earlier <= step)) if lag else (open_to,)
            begins = (begin.within, begin.until)
            regions = [
                family.fit(_part(rows, part, step, counts), first) for part, first in zip(parts, begins, strict=False)
            ]
        if regions[0] != RegionCard():
            found.append(LimitCard(scaling=level, within=regions[0], until=regions[1] if lag else None))
    return tuple(found)


def _part(rows: RuleRows, keep: NDArray[np.bool_], step: int, weight: NDArray[np.float64]) -> LimitRows:
    apart = {name: values[keep] for name, values in rows.apart_m.items()}
    return LimitRows(apart, rows.floor_m[keep], rows.level[keep] == step, weight[keep])
