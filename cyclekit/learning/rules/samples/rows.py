"""Samples to which rules are fitted: positions of robot and operator, and the level commanded by the safety system."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from msgspec import structs

from cyclekit.dataset.time_grid import stretches
from cyclekit.dataset.unknown_height import HUMAN_Z_IN_PLANE
from cyclekit.learning.labelling import commanded_in_time, without_slider
from cyclekit.learning.rules.samples.dated import SCALING, Dating
from cyclekit.learning.rules.samples.distances import DISTANCES, TO_LINK
from cyclekit.learning.rules.samples.earlier import earlier
from cyclekit.learning.rules.samples.links import ANGLES, to_nearest_link
from cyclekit.learning.rules.samples.positions import Positions
from cyclekit.learning.rules.samples.signals import signals_of
from cyclekit.learning.windows import nobody_there
from cyclekit.scaling.commanded import UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Floats, Vector


SURE_S = 0.01
"""Uncertainty of the reaction time, s: this close to a change the commanded level is unknown."""
HIDDEN_S = 1.0
"""Maximum time, s, for which a ramp may hide the level; after longer the position at its change is unknown."""
_COLUMNS = [f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz"]


@dataclass(frozen=True)
class RuleRows:
    """N samples with a known commanded level, ordered by time within each execution.

    Attributes:
        positions: Positions of robot and operator.
        level: Index of the commanded level, shape (N,); k + 0.5 = faster than level k, hidden by a ramp.
        before: Row of the previous sample in the same unbroken stretch, shape (N,); -1 = none.
        execution: Number of the execution, shape (N,).
        at_m: TCP and operator, shape (N, 6), m; NaN without an operator.
        sample: Number of the sample, counted with those of unknown level, shape (N,).
        dated: If the level changed since the row before, and the log shows when: the last time before the change and
            the first after it, as parts of the time between both rows, shape (N, 2); else NaN.
    """

    positions: Positions
    level: NDArray[np.float64]
    before: NDArray[np.int64]
    execution: NDArray[np.int64]
    at_m: NDArray[np.float32]
    sample: NDArray[np.int64]
    dated: Floats

    def __len__(self) -> int:
        """Return N."""
        return len(self.level)

    @property
    def apart_m(self) -> Mapping[str, Vector]:
        """As in `Positions`."""
        return self.positions.apart_m

    @property
    def floor_m(self) -> NDArray[np.float64]:
        """As in `Positions`."""
        return self.positions.floor_m

    @property
    def known(self) -> Bools:
        """Whether the level is known exactly, not only as faster than another, shape (N,)."""
        return np.asarray(self.level % 1.0 == 0.0)

    @property
    def present(self) -> Bools:
        """Whether an operator is present, shape (N,)."""
        return np.isfinite(self.floor_m[:, 0])

    @cached_property
    def noise_m(self) -> float:
        """Standard deviation of the operator's position along one axis, m, from its second differences."""
        second = np.flatnonzero((self.before >= 0) & (self.before[self.before] >= 0) & self.present)
        first = self.before[second]
        off = self.floor_m[second] - 2 * self.floor_m[first] + self.floor_m[self.before[first]]
        off = off[np.isfinite(off[:, 0])]
        return float(1.4826 * np.median(np.abs(off)) / np.sqrt(6)) if len(off) else 0.0

    def of(self, executions: NDArray[np.int64], *, known: bool = False) -> RuleRows:
        """Return the rows of some executions, with `known` only those of known level; stretches stay unbroken."""
        keep = np.isin(self.execution, executions) & (self.known if known else True)
        stretch = np.cumsum(self.before < 0)[keep]
        before = np.where(np.diff(stretch, prepend=-1) == 0, np.arange(len(stretch)) - 1, -1)
        parts = (self.execution[keep], self.at_m[keep], self.sample[keep], self.dated[keep])
        return RuleRows(self.positions.where(keep), self.level[keep], before, *parts)

    def with_link(self, to_link_m: Vector | None) -> RuleRows:
        """Return the rows with the distance of the nearest link, shape (samples,), m; None = unknown."""
        if to_link_m is None:
            return self
        mine = to_link_m[self.sample]
        apart = {**self.apart_m, TO_LINK: np.where(np.isnan(mine), np.inf, mine)}
        return replace(self, positions=replace(self.positions, apart_m=apart))

    @classmethod
    def made(
        cls,
        robot_m: NDArray[np.float64],
        human_m: NDArray[np.float64],
        level: NDArray[np.int64] | NDArray[np.float64],
        execution: NDArray[np.int64],
        *,
        stretch: NDArray[np.int64] | None = None,
        signals: Mapping[tuple[str, float], NDArray[np.str_]] | None = None,
    ) -> RuleRows:
        """Return rows from positions (N, 3), m, and commanded levels (N,), without rows of unknown level (-1).

        Levels that last a single sample are dropped too: no safety system recovers that fast.

        Args:
            robot_m: The TCP.
            human_m: The operator; NaN if absent.
            level: Index of the level, or k + 0.5: faster than level k.
            execution: Number of the execution, shape (N,).
            stretch: Number of the unbroken stretch, shape (N,); None: one per execution.
            signals: As in `Positions`, shape (N,) each.
        """
        of = execution if stretch is None else stretch
        known = (level >= 0) & ~_alone(level, of)
        robot_m, human_m, level = robot_m[known], human_m[known], level[known]
        execution, of = execution[known], of[known]
        apart = {name: distance(robot_m, human_m) for name, distance in DISTANCES.items()}
        apart = {name: np.where(np.isnan(each), np.inf, each) for name, each in apart.items()}
        at = np.arange(len(level))
        before = np.where(np.diff(of, prepend=-1) == 0, at - 1, -1)
        inputs = np.concatenate([robot_m, human_m], axis=1).astype(np.float32)
        values = {name: value[known] for name, value in (signals or {}).items()}
        places = Positions(apart, human_m[:, :2], robot_m[:, :2], values)
        undated = np.full((len(level), 2), np.nan)
        return cls(places, level.astype(np.float64), before, execution, inputs, np.flatnonzero(known), undated)


