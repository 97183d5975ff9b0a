"""95 % confidence intervals of the thresholds and edges of a rule, from resampled executions."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.learning.rules.edges.hysteresis import Z95
from cyclekit.learning.rules.fitting import fit_limits, near_edges
from cyclekit.learning.rules.samples.quantities import changed, quantities

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from cyclekit.dataset.cards.rule import LimitCard, MetresCard
    from cyclekit.learning.rules.families.family import Family
    from cyclekit.learning.rules.samples.quantities import RulePlace
    from cyclekit.learning.rules.samples.rows import RuleRows

RESAMPLES = 40
BOUNDS = (0.025, 0.975)


def with_intervals(
    limits: tuple[LimitCard, ...],
    rows: RuleRows,
    levels: Sequence[float],
    family: Family,
    *,
    known: Collection[RulePlace] = (),
    noise_m: float = 0.0,
    seed: int,
) -> tuple[LimitCard, ...]:
    """Return a rule with the confidence interval of every threshold and edge.

    If there is a gap between slow and fast samples, the interval contains all of it: every value in it is equally
    likely.

    Args:
        limits: The rule, fitted to `rows`.
        rows: Rows to which it was fitted.
        levels: Levels of the speed scaling, ascending.
        family: Kind of the rule.
        known: Thresholds and edges that have an interval already.
        noise_m: Standard deviation of positions, m; added because a fit depends on the outermost sample on each side.
        seed: Seed of the resampling.
    """
    if set(quantities(limits)) <= set(known):
        return limits
    lag = any(limit.until is not None for limit in limits)
    near = near_edges(limits, rows)
    rng = np.random.default_rng(seed)
    count = int(rows.execution.max()) + 1
    present = np.unique(rows.execution)
    low: defaultdict[RulePlace, list[float]] = defaultdict(list)
    high: defaultdict[RulePlace, list[float]] = defaultdict(list)
    for _ in range(RESAMPLES):
        times = np.bincount(rng.choice(present, len(present)), minlength=count)[rows.execution].astype(np.float64)
        drawn = fit_limits(rows, levels, family, lag=lag, weight=times * near, start=limits)
        for place, metres in quantities(drawn).items():
            low[place].append(metres.value if metres.low is None else metres.low)
            high[place].append(metres.value if metres.high is None else metres.high)

    def bounded(place: RulePlace, metres: MetresCard) -> MetresCard:
        if place in known:
            return metres
        ends = [metres.value if end is None else end for end in (metres.low, metres.high)]
        below = float(np.quantile([*low[place], ends[0]], BOUNDS[0], method="lower"))
        above = float(np.quantile([*high[place], ends[1]], BOUNDS[1], method="higher"))
        off_m = 0.0 if place.kind == "robot" else Z95 * noise_m
        return structs.replace(metres, low=min(below, metres.value) - off_m, high=max(above, metres.value) + off_m)

    return changed(limits, bounded)
