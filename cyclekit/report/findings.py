"""Findings from the logs of a dataset: a few numbers and small arrays that fit on a page.

All of it is computed from samples and tasks; only the model that is passed in makes predictions. `charts` and the
template set the look.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import polars as pl

from cyclekit.dataset.unknown_height import HUMAN_Z_IN_PLANE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards import TrainingCard
    from cyclekit.dataset.dataset import Dataset

FULL = 0.98
"""Scaling from here on counts as full speed."""

DISTANCE_BIN_M = 0.05
SCALING_BIN = 0.05
_PARTS = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")


class Predicts(Protocol):
    """The part of a trained model that the report uses."""

    @property
    def problem(self) -> str:
        """Problem that the model was trained for: `now`, or one ahead in time."""
        ...

    @property
    def network(self) -> str:
        """Kind of network."""
        ...

    @property
    def card(self) -> TrainingCard:
        """Training record with its metrics."""
        ...

    def predict(self, X: NDArray[np.floating[Any]], /) -> NDArray[np.floating[Any]]:
        """Speed scaling (N,) for robot and operator positions (N, 6)."""
        ...


class Judged(Protocol):
    """The part of an evaluation that the report uses: its numbers as JSON values."""

    def to_dict(self) -> dict[str, object]:
        """`mse` (rows of name, mse, note), `accuracy`, `confusion` (logged x predicted), `levels`; all optional."""
        ...


@dataclass(frozen=True)
class Share:
    """Mean seconds of one task, split, and how often it was seen (0 for an estimate)."""

    name: str
    nominal_s: float
    safety_s: float
    dwell_s: float
    wait_s: float
    seen: int = 0

    @property
    def total_s(self) -> float:
        """Mean duration of the task, s."""
        return self.nominal_s + self.safety_s + self.dwell_s + self.wait_s


@dataclass(frozen=True)
class Overview:
    """Summary of the logs.

    Attributes:
        executions, complete: Number of executions, and of complete ones.
        duration_s: Durations of the complete executions, shape (E,), s.
        slowed: Fraction of the robot's moving time below full speed; None where unknown.
        halted: The same at scaling 0.
        operator_seen: Fraction of all samples with an operator position.
        lost_s: Mean safety loss per complete execution; None where unknown.
        inferred: Fraction of known scaling that is inferred, not logged.
    """

    executions: int
    complete: int
    duration_s: NDArray[np.float64]
    slowed: float | None
    halted: float | None
    operator_seen: float
    lost_s: float | None
    inferred: float


@dataclass(frozen=True)
class Band:
    """One speed level and its distances: 90 % of its samples lie between low and high."""

    scaling: float
    low_m: float
    high_m: float
    samples: int


@dataclass(frozen=True)
class LoggedResponse:
    """Scaling against distance, from samples in which the robot was moving and both positions were known.

    Attributes:
        cells: Samples per distance bin and scaling bin: centre in m, centre in scaling, count; shape (K, 3).
        bin_m: Centres of the distance bins, shape (B,).
        logged, predicted: Mean scaling per bin, shape (B,); `predicted` is None without a model of problem `now`.
        bands: One per level.
        explained: Part of the variance of scaling that distance alone explains, in [0, 1].
        samples: Number of samples used.
    """

    cells: NDArray[np.float64]
    bin_m: NDArray[np.float64]
    logged: NDArray[np.float64]
    predicted: NDArray[np.float64] | None
    bands: tuple[Band, ...]
    explained: float
    samples: int


def overview(dataset: Dataset, samples: pl.DataFrame, tasks: pl.DataFrame) -> Overview:
    """Count what the logs hold."""
    runs = dataset.executions
    complete = runs.filter(pl.col("complete"))
    moving = samples.filter(pl.col("robot_moving") & pl.col("scaling").is_not_null())
    known = samples["scaling"].count()
    lost = None
    mine = tasks.join(complete.select("execution"), on="execution", how="semi")
    if complete.height and mine["safety_loss_s"].count():
        lost = float(mine["safety_loss_s"].sum()) / complete.height
    return Overview(
        executions=runs.height,
        complete=complete.height,
        duration_s=complete["duration_s"].to_numpy().astype(np.float64),
        slowed=float((moving["scaling"] < FULL).sum()) / moving.height if moving.height else None,
        halted=float((moving["scaling"] < 0.01).sum()) / moving.height if moving.height else None,
        operator_seen=samples["human_x_m"].count() / samples.height if samples.height else 0.0,
        lost_s=lost,
        inferred=samples.filter(pl.col("scaling_origin") == "inferred").height / known if known else 0.0,
    )


def task_shares(tasks: pl.DataFrame) -> list[Share]:
    """Return the mean split of every logged task, the costliest in safety loss first; unknown parts count as nominal.

    A task whose scaling is unknown has neither nominal time nor loss: its whole motion is shown as nominal.
    """
    if tasks.is_empty():
        return []
    known = tasks.with_columns(pl.col("safety_loss_s", "dwell_s", "wait_s").fill_null(0.0))
    motion = pl.col("end_s") - pl.col("start_s") - pl.sum_horizontal("safety_loss_s", "dwell_s", "wait_s")
    known = known.with_columns(pl.col("nominal_s").fill_null(motion.clip(0.0)))
    means = known.group_by("task").agg(*(pl.col(part).mean() for part in _PARTS), pl.len().alias("seen"))
    total = pl.col("safety_loss_s") * pl.col("seen")
    rows = means.sort(total, pl.col("task"), descending=[True, False]).iter_rows(named=True)
    return [
        Share(
            name=r["task"],
            nominal_s=r["nominal_s"],
            safety_s=r["safety_loss_s"],
            dwell_s=r["dwell_s"],
            wait_s=r["wait_s"],
            seen=r["seen"],
        )
        for r in rows
    ]


def safety_function(
    samples: pl.DataFrame, levels: Sequence[float], model: Predicts | None, *, seed: int = 0
) -> LoggedResponse | None:
    """Read the safety function back from the samples; None where scaling or positions are unknown."""
    axes = [f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz"]
    rows = samples.with_columns(human_z_m=HUMAN_Z_IN_PLANE).filter(pl.col("robot_moving").fill_null(value=True))
    rows = rows.select(*axes, "scaling", "step").drop_nulls([*axes, "scaling"])
    if rows.height < 50:
        return None
    x = rows.select(axes).to_numpy().astype(np.float64)
    scaling = rows["scaling"].to_numpy().astype(np.float64)
    distance = np.linalg.norm(x[:, :3] - x[:, 3:], axis=1)
    slot = np.floor(distance / DISTANCE_BIN_M).astype(np.int64)
    counts = np.bincount(slot)
    filled = np.flatnonzero(counts >= 5)
    means = np.bincount(slot, weights=scaling) / np.maximum(counts, 1)
    spread = float(np.var(scaling))
    explained = 1 - float(np.mean((scaling - means[slot]) ** 2)) / spread if spread > 0 else 0.0
    return LoggedResponse(
        cells=_histogram(slot, scaling),
        bin_m=np.asarray((filled + 0.5) * DISTANCE_BIN_M, np.float64),
        logged=means[filled],
        predicted=_predicted(model, x, slot, filled, seed),
        bands=_bands(rows["step"], distance, levels),
        explained=max(0.0, explained),
        samples=len(distance),
    )


def _histogram(slot: NDArray[np.int64], scaling: NDArray[np.float64]) -> NDArray[np.float64]:
    row = np.rint(scaling / SCALING_BIN).astype(np.int64)
    pairs, counts = np.unique(np.column_stack([slot, row]), axis=0, return_counts=True)
    return np.column_stack([(pairs[:, 0] + 0.5) * DISTANCE_BIN_M, pairs[:, 1] * SCALING_BIN, counts]).astype(np.float64)


def _predicted(
    model: Predicts | None, x: NDArray[np.float64], slot: NDArray[np.int64], filled: NDArray[np.int64], seed: int
) -> NDArray[np.float64] | None:
    """Mean prediction per bin, from at most 50 000 samples: enough for a mean, and quick."""
    if model is None or model.problem != "now":
        return None
    picked = np.random.default_rng(seed).permutation(len(x))[:50_000]
    value = np.asarray(model.predict(x[picked].astype(np.float32)), dtype=np.float64)
    size = int(slot.max()) + 1
    total = np.bincount(slot[picked], weights=value, minlength=size)
    counts = np.bincount(slot[picked], minlength=size)
    means = np.full(size, np.nan)
    np.divide(total, counts, out=means, where=counts > 0)
    return means[filled]


def _bands(step: pl.Series, distance: NDArray[np.float64], levels: Sequence[float]) -> tuple[Band, ...]:
    label = step.fill_null(-1).to_numpy()
    bands = []
    for index, level in enumerate(levels):
        mine = distance[label == index]
        if len(mine):
            low, high = np.quantile(mine, [0.05, 0.95])
            bands.append(Band(float(level), float(low), float(high), len(mine)))
    return tuple(bands)


@dataclass(frozen=True)
class Loss:
    """Time lost to safety during one operator task, per execution.

    Attributes:
        human_task: The operator's task; None where unknown.
        seconds: Time lost during it, s.
        robot_task: The robot's task with the largest part of it.
        worst_s: That part, s.
    """

    human_task: str | None
    seconds: float
    robot_task: str
    worst_s: float


def sample_s(samples: pl.DataFrame) -> float:
    """Return the median step between samples of one execution, s: the time that a sample represents."""
    step = samples.select(pl.col("t_s").diff().over("execution").median()).item()
    return float(step) if step else 0.0


def slowed() -> pl.Expr:
    """Return which samples lose time to a slow-down, which a robot that waits or is paused does not."""
    waits = pl.col("lost_to").is_in(["wait", "pause"]).fill_null(value=False)
    return pl.col("robot_moving") & (pl.col("scaling") < FULL) & ~waits


def losses(samples: pl.DataFrame, executions: int) -> list[Loss]:
    """Return the time lost per operator task, the largest first.

    Args:
        samples: Samples of all executions.
        executions: Number of executions, by which the sums are divided.
    """
    slow = samples.filter(slowed() & pl.col("robot_task").is_not_null())
    if slow.is_empty() or not executions:
        return []
    per = sample_s(samples) / executions
    pairs = slow.group_by("human_task", "robot_task").agg(lost=(1 - pl.col("scaling")).sum() * per)
    pairs = pairs.sort("lost", "robot_task", descending=[True, False])
    sums = pairs.group_by("human_task", maintain_order=True).agg(
        pl.col("lost").sum().alias("all"), pl.col("robot_task").first(), pl.col("lost").first()
    )
    return [Loss(*row) for row in sums.sort("all", descending=True).iter_rows()]
