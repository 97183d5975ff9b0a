"""Samples as arrays for the search for causes: scaling, places, operator, and which signals were on."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.schema import Bools, Floats, Ints, Points, Vector

HALTED = 0.02
"""Scaling at or below this is a standstill."""
HELD, AROUND = 0.02, 3
"""A level is held where the scaling changes by no more than this from AROUND samples before to AROUND after."""
DISTANCES = 2
"""So many of the features, the first, are distances."""
FAR_M = 99.0
_APART_S = 1e5
UNSEEN_S = 5.0
"""An operator lost for no longer than this is near where they were last seen."""


class Switches(NamedTuple):
    """A signal of two states: it is `on` (N,) from the times `t_s` (N,), ascending, on."""

    t_s: Vector
    on: Bools

    def at(self, t_s: Vector) -> Bools:
        """Return its state at times (M,); before its first change it was in the other one."""
        number = np.searchsorted(self.t_s, t_s, side="right") - 1
        return np.asarray(np.where(number >= 0, self.on[np.maximum(number, 0)], ~self.on[0]))

    def within(self, t_s: Vector, past_s: float, *, on: bool) -> Bools:
        """Tell whether it was in a state at some time in the last `past_s` seconds before times (M,)."""
        now, then = (np.searchsorted(self.t_s, t - shift, side="right") - 1 for t, shift in ((t_s, 0.0), (t_s, past_s)))
        return np.asarray((self.at(t_s) == on) | (self.at(t_s - past_s) == on) | (now - then > 1))


@dataclass(frozen=True)
class Rows:
    """N samples, in the order of time, of one session or of several one after the other.

    Attributes:
        t_s: Time, shape (N,); of several sessions apart from each other.
        execution: Number of the execution, shape (N,).
        task: Number in `tasks`, shape (N,), -1 = none.
        tasks: Names of the robot's tasks.
        robot_m, human_m: Shape (N, 3), NaN = unknown.
        absent: Nobody was there, shape (N,).
        moving: The robot is on its way, shape (N,).
        scaling, deviation: Shape (N,), NaN = unknown.
        step: Index of the level, shape (N,), -1 = none.
        breaks: A sample does not follow the one before it, shape (N,).
        switches: Signals of two states.
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
    switches: Mapping[str, Switches]

    @property
    def held(self) -> Bools:
        """Whether the scaling is held around each sample, shape (N,)."""
        padded = np.pad(self.scaling, AROUND, constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.nan_to_num(windows.max(axis=1) - windows.min(axis=1), nan=1.0) <= HELD)


def rows_of(samples: pl.DataFrame, switches: Mapping[str, Switches]) -> Rows:
    """Return samples of table SAMPLES as arrays."""
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
    """Return several as one: times, executions and signals of each follow those before."""
    names = list(dict.fromkeys(name for part in parts for name in part.tasks))
    shift_s, executions, shifted = 0.0, 0, list[Rows]()
    told: dict[str, list[Switches]] = {}
    for part in parts:
        shift, number = shift_s - float(part.t_s[0]), np.array([names.index(name) for name in part.tasks] + [-1])
        for name, switch in part.switches.items():
            first_s = min(float(switch.t_s[0]), float(part.t_s[0])) - 1.0  # before it, it was in the other state
            told.setdefault(name, []).append(
                Switches(np.append(first_s, switch.t_s) + shift, np.append(~switch.on[0], switch.on))
            )
        execution, t_s = part.execution + executions, part.t_s + shift
        shifted.append(replace(part, t_s=t_s, execution=execution, task=number[part.task]))
        shift_s, executions = float(t_s[-1]) + _APART_S, int(execution[-1])
    arrays = {
        one.name: np.concatenate([getattr(part, one.name) for part in shifted])
        for one in fields(Rows)
        if one.name not in ("tasks", "switches")
    }
    both = {
        name: Switches(*(np.concatenate(column) for column in zip(*mine, strict=True))) for name, mine in told.items()
    }
    return Rows(**arrays, tasks=tuple(names), switches=both)


def features_of(rows: Rows, watching: Sequence[str]) -> tuple[Floats, Bools]:
    """Return what a slow-down by people may depend on, shape (N, F), and where all of that is known, shape (N,).

    Those are distances from robot to operator (in space and on the floor), where the operator is, and the signals that
    watch the operator. Nobody is FAR_M away. Where no position of an operator is known at all, the signals tell it all,
    and how they count depends on where the robot is.
    """
    seen = np.isfinite(rows.human_m[:, :2]).all(axis=1) & np.isfinite(rows.robot_m).all(axis=1) & ~rows.absent
    way = rows.human_m - rows.robot_m
    way[:, 2] = np.nan_to_num(way[:, 2])  # a planar tracker
    flat = np.linalg.norm(way[:, :2], axis=1)
    columns = [np.linalg.norm(way, axis=1), flat, rows.human_m[:, 0], rows.human_m[:, 1]]
    bits = [rows.switches[name].at(rows.t_s) if name in rows.switches else np.zeros(len(seen)) for name in watching]
    by_signals = bool(watching) and not np.isfinite(rows.human_m).any()
    robot = [counting(np.nan_to_num(rows.robot_m[:, :2]), bits)] if by_signals else []
    features = np.column_stack([*(np.where(seen, column, FAR_M) for column in columns), *bits, *robot])
    return features, np.asarray(np.isfinite(rows.robot_m).all(axis=1) if by_signals else seen | rows.absent)


def counting(place: Floats, on: Sequence[Vector | Bools]) -> Floats:
    """Return where the robot is, (N, 2), m, and where it is while each signal is on, beside FAR_M on either side.

    Of these features, shape (N, 2 + 4 * signals), one cut tells that a signal is on and the robot in a region.
    """
    there = [np.where(np.asarray(state, np.bool_)[:, None], place, away) for state in on for away in (-FAR_M, FAR_M)]
    return np.column_stack([place, *there])


def _numbered(values: pl.Series, names: Sequence[str]) -> Ints:
    number = {name: i for i, name in enumerate(names)}
    return np.array([number.get(value, -1) for value in values.to_list()], np.int64)


def _filled(samples: pl.DataFrame, most: int) -> pl.DataFrame:
    """Fill where the operator was lost for a short time."""
    axes = [f"human_{axis}_m" for axis in "xyz"]
    lost = pl.col("human_gap") == "occluded"
    return samples.select(pl.when(lost).then(pl.col(axes).forward_fill(limit=most)).otherwise(pl.col(axes)))


def _places(samples: pl.DataFrame, whose: str) -> Points:
    return np.column_stack([_floats(samples, f"{whose}_{axis}_m") for axis in "xyz"])


def _floats(samples: pl.DataFrame, name: str) -> Vector:
    return np.array(samples[name].cast(pl.Float64).fill_null(np.nan).to_numpy())
