"""Ranking of estimates: grouped by work, shortest first, with the probability that one is shorter than another."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from cyclekit.estimate.cycles import MANY
from cyclekit.estimate.statistics.resample import means_below
from cyclekit.estimate.statistics.same_work import by_work

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.schema import Vector


class Unranked(NamedTuple):
    """One estimate before it is ranked.

    Attributes:
        entry: The estimate.
        means_s: Its mean in each resample of the logs, shape (resamples,), s.
        last: Whether it is too coarse to rank before the others, and comes last.
    """

    entry: CycleEstimate
    means_s: Vector
    last: bool = False


def ranked(found: Sequence[Unranked]) -> list[CycleEstimate]:
    """Return estimates in order, each with the probability that it is shorter than each other one of the same work."""
    order = sorted(found, key=lambda one: (one.last, one.entry.expected_s, one.entry.name))
    alike = by_work([one.entry for one in order])
    mean_of = {one.entry.name: one.means_s for one in found}
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
