"""Learns the arrival of parts that no signal reports from the robot's standstills.

If the robot waited for a part, the part arrived at the end of the wait; otherwise it arrived before the robot. Each
part arrives a gap after the previous one, provided there is room. So the gap is observed after each part that the robot
waited for: exactly, or left-censored by the robot's absence. Unobserved arrivals are sampled (particle filter); the
likelihood of the other standstills gives the buffer size. With that, `part_gaps` learns the gaps from all visits. These
have to explain the standstills better than chance does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards.coupling import SourceCard
from cyclekit.learning.coupling.conditions.departures import least_gain
from cyclekit.learning.coupling.conditions.lags import quantiles, reverse_kaplan_meier
from cyclekit.learning.coupling.events.part_visits import ANY, WAITED_S, PartVisits, Times, part_visits
from cyclekit.learning.coupling.events.visits import Event
from cyclekit.learning.coupling.parts.part_chains import part_chains, succession_of
from cyclekit.learning.coupling.parts.part_gaps import part_gaps

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.learning.coupling.parts.part_chains import Succession
    from cyclekit.schema import Bools, Floats, Vector

MIN_WAITS, MIN_GAPS = 10, 5
"""Minimum number of waits and of standstills without a wait, and of observed gaps."""
LONG_S = 10.0
"""Assumed lead, s, of a part that was present before the robot."""
BUFFERS = (1, 2, 3, 4, 5)
"""Buffer sizes tried: maximum number of waiting parts."""
GAIN_TOLERANCE = 0.5
"""Tolerance in log-likelihood: the smallest buffer within this of the best is chosen."""
MIN_MASS = 1e-6
"""Probability of a time up to which it counts as one that never occurs."""
PARTICLES = 100
"""Number of particles per execution."""


class PartArrivals(NamedTuple):
    """How parts arrive: quantiles of the first arrival and of the gaps, s, and how many parts may wait."""

    first_s: tuple[float, ...]
    gap_s: tuple[float, ...]
    buffer: int


def find_unseen_parts(courses: Sequence[ExecutionVisits], place: str) -> SourceCard | None:
    """Return how parts arrive that the robot waits for at a place; None if its standstills do not show it."""
    found = part_arrivals(part_visits(courses, place), succession_of(courses))
    if found is None:
        return None
    return SourceCard(signal=f"part at {place}", **found._asdict(), taken_by=place, inferred=True)


def part_arrivals(visits: PartVisits, order: Succession) -> PartArrivals | None:
    """Return how parts arrive that these visits wait for; None if they do not show it.

    Each execution begins without parts, or they come on from one execution to the next: what is more probable.
    """
    waited, seen = visits.waited, np.isfinite(visits.left)
    if min(waited.sum(), (seen & ~waited).sum()) < MIN_WAITS:
        return None
    chance = _by_chance(visits)
    told = [each for each in (_from_the_start(visits), _coming_on(visits, order, chance)) if each is not None]
    best = max(told, key=lambda each: max(each.likelihood), default=None)
    if best is None:
        return None
    least = max(best.likelihood) - GAIN_TOLERANCE
    buffer = next(n for n, each in zip(BUFFERS, best.likelihood, strict=True) if each >= least)
    at, to_first, to_next = part_gaps(best.visits, best.first, best.gaps, buffer)
    gaps = _learned(at, to_next)
    first = gaps if best.first is None else _learned(at, to_first)
    gain = best.others + _likelihood(best.visits, first, gaps, buffer) - float(chance.sum())
    if gain < least_gain(int(seen.sum())):
        return None
    gap_s = quantiles(at, to_next)
    if best.starts_s is None:
        return PartArrivals(quantiles(at, to_first), gap_s, buffer)
    first_s = _first_parts(best.visits, best.starts_s, gaps, buffer)
    return PartArrivals(quantiles(first_s, np.full(len(first_s), 1.0 / len(first_s))), gap_s, buffer)


def _learned(at: Vector, mass: Vector) -> Times:
    """Return a learned distribution without the times that hardly occur."""
    some = mass > MIN_MASS
    return Times(at[some], mass[some] / mass[some].sum())


class _Told(NamedTuple):
    """What visits tell under one assumption.

    Attributes:
        visits: The visits.
        first, gaps: Times to their first parts, None = like the others; times from part to part.
        likelihood: Log-likelihood of all standstills by buffer size.
        starts_s: Starts of executions, see `PartChains`; None = each begins without parts.
        others: Log-likelihood by chance of other standstills, which is part of `likelihood`.
    """

    visits: PartVisits
    first: Times | None
    gaps: Times
    likelihood: list[float]
    starts_s: Floats | None = None
    others: float = 0.0


def _from_the_start(visits: PartVisits) -> _Told | None:
    """Return what the visits tell if each execution begins without parts."""
    if visits.came.shape[1] < 2:
        return None
    first = _times(visits, np.zeros(len(visits.came)), visits.came[:, 0], visits.left[:, 0])
    gaps = _times(visits, visits.part_s[:, :-1].ravel(), visits.came[:, 1:].ravel(), visits.left[:, 1:].ravel())
    if min((gaps.mass > 0.0).sum(), (first.mass > 0.0).sum()) < MIN_GAPS:
        return None
    return _Told(visits, first, gaps, [_likelihood(visits, first, gaps, buffer) for buffer in BUFFERS])


def _coming_on(visits: PartVisits, order: Succession, chance: Floats) -> _Told | None:
    """Return what the visits tell if parts come on from one execution to the next.

    Visits before the first known part of a session tell nothing: they have their likelihood by chance.
    """
    chains = part_chains(visits, order)
    if chains is None:
        return None
    mine = chains.visits
    gaps = _times(mine, np.zeros(len(mine.came)), mine.came[:, 0], mine.left[:, 0])
    if (gaps.mass > 0.0).sum() < MIN_GAPS or not np.isfinite(chains.starts_s).any():
        return None
    others = float(chance[~chains.chained].sum())
    likelihood = [others + _likelihood(mine, gaps, gaps, buffer) for buffer in BUFFERS]
    return _Told(mine, None, gaps, likelihood, chains.starts_s, others)


def with_parts(courses: Sequence[ExecutionVisits], sources: Iterable[SourceCard]) -> list[ExecutionVisits]:
    """Return executions with the inferred arrivals of parts; LONG_S before the robot if it did not wait."""
    found = list(courses)
    for source in sources:
        if source.inferred:
            own_s = part_visits(courses, source.taken_by).own_s
            key = Event("signal", source.signal, "arrives")
            found = [replace(each, events={**each.events, key: _came(each, source.taken_by, own_s)}) for each in found]
    return found


def _came(course: ExecutionVisits, place: str, own_s: float) -> Vector:
    stays = np.array([(each.arrived_s, each.left_s) for each in course.visits["robot"] if each.place == place])
    came, left = stays.reshape(-1, 2).T
    return np.where(left - came > own_s + WAITED_S, left - own_s, came - LONG_S)


def _times(visits: PartVisits, since: Vector, came: Vector, left: Vector) -> Times:
    """Return the times from given instants to a part's arrival, left-censored if the robot did not wait for it."""
    known = np.isfinite(since) & np.isfinite(left)
    waited = left - came > visits.own_s + WAITED_S
    at = np.where(waited, left - visits.own_s, came)[known] - since[known]
    mass = reverse_kaplan_meier(at, waited[known].astype(np.float64), np.ones(len(at), np.bool_))
    return Times(at, mass)


