"""Samples of a scaling without levels: distances at earlier times, and rows limited by a ramp."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.time_grid import stretches
from cyclekit.dataset.unknown_height import HUMAN_Z_IN_PLANE
from cyclekit.learning.labelling import without_slider
from cyclekit.learning.rules.samples.distances import DISTANCES, TO_LINK
from cyclekit.learning.rules.samples.earlier import earlier
from cyclekit.learning.rules.samples.links import to_nearest_link
from cyclekit.scaling.transitions import RampRates

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Vector

BOUND = 0.02
"""Tolerance within which a scaling counts as being at its lowest or highest value."""
NARROW, MAX_VALUES = 0.01, 10
"""Bin width, and number of bins whose values count as levels."""
CONTINUOUS = 0.15
"""Minimum share of time between the bounds outside of these levels, for a continuous scaling."""
MIN_ROWS = 100
"""Minimum number of rows between the bounds."""
_PILE, _BANDS, _PILED = 0.02, 5, 2.5
"""A common rate: relative tolerance, number of bands of this width below it, and minimum ratio of its count to the mean
count of a band."""
_FASTER = 0.02
_MIN_RAMP = 30
_MIN_PER_S = 0.02


@dataclass(frozen=True)
class LawRows:
    """N samples with a known scaling, ordered by time within each stretch.

    Attributes:
        t_s: Session time, shape (N,), s.
        scaling: Logged scaling divided by the operator's slider, shape (N,).
        run: Number of the unbroken stretch, shape (N,).
        execution: Number of the execution, shape (N,).
        apart_m: Distances by name, shape (N,) each, m; NaN without an operator.
        at_m: TCP and operator, shape (N, 6), m; NaN without an operator.
    """

    t_s: Vector
    scaling: Vector
    run: NDArray[np.int64]
    execution: NDArray[np.int64]
    apart_m: Mapping[str, Vector]
    at_m: NDArray[np.float64]

    def __len__(self) -> int:
        """Return N."""
        return len(self.t_s)

    @property
    def rate_per_s(self) -> Vector:
        """Change of the scaling since the previous row, shape (N,), 1/s; 0 without one."""
        same = np.diff(self.run, prepend=-1) == 0
        step_s = np.diff(self.t_s, prepend=0.0)
        return np.where(same, np.diff(self.scaling, prepend=0.0) / np.where(same, step_s, 1.0), 0.0)

    def of(self, executions: NDArray[np.int64], *, others: bool = False) -> LawRows:
        """Return the rows of some executions, or of the others."""
        keep = np.isin(self.execution, executions, invert=others)
        apart = {name: values[keep] for name, values in self.apart_m.items()}
        return LawRows(self.t_s[keep], self.scaling[keep], self.run[keep], self.execution[keep], apart, self.at_m[keep])

    def earlier(self, values: Vector, by_s: float) -> Vector:
        """Return values (N,) as they were `by_s` earlier, shape (N,); NaN before the start of the stretch."""
        if by_s <= 0.0:
            return values
        moved, early = earlier(values, self.t_s, self.run, by_s)
        return np.where(early, np.nan, moved)


def law_rows(dataset: Dataset, executions: Sequence[str]) -> LawRows | None:
    """Return the samples of some executions with a known scaling; None if the scaling has levels."""
    frame = dataset.samples(list(executions)).with_columns(human_z_m=HUMAN_Z_IN_PLANE)
    frame, _ = without_slider(dataset, frame)
    run = stretches(frame, dataset.rate_hz)
    known = frame["scaling"].is_not_null().to_numpy()
    frame, run = frame.filter(pl.Series(known)), run[known]
    columns = [f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz"]
    places = frame.select(pl.col(columns).fill_null(float("nan"))).to_numpy()
    robot_m, human_m, t_s = places[:, :3], places[:, 3:], frame["t_s"].to_numpy()
    apart = {name: distance(robot_m, human_m) for name, distance in DISTANCES.items()}
    order = {name: number for number, name in enumerate(executions)}
    number = frame["execution"].replace_strict(order, return_dtype=pl.Int64).to_numpy()
    rows = LawRows(t_s, frame["scaling"].to_numpy(), run.astype(np.int64), number, apart, places)
    if not is_continuous(rows):
        return None
    to_link = to_nearest_link(dataset, frame["execution"].to_numpy(), t_s, robot_m, human_m)
    return rows if to_link is None else replace(rows, apart_m={**apart, TO_LINK: to_link})


def limited(rows: LawRows, rates: RampRates, *, rises: bool) -> Bools:
    """Return the rows at the start or end of a ramp in one direction, shape (N,)."""
    rate = rates.of(rises=rises)
    if rate is None:
        return np.zeros(len(rows), np.bool_)
    fast = (rows.rate_per_s if rises else -rows.rate_per_s) >= (1 - _PILE) * rate
    return np.asarray(fast | np.append(fast[1:], False))


def resting_rates(rows: LawRows) -> RampRates:
    """Return the ramp rates that limit the scaling: the fastest rates, if many rows share them."""
    rate = rows.rate_per_s
    return RampRates(_piled(-rate[rate < -_MIN_PER_S]), _piled(rate[rate > _MIN_PER_S]))


def _piled(rate: Vector) -> float | None:
    """Return the maximum of rates (N,), 1/s, if many more rows share it than slightly lower rates; else None."""
    if len(rate) < _MIN_RAMP:
        return None
    fast = float(np.quantile(rate, 1 - _FASTER))
    mine = np.abs(rate / fast - 1) <= _PILE
    beside = (rate < (1 - _PILE) * fast) & (rate >= (1 - 2 * _PILE * (1 + _BANDS)) * fast)
    if mine.sum() < max(_MIN_RAMP, _PILED * beside.sum() / _BANDS):
        return None
    return float(np.median(rate[mine])) if (rate > (1 + 2 * _PILE) * fast).mean() <= _FASTER / 2 else None


def resting(rows: LawRows, ramps: RampRates) -> Bools:
    """Return the rows in which no ramp hides the command, shape (N,)."""
    return ~(limited(rows, ramps, rises=False) | limited(rows, ramps, rises=True))


def is_continuous(rows: LawRows) -> bool:
    """Return whether the scaling, outside of ramps, takes many values between its bounds."""
    rest = rows.scaling[resting(rows, resting_rates(rows))]
    if not len(rest):
        return False
    between = rest[(rest > rest.min() + BOUND) & (rest < rest.max() - BOUND)]
    if len(between) < MIN_ROWS:
        return False
    counts = np.sort(np.bincount((between / NARROW).round().astype(np.int64).clip(min=0)))[::-1]
    return float(counts[MAX_VALUES:].sum()) > CONTINUOUS * len(between)
