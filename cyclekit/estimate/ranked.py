"""Ranking of estimates: grouped by work, shortest first, with the probability that one is shorter than another."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cyclekit.estimate.cycles import MANY
from cyclekit.estimate.statistics.resample import means_below
from cyclekit.estimate.statistics.same_work import by_work

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.schema import Vector


def ranked(found: Sequence[CycleEstimate], means: Sequence[Vector], last: Sequence[bool]) -> list[CycleEstimate]:
    """Return estimates in order, each with the probability that it is shorter than each other one of the same work.

    Args:
        found: The estimates.
        means: The mean of each in each resample of the logs, shape (resamples,), s.
        last: Which estimates are too coarse to rank before the others, and come last.
    """
    order = sorted(range(len(found)), key=lambda i: (last[i], found[i].expected_s, found[i].name))
    alike = by_work([found[i] for i in order])
    mean_of = {entry.name: mean for entry, mean in zip(found, means, strict=True)}
    return [entry for work in alike.values() for entry in _of_one_work(work, mean_of)]


def _of_one_work(found: list[CycleEstimate], mean_of: Mapping[str, Vector]) -> list[CycleEstimate]:
    """Add to each estimate of one work the probability of being shorter than each other (if many, than the first)."""
    many = len(found) > MANY
    names = [entry.name for entry in found]
    means = [mean_of[name] for name in names]
    with_odds = []
    for index, entry in enumerate(found):
        against = [0, index] if many else range(len(found))
        below = means_below([means[i] for i in against], list(against).index(index))
        pairs = zip(against, below.tolist(), strict=True)
        with_odds.append(replace(entry, beats={names[i]: value for i, value in pairs if i != index}))
    return with_odds
