"""Samples as arrays for the search for causes: scaling, places, operator, and states of signals."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.derive.concatenated import shifts_apart
from cyclekit.scaling.infer.override import HALTED as HALTED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.schema import Bools, Floats, Ints, Points, Vector

HELD, AROUND = 0.02, 3
"""Maximum range of the scaling at a held level, from AROUND samples before to AROUND after."""
SAME = 0.03
"""Tolerance for equal scalings; three standard deviations where the scaling is inferred."""
STEP_M = 0.05
"""Grid size of places along a path, m."""
DISTANCES = 2
"""Number of distances, which are the first features."""
FAR_M = 99.0
MARGIN_S = 60.0
"""Time before the first and after the last sample, s, for which the signals of a session are kept."""
UNSEEN_S = 5.0
"""Maximum time, s, for which a lost operator is assumed to be at the last position seen."""


class TwoStateSignal(NamedTuple):
    """A two-state signal: state `on`, shape (N,), from the times `t_s`, shape (N,), ascending."""

    t_s: Vector
    on: Bools

    def at(self, t_s: Vector) -> Bools:
        """Return the state at times (M,); before the first change, it is the opposite of the first state."""
        number = np.searchsorted(self.t_s, t_s, side="right") - 1
        return np.asarray(np.where(number >= 0, self.on[np.maximum(number, 0)], ~self.on[0]))

    def within(self, t_s: Vector, past_s: float, *, on: bool) -> Bools:
        """Return whether it was in state `on` at any time in the `past_s` seconds up to times (M,)."""
        now, then = (np.searchsorted(self.t_s, t - shift, side="right") - 1 for t, shift in ((t_s, 0.0), (t_s, past_s)))
        return np.asarray((self.at(t_s) == on) | (self.at(t_s - past_s) == on) | (now - then > 1))

    def during(self, first_s: float, last_s: float) -> TwoStateSignal:
        """Return the signal from `first_s` to `last_s`: a log of events may be of many sessions."""
        here = (self.t_s > first_s) & (self.t_s <= last_s)
        first = self.at(np.array([first_s]))
        return TwoStateSignal(np.append(first_s, self.t_s[here]), np.append(first, self.on[here]))

    def held(self, more_s: float) -> TwoStateSignal:
        """Return the signal with each stretch in state on `more_s` longer; stretches that then meet are one."""
        changed = np.concatenate([[0], np.flatnonzero(np.diff(self.on)) + 1])
        t_s, on = self.t_s[changed], self.on[changed]
        later_s = np.where(on, t_s, t_s + more_s)
        later_s[0] = t_s[0]  # no change, the first state
        meet = np.flatnonzero(~on[:-1] & (t_s[1:] <= later_s[:-1]))
        kept = np.setdiff1d(np.arange(len(on)), np.concatenate([meet, meet + 1]))
        return TwoStateSignal(later_s[kept], on[kept])


@dataclass(frozen=True)
class Rows:
    """N samples in order of time, from one session or from several concatenated ones.

    Attributes:
        t_s: Time, shape (N,); times of different sessions do not overlap.
        execution: Number of the execution, shape (N,).
        task: Index into `tasks`, shape (N,), -1 = none.
        tasks: Names of the robot's tasks.
        robot_m, human_m: Positions, shape (N, 3), m, NaN = unknown.
        absent: Whether no operator was present, shape (N,).
        moving: Whether the robot is moving to its goal, shape (N,).
        scaling, deviation: Speed scaling and its standard deviation, shape (N,), NaN = unknown.
        step: Index of the level, shape (N,), -1 = none.
        breaks: Whether there is a gap before the sample, shape (N,).
        switches: Two-state signals.
    """

    t_s: Vector
    execution: Ints
    task: Ints
    tasks: tuple[str, ...]
    robot_m: Points
    human_m: Points
    absent: Bools
    moving: Bools
    scaling: Vector
    deviation: Vector
    step: Ints
    breaks: Bools
    switches: Mapping[str, TwoStateSignal]

    @property
    def held(self) -> Bools:
        """Whether the scaling is held around each sample, shape (N,)."""
        padded = np.pad(self.scaling, AROUND, constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.nan_to_num(windows.max(axis=1) - windows.min(axis=1), nan=1.0) <= HELD)


def rows_of(samples: pl.DataFrame, switches: Mapping[str, TwoStateSignal]) -> Rows:
    """Return rows of table SAMPLES as arrays."""
    t_s = samples["t_s"].to_numpy()
    period_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.1
    other = (samples["execution"] != samples["execution"].shift(1)).fill_null(value=True).to_numpy()
    names = samples["robot_task"].drop_nulls().unique(maintain_order=True).to_list()
    return Rows(
        t_s=t_s,
        execution=np.cumsum(other),
        task=_numbered(samples["robot_task"], names),
        tasks=tuple(names),
        robot_m=_places(samples, "robot"),
        human_m=_places(_filled(samples, round(UNSEEN_S / period_s)), "human"),
        absent=(samples["human_gap"] == "absent").fill_null(value=False).to_numpy(),
        moving=samples["robot_moving"].fill_null(value=False).to_numpy(),
        scaling=_floats(samples, "scaling"),
        deviation=_floats(samples, "scaling_sd"),
        step=samples["step"].fill_null(-1).cast(pl.Int64).to_numpy(),
        breaks=other | (np.diff(t_s, prepend=-np.inf) > 1.5 * period_s),
        switches=switches,
    )


def joined(parts: Sequence[Rows]) -> Rows:
    """Return several parts concatenated: times, executions and signals of each follow those before."""
    names = list(dict.fromkeys(name for part in parts for name in part.tasks))
    executions, shifted = 0, list[Rows]()
    told: dict[str, list[TwoStateSignal]] = {}
    shifts = shifts_apart((float(part.t_s[0]), float(part.t_s[-1])) for part in parts)
    for part, shift in zip(parts, shifts, strict=True):
        number = np.array([names.index(name) for name in part.tasks] + [-1])
        for name, every in part.switches.items():
            switch = every.during(float(part.t_s[0]) - MARGIN_S, float(part.t_s[-1]) + MARGIN_S)
            first_s = min(float(switch.t_s[0]), float(part.t_s[0])) - 1.0  # before that, the opposite state
            told.setdefault(name, []).append(
                TwoStateSignal(np.append(first_s, switch.t_s) + shift, np.append(~switch.on[0], switch.on))
            )
        execution = part.execution + executions
        shifted.append(replace(part, t_s=part.t_s + shift, execution=execution, task=number[part.task]))
        executions = int(execution[-1])
    arrays = {
        one.name: np.concatenate([getattr(part, one.name) for part in shifted])
        for one in fields(Rows)
        if one.name not in ("tasks", "switches")
    }
    both = {
        name: TwoStateSignal(*(np.concatenate(column) for column in zip(*mine, strict=True)))
        for name, mine in told.items()
    }
    return Rows(**arrays, tasks=tuple(names), switches=both)


def features_of(rows: Rows, watching: Sequence[str]) -> tuple[Floats, Bools]:
    """Return the features of a slow-down by people, shape (N, F), and where all are known, shape (N,).

    Features are the distances from robot to operator (in space and on the floor), the operator's position, and the
    signals that watch the operator. An absent operator is FAR_M away. If no operator position is known at all, the
    signals are combined with the robot's position (`signal_position_features`).
    """
    seen = np.isfinite(rows.human_m[:, :2]).all(axis=1) & np.isfinite(rows.robot_m).all(axis=1) & ~rows.absent
    way = rows.human_m - rows.robot_m
    way[:, 2] = np.nan_to_num(way[:, 2])  # a planar tracker
    flat = np.linalg.norm(way[:, :2], axis=1)
    columns = [np.linalg.norm(way, axis=1), flat, rows.human_m[:, 0], rows.human_m[:, 1]]
    bits = [rows.switches[name].at(rows.t_s) if name in rows.switches else np.zeros(len(seen)) for name in watching]
    by_signals = bool(watching) and not np.isfinite(rows.human_m).any()
    robot = [signal_position_features(np.nan_to_num(rows.robot_m[:, :2]), bits)] if by_signals else []
    features = np.column_stack([*(np.where(seen, column, FAR_M) for column in columns), *bits, *robot])
    return features, np.asarray(np.isfinite(rows.robot_m).all(axis=1) if by_signals else seen | rows.absent)


def signal_position_features(place: Floats, on: Sequence[Vector | Bools]) -> Floats:
    """Return the robot's position, and per signal its position while the signal is on, else -FAR_M and +FAR_M.

    With these features, a single cut can express that a signal is on and the robot is in a region.

    Args:
        place: Position of the robot, shape (N, 2), m.
        on: State of each signal, shape (N,).

    Returns:
        Features, shape (N, 2 + 4 * signals).
    """
    there = [np.where(np.asarray(state, np.bool_)[:, None], place, away) for state in on for away in (-FAR_M, FAR_M)]
    return np.column_stack([place, *there])


def _numbered(values: pl.Series, names: Sequence[str]) -> Ints:
    number = {name: i for i, name in enumerate(names)}
    return np.array([number.get(value, -1) for value in values.to_list()], np.int64)


def _filled(samples: pl.DataFrame, most: int) -> pl.DataFrame:
    """Fill short gaps in the operator's position with the last known one."""
    axes = [f"human_{axis}_m" for axis in "xyz"]
    lost = pl.col("human_gap") == "occluded"
    return samples.select(pl.when(lost).then(pl.col(axes).forward_fill(limit=most)).otherwise(pl.col(axes)))


def _places(samples: pl.DataFrame, whose: str) -> Points:
    return np.column_stack([_floats(samples, f"{whose}_{axis}_m") for axis in "xyz"])


def _floats(samples: pl.DataFrame, name: str) -> Vector:
    return np.array(samples[name].cast(pl.Float64).to_numpy())  # null becomes NaN