def rows_of(
    dataset: Dataset, executions: Sequence[str], levels: Sequence[float], *, latency_s: float, signals: bool = False
) -> RuleRows:
    """Return the rows to which rules are fitted.

    Args:
        dataset: Dataset with positions and a scaling.
        executions: Names of the executions to use.
        levels: Levels of the speed scaling, ascending.
        latency_s: Latency of the scaling after the positions, s.
        signals: Include signals to which the level may react.
    """
    frame = dataset.samples(list(executions)).with_columns(human_z_m=HUMAN_Z_IN_PLANE)
    frame, _ = without_slider(dataset, frame)
    run = stretches(frame, dataset.rate_hz)
    response = dataset.card.dynamics
    sure_s = SURE_S if response.ramp_down_per_s or response.ramp_up_per_s else 0.0
    # interpolating positions is more exact than shifting levels by whole samples
    response = structs.replace(response, latency_s=None)
    level = commanded_in_time(dataset, frame, levels, response, sure_s=sure_s, or_faster=True)
    hidden = frame.select(pl.col("human_x_m").is_null() & ~nobody_there()).to_series().to_numpy()
    level[hidden | frame["robot_x_m"].is_null().to_numpy()] = -1
    places = frame.select(pl.col(_COLUMNS).fill_null(float("nan"))).to_numpy()
    t_s = frame["t_s"].to_numpy()
    seen_s = t_s - latency_s
    if latency_s:
        places, early = earlier(places, t_s, run, latency_s)
        level[early] = -1
    names = frame["execution"].to_numpy()
    order = {name: number for number, name in enumerate(executions)}
    number = frame["execution"].replace_strict(order, return_dtype=pl.Int64).to_numpy()
    said = signals_of(dataset, executions, frame, level, run) if signals else None
    known = run + hidden_for_long(level >= 0, t_s)
    level = np.where(level < UNKNOWN, -1.5 - level, level)
    rows = RuleRows.made(places[:, :3], places[:, 3:], level, number, stretch=known, signals=said)
    dating = Dating(rows, t_s, levels, response)

    def log_of(name: str) -> pl.DataFrame | None:
        log = dataset.native_robot(name, SCALING, if_there=ANGLES)
        dating.read(order[name], log)  # both on the way: reading a log takes longer than this
        return log

    to_link = to_nearest_link(dataset, names, seen_s, places[:, :3], places[:, 3:], log_of)
    dating.read_rest(dataset, executions)
    return replace(rows.with_link(to_link), dated=dating.found)


def hidden_for_long(known: Bools, t_s: Vector) -> NDArray[np.int64]:
    """Return how often the level was unknown for longer than HIDDEN_S before each row, shape (N,)."""
    at = np.flatnonzero(known)
    after = np.zeros(len(known), np.int64)
    after[at[1:][np.diff(t_s[at]) > HIDDEN_S]] = 1
    return np.cumsum(after)


def _alone(level: NDArray[np.int64] | NDArray[np.float64], stretch: NDArray[np.int64]) -> Bools:
    """Return where a row differs from two equal rows before and two after it, shape (N,)."""
    found = np.zeros(len(level), np.bool_)
    if len(level) < 5:
        return found
    seen = np.lib.stride_tricks.sliding_window_view(level, 5)
    around = (seen[:, :1] == seen[:, [1, 3, 4]]).all(axis=1) & (stretch[:-4] == stretch[4:])
    found[2:-2] = around & (seen[:, 2] != seen[:, 0])
    return found
