"""The robot's visits to a place of parts, and the times between these parts as far as the visits show them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Bools, Floats, Vector

WAITED_S = 0.3
"""A standstill is a wait if it exceeds the 10 % quantile of standstills by more than this, s."""
ANY, ANY_S = 0.01, 100.0
"""Share of outliers among gaps and waits, and the range of their uniform density, s."""


@dataclass(frozen=True)
class PartVisits:
    """Visits of the robot to one place, by execution and number, shape (E, K), padded with NaN; s.

    Attributes:
        came, left: Arrival and departure, since the start of the execution.
        own_s: Own work at the place.
    """

    came: Floats
    left: Floats
    own_s: float

    @property
    def waited(self) -> Bools:
        """Whether the robot waited, shape (E, K)."""
        return np.asarray(self.left - self.came > self.own_s + WAITED_S)

    @property
    def part_s(self) -> Floats:
        """Arrival time of the part if the robot waited for it, shape (E, K), s; otherwise NaN."""
        return np.where(self.waited, self.left - self.own_s, np.nan)


class Times(NamedTuple):
    """A distribution: times, some only known as upper bounds, and their probability mass."""

    at: Vector
    mass: Vector

    def density(self, at: Floats) -> Floats:
        """Return the kernel density at given times, leaving out observations at exactly these times."""
        some = self.mass > 0.0
        times, mass = self.at[some], self.mass[some]
        low, high = np.quantile(times, (0.25, 0.75))
        width = max(0.05, 0.8 * (high - low) * len(times) ** -0.2)
        found = np.empty(at.shape)
        for row, some_at in zip(found.reshape(-1, at.shape[-1]), at.reshape(-1, at.shape[-1]), strict=True):
            off = np.abs(some_at[:, None] - times)  # of all rows at once it would not fit into the cache
            same = off < 1e-9
            kernel = np.exp(-0.5 * np.square(off / width)) / (width * np.sqrt(2.0 * np.pi))
            kernel[same] = 0.0
            left = np.maximum(mass.sum() - same @ mass, 1e-9) if same.any() else mass.sum()
            row[:] = (1.0 - ANY) * mass.sum() * (kernel @ mass) / left + ANY / ANY_S
        return found

    def drawn(self, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
        """Return random times; mass below all observed times is spread evenly over these."""
        some = self.mass > 0.0
        times, mass = self.at[some], self.mass[some]
        missing = max(0.0, 1.0 - mass.sum())
        chosen = rng.choice(len(mass) + 1, shape, p=np.append(mass, missing) / (mass.sum() + missing))
        return np.where(chosen < len(mass), np.append(times, 0.0)[chosen], rng.uniform(0.0, times.min(), shape))


def part_visits(courses: Sequence[ExecutionVisits], place: str) -> PartVisits:
    """Return the visits of the robot to a place; own work is the 10 % quantile of the standstills."""
    begins = [course.visits["robot"][0].left_s for course in courses]
    some = [[visit for visit in course.visits["robot"][1:] if visit.place == place] for course in courses]
    came, left = np.full((2, len(courses), max(map(len, some), default=0)), np.nan)
    for row, (begin_s, mine) in enumerate(zip(begins, some, strict=True)):
        known = [visit for visit in mine if np.isfinite(visit.left_s - visit.arrived_s)]
        came[row, : len(known)] = [visit.arrived_s - begin_s for visit in known]
        left[row, : len(known)] = [visit.left_s - begin_s for visit in known]
    stays = (left - came)[np.isfinite(left)]
    return PartVisits(came, left, float(np.quantile(stays, 0.1)) if len(stays) else 0.0)
