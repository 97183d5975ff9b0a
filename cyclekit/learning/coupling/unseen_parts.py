"""Learns the arrival of parts that no signal reports from the robot's standstills.

If the robot waited for a part, the part arrived at the end of the wait; otherwise it arrived before the robot. Each
part arrives a gap after the previous one, provided there is room. So the gap is observed after each part that the robot
waited for: exactly, or left-censored by the robot's absence. Unobserved arrivals are sampled (particle filter); the
likelihood of the other standstills gives the buffer size. With that, `part_gaps` learns the gaps from all visits.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards.coupling import SourceCard
from cyclekit.learning.coupling.departures import least_gain
from cyclekit.learning.coupling.lags import quantiles, reverse_kaplan_meier
from cyclekit.learning.coupling.part_gaps import part_gaps
from cyclekit.learning.coupling.part_visits import ANY, WAITED_S, PartVisits, Times, part_visits
from cyclekit.learning.coupling.visits import Event

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.learning.coupling.visits import ExecutionVisits
    from cyclekit.schema import Bools, Floats, Vector

MIN_WAITS, MIN_GAPS = 10, 5
"""Minimum number of waits and of standstills without a wait, and of observed gaps."""
LONG_S = 10.0
"""Assumed lead, s, of a part that was present before the robot."""
BUFFERS = (1, 2, 3, 4, 5)
"""Buffer sizes tried: maximum number of waiting parts."""
GAIN_TOLERANCE = 0.5
"""Tolerance in log-likelihood: the smallest buffer within this of the best is chosen."""
PARTICLES = 100
"""Number of particles per execution."""


class PartArrivals(NamedTuple):
    """How parts arrive: quantiles of the first arrival and of the gaps, s, and how many parts may wait."""

    first_s: tuple[float, ...]
    gap_s: tuple[float, ...]
    buffer: int


def find_unseen_parts(courses: Sequence[ExecutionVisits], place: str) -> SourceCard | None:
    """Return how parts arrive that the robot waits for at a place; None if its standstills do not show it."""
    found = part_arrivals(part_visits(courses, place))
    if found is None:
        return None
    return SourceCard(signal=f"part at {place}", **found._asdict(), taken_by=place, inferred=True)


def part_arrivals(visits: PartVisits) -> PartArrivals | None:
    """Return how parts arrive that these visits wait for; None if they do not show it."""
    waited, seen = visits.waited, np.isfinite(visits.left)
    if min(waited.sum(), (seen & ~waited).sum()) < MIN_WAITS or visits.came.shape[1] < 2:
        return None
    first = _times(visits, np.zeros(len(visits.came)), visits.came[:, 0], visits.left[:, 0])
    gaps = _times(visits, visits.part_s[:, :-1].ravel(), visits.came[:, 1:].ravel(), visits.left[:, 1:].ravel())
    if min((gaps.mass > 0.0).sum(), (first.mass > 0.0).sum()) < MIN_GAPS:
        return None
    found = [_likelihood(visits, first, gaps, buffer) for buffer in BUFFERS]
    if max(found) - _by_chance(visits) < least_gain(int(seen.sum())):
        return None
    buffer = next(n for n, each in zip(BUFFERS, found, strict=True) if each >= max(found) - GAIN_TOLERANCE)
    at, to_first, to_next = part_gaps(visits, first, gaps, buffer)
    return PartArrivals(quantiles(at, to_first), quantiles(at, to_next), buffer)


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
    rng, total, waited = np.random.default_rng(0), 0.0, visits.waited
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
        total += float(np.log(times.density(since).mean(axis=1)).sum())
        total += float(np.log(np.clip(there[found_one].mean(axis=1), ANY, 1.0)).sum())
        kept = _of_these(drawn, there, rng)
        before = np.where(there.any(axis=1, keepdims=True), kept, came[:, number])
        before = np.where(waits[:, None], part_s[:, number], before)
    return total


def _of_these(values: Floats, some: Bools, rng: np.random.Generator) -> Floats:
    """Return values resampled row by row from those marked in `some`, as many as before."""
    level = rng.random(values.shape) * some.sum(axis=1, keepdims=True)
    order = np.argsort(~some, axis=1, kind="stable")
    return np.take_along_axis(np.take_along_axis(values, order, 1), level.astype(np.int64), 1)


def _by_chance(visits: PartVisits) -> float:
    """Return the log-likelihood of the standstills if they are independent of each other."""
    seen, waited = np.isfinite(visits.left), visits.waited
    waits_s = (visits.left - visits.came - visits.own_s)[waited]
    share = waited.sum() / seen.sum()
    density = Times(waits_s, np.full(len(waits_s), 1.0 / len(waits_s))).density(waits_s)
    return float(np.log(share * density).sum() + (seen & ~waited).sum() * np.log(1.0 - share))