def _likelihood(visits: PartVisits, first: Times, gaps: Times, buffer: int) -> float:
    """Return the log-likelihood of the standstills for a buffer size."""
    return sum(each for each, _ in _followed(visits, first, gaps, buffer))


def _first_parts(visits: PartVisits, starts_s: Floats, gaps: Times, buffer: int) -> Vector:
    """Return times at which first parts of executions came, since the start of these, as far as the visits tell, s."""
    found: list[Floats] = []
    for (_, came), start_s in zip(_followed(visits, gaps, gaps, buffer), starts_s.T, strict=True):
        some = np.isfinite(start_s)
        found.append((came[some] - start_s[some, None]).ravel())
    return np.concatenate(found)


def _followed(visits: PartVisits, first: Times, gaps: Times, buffer: int) -> Iterator[tuple[float, Floats]]:
    """Yield for each number of visits their log-likelihood, and samples of when their parts came, (E, PARTICLES), s."""
    rng, waited = np.random.default_rng(0), visits.waited
    came, part_s = visits.came[..., None], visits.part_s[..., None]
    before = np.zeros((len(came), PARTICLES))
    for number in range(came.shape[1]):
        times = gaps if number else first
        drawn = before + times.drawn(before.shape, rng)
        if number >= buffer:
            drawn = np.fmax(drawn, visits.left[:, number - buffer, None])
        waits, found_one = waited[:, number], np.isfinite(visits.left[:, number]) & ~waited[:, number]
        there = np.asarray(drawn <= came[:, number])
        since = (part_s[:, number] - before)[waits]
        total = float(np.log(times.density(since).mean(axis=1)).sum())
        total += float(np.log(np.clip(there[found_one].mean(axis=1), ANY, 1.0)).sum())
        kept = _of_these(drawn, there, rng)
        before = np.where(there.any(axis=1, keepdims=True), kept, came[:, number])
        before = np.where(waits[:, None], part_s[:, number], before)
        yield total, before


def _of_these(values: Floats, some: Bools, rng: np.random.Generator) -> Floats:
    """Return values resampled row by row from those marked in `some`, as many as before."""
    level = rng.random(values.shape) * some.sum(axis=1, keepdims=True)
    order = np.argsort(~some, axis=1, kind="stable")
    return np.take_along_axis(np.take_along_axis(values, order, 1), level.astype(np.int64), 1)


def _by_chance(visits: PartVisits) -> Floats:
    """Return the log-likelihood of each standstill, 0 where there is none, if they are independent of each other."""
    seen, waited = np.isfinite(visits.left), visits.waited
    waits_s = (visits.left - visits.came - visits.own_s)[waited]
    share = waited.sum() / seen.sum()
    found = np.where(seen, np.log(1.0 - share), 0.0)
    found[waited] = np.log(share * Times(waits_s, np.full(len(waits_s), 1.0 / len(waits_s))).density(waits_s))
    return found
