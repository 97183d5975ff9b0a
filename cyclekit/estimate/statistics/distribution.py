"""The predictive distribution of single cycles: every quantile, share within a takt, band and comparison is read here.

It consists of equally probable cycles: the simulated ones, spread as logged executions scatter about their rollouts.
The share of cycles up to a quantile is that quantile's level, as both are the same line: `quantile` inverts `share`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from cyclekit.estimate.statistics.conformal import conformal

if TYPE_CHECKING:
    from cyclekit.schema import Floats, Vector


@dataclass(frozen=True, eq=False)
class CycleDistribution:
    """Single cycles of one sequence, equally probable, and what is uncertain about them.

    Attributes:
        cycles_s: The cycles, shape (K,), in any order, s.
        weights: Their weights in each resample of the logs, shape (R, K); None: finite logs are in `errors`.
        errors: Error of all cycles in each resample, as a share, shape (R,); None: none.
        bias: Possible bias of all cycles to either side, as a share.
        less_s, more_s: Shifts of all cycles that are possible, s, at most and at least 0: cycles shorter than the
            median count as shorter by the first, longer ones as longer by the second.
        executions: Number of logged executions behind them.
        also: Distributions that are possible too; intervals cover them.
    """

    cycles_s: Vector
    weights: Floats | None = None
    errors: Vector | None = None
    bias: float = 0.0
    less_s: float = 0.0
    more_s: float = 0.0
    executions: int = 0
    also: tuple[CycleDistribution, ...] = ()

    @property
    def single_s(self) -> Vector:
        """The cycles, ascending, wider by the shifts, shape (K,), s."""
        off = self.cycles_s - np.median(self.cycles_s)
        return np.sort(self.cycles_s + np.where(off < 0.0, self.less_s, np.where(off > 0.0, self.more_s, 0.0)))

    def __eq__(self, other: object) -> bool:
        """Return whether the cycles are the same."""
        return isinstance(other, CycleDistribution) and np.array_equal(self.single_s, other.single_s)

    def __hash__(self) -> int:
        """Return a hash of the cycles."""
        return hash(self.cycles_s.tobytes())

    def quantile(self, level: float) -> float:
        """Return the time, s, that a new cycle does not exceed with probability `level`, in (0, 1)."""
        return conformal(self.single_s, level)

    def share(self, until_s: float) -> float:
        """Return the share of cycles that take at most `until_s`, s."""
        ordered = self.single_s
        levels = np.arange(1, len(ordered) + 1) / (len(ordered) + 1)
        last = np.searchsorted(ordered, until_s, side="right")  # of equal cycles the last
        if last in (0, len(ordered)):
            return float(last > 0)
        below, above = ordered[last - 1], ordered[last]
        return float(levels[last - 1] + (until_s - below) / (above - below) * (levels[last] - levels[last - 1]))

    def within(self, takt_s: float, confidence: float = 0.95) -> tuple[float, float, float]:
        """Return the share of cycles within a takt, and its interval at a confidence in [0, 1).

        It is no narrower than Wilson's interval of so many executions, and covers every distribution in `also`.
        """
        low, high = self._interval(takt_s, (1.0 - confidence) / 2.0)
        for other in self.also:
            _, least, most = other.within(takt_s, confidence)
            low, high = min(low, least), max(high, most)
        share = self.share(takt_s)
        least, most = wilson(share, self.executions or len(self.cycles_s), confidence)
        return share, max(min(low, least), 0.0), min(max(high, most), 1.0)

    def shifted(self, less_s: float, more_s: float) -> CycleDistribution:
        """Return it wider by further shifts, s."""
        return replace(self, less_s=self.less_s + less_s, more_s=self.more_s + more_s)

    def _interval(self, takt_s: float, tail: float) -> tuple[float, float]:
        ordered = np.argsort(self.cycles_s)
        cycles_s = self.cycles_s[ordered]
        upto = np.arange(len(cycles_s) + 1)[None] / len(cycles_s)
        if self.weights is not None:
            none = np.zeros((len(self.weights), 1))
            upto = np.concatenate([none, np.cumsum(self.weights[:, ordered], axis=1)], axis=1)
        off = np.zeros(len(upto)) if self.errors is None else self.errors
        every = np.arange(len(off)) if len(upto) > 1 else 0
        found = []
        for shift_s, bias, part in ((self.more_s, self.bias, tail), (self.less_s, -self.bias, 1.0 - tail)):
            longest = (takt_s - shift_s) / ((1.0 + bias) * np.maximum(1.0 + off, 1e-9))
            shares = upto[every, np.searchsorted(cycles_s, longest, side="right")]
            found.append(float(np.quantile(shares, part)))
        return found[0], found[1]


def wilson(share: float, count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return Wilson's interval, at a confidence in [0, 1), of a share that was counted in `count` cases."""
    count, z = max(count, 1), float(ndtri(0.5 + confidence / 2.0))
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z * np.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2) / (1 + z**2 / count)
    low, high = max(float(middle - half), 0.0), min(float(middle + half), 1.0)
    return low if share > 0.0 else 0.0, high if share < 1.0 else 1.0  # exactly, whatever the rounding
