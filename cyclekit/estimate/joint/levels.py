"""The levels that choose what each cycle draws; those of one operator's durations move together in a cycle.

A level in (0, 1) chooses a duration by its rank. The levels of durations that share a part have normal scores that
correlate (a Gaussian copula): each duration keeps its distribution, and a slow cycle is slow throughout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np
from scipy.special import ndtri

from cyclekit.learning.coupling.pace.common_pace import MAX_SHARE
from cyclekit.learning.coupling.pace.pace import OUTLIER

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import CommonPaceCard
    from cyclekit.schema import Ints, Vector

WORK, WALK = "pace of work", "pace of walks"
"""Keys of what works share, and walks."""


class Levels:
    """Levels for the cycles of a question: spread evenly over them, and shuffled by key.

    Attributes:
        scores: The normal scores of the levels, ascending, shape (count,).
    """

    def __init__(self, seed: int, count: int, common: CommonPaceCard | None = None) -> None:
        """Set the seed, the number of cycles and what durations of one cycle share; None: nothing."""
        self._seed, self._count, self._common = seed, count, common
        self.scores = ndtri((np.arange(count) + 0.5) / count).astype(np.float32).astype(np.float64)  # as on the page
        self._shared: dict[str, Vector] = {}

    def of(self, key: str, turn: int) -> Vector:
        """Return a level for each cycle, shape (count,), independent of those of other keys and turns."""
        return (self._number(key, turn) + 0.5) / self._count

    def alike(self, key: str, turn: int, share: float, kind: str = WORK) -> Vector:
        """Return levels whose normal scores correlate by `share` with what a kind of durations shares, (count,)."""
        if not share:
            return self.of(key, turn)
        scores = share * self.shared(kind) + (1.0 - share**2) ** 0.5 * self.scores[self._number(key, turn)]
        rank = np.empty(self._count)
        rank[np.argsort(scores, kind="stable")] = np.arange(self._count)
        return (rank + 0.5) / self._count

    def shared(self, kind: str) -> Vector:
        """Return the normal scores of what a kind of durations shares in each cycle, shape (count,)."""
        if kind not in self._shared:
            mine = self.scores[self._number(kind, 0)]
            if kind == WALK and self._common is not None and self._common.work:
                both = self._common.together
                mine = both * self.shared(WORK) + (1.0 - both**2) ** 0.5 * mine
            self._shared[kind] = mine
        return self._shared[kind]

    @property
    def main(self) -> Vector:
        """The normal scores of what works share; of what walks share where works share nothing; shape (count,)."""
        return self.shared(WALK if self.in_walks and self._common is not None and not self._common.work else WORK)

    @property
    def in_walks(self) -> bool:
        """Whether walks share something."""
        return self._common is not None and self._common.walk > 0.0

    def share_of(self, values: Vector, kind: str) -> float:
        """Return the correlation of durations with what their kind shares, from their logarithm's spread.

        Args:
            values: Quantiles, or all of the durations, shape (N,), s.
            kind: WORK or WALK.
        """
        spread = 0.0 if self._common is None else self._common.work if kind == WORK else self._common.walk
        middle = float(np.median(values)) if spread else 0.0
        if middle <= 0.0:
            return 0.0
        own = float(np.log(np.clip(values / middle, 1.0 / OUTLIER, OUTLIER)).std())
        return round(min(spread / own, MAX_SHARE), 3) if own > 1e-6 else 0.0  # the page has rounded quantiles

    def _number(self, key: str, turn: int) -> Ints:
        rng = np.random.default_rng([self._seed, crc32(key.encode()), turn])
        return np.asarray(rng.permutation(self._count))
