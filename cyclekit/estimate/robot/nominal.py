"""The nominal motion of every logged task, with the speed scaling undone, at the usual speed slider.

While a task runs, the nominal time on its path is the integral of the scaling. So the repetition of a task with the
least safety loss, resampled over that integral, is the programmed motion. `rollout` adds the effect of an operator.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
import polars as pl

from cyclekit.estimate.robot.work_dwells import either_kind, groups_of, key_of, standstills_by_work, standstills_in
from cyclekit.segmentation.arrivals import fill_nearest

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cyclekit.dataset.cards import DatasetCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.work_dwells import Group, Standstills
    from cyclekit.schema import Floats, Vector


STEP_S = 0.01
"""Grid of the nominal time, s; a TCP at 1 m/s moves 1 cm per step."""
SLIDER_LOSS = 0.002
"""Maximum share of an execution's time that its speed slider changes, for an execution at the usual slider."""


@dataclass(frozen=True)
class NominalTask:
    """A task as programmed.

    Attributes:
        xyz_m: TCP along the motion at every STEP_S of nominal time, shape (K, 3), base frame.
        nominal_s: Duration of the motion at scaling 1: the median over its repetitions.
        dwell_s, wait_s: Mean process time and mean wait at the goal.
        standstill_s: Logged standstill times at the goal (dwell + wait), ascending, shape (N,) of N repetitions; of all
            tasks to the goal if its standstills are of several kinds (`work_dwells.StandstillKind`).
        by_work: Standstills per group of executions, if they depend on the work; else empty.
        group: The group whose standstills these are; None = all executions.
    """

    task: str
    xyz_m: Floats
    nominal_s: float
    dwell_s: float
    wait_s: float
    standstill_s: Vector
    by_work: Mapping[Group, Standstills] = field(default_factory=dict)
    group: Group | None = None

    @property
    def key(self) -> str:
        """Name of the task with these standstills: the task's own, unless they are of one group."""
        return self.task if self.group is None else f"{self.task} {key_of(self.group)}"

    def of_work(self, places: Sequence[str]) -> NominalTask:
        """Return the task with the standstills of executions of the same work as a cycle through `places`, if known."""
        return next((self.of_group(group) for group in groups_of(places) if group in self.by_work), self)

    def of_group(self, group: Group) -> NominalTask:
        """Return the task with the standstills of one of the groups in `by_work`."""
        mine = self.by_work[group]
        return replace(self, dwell_s=mine.dwell_s, wait_s=mine.wait_s, standstill_s=mine.standstill_s, group=group)


_KNOWN: WeakKeyDictionary[Dataset, tuple[DatasetCard, dict[frozenset[str] | None, dict[str, NominalTask]]]]
_KNOWN = WeakKeyDictionary()
"""Of datasets in use, with their cards: the tasks by what was wanted. A report asks for them five times and more."""


def nominal_tasks(dataset: Dataset, wanted: Collection[str] | None = None) -> dict[str, NominalTask]:
    """Return the nominal motion of every task that was logged with known scaling, by task name.

    `wanted`: return only these tasks, if all of them were logged with known scaling.
    """
    card, known = _KNOWN.get(dataset, (None, {}))
    if card is not dataset.card:
        known = {}
        _KNOWN[dataset] = dataset.card, known
    some = None if wanted is None else frozenset(wanted)
    if some not in known:
        known[some] = _some_of(known[None], some) if some is not None and None in known else _read(dataset, some)
    return dict(known[some])


def _some_of(every: Mapping[str, NominalTask], wanted: frozenset[str]) -> dict[str, NominalTask]:
    return {name: task for name, task in every.items() if name in wanted or not every.keys() >= wanted}


def _read(dataset: Dataset, wanted: Collection[str] | None) -> dict[str, NominalTask]:
    logged = dataset.uninterrupted_tasks().filter(pl.col("nominal_s").is_not_null() | pl.col("arrival_s").is_null())
    tasks = logged.filter(pl.col("nominal_s").is_not_null())
    if tasks.height == 0:
        return {}
    if wanted is not None and set(tasks["task"]).issuperset(wanted):
        tasks = tasks.filter(pl.col("task").is_in(list(wanted)))
    means = tasks.group_by("task").agg(nominal_s=pl.col("nominal_s").median() / usual_slider(dataset))
    own = {name: standstills_in(rows) for (name,), rows in logged.group_by(["task"])}
    slowed = pl.col("safety_loss_s") + _slider_loss(tasks)
    best = tasks.sort(slowed, "execution", "index").group_by("task", maintain_order=True).first()
    found, by_work = {}, standstills_by_work(dataset)
    chosen = best.join(means, on="task", suffix="_all").sort("execution", "start_s")
    for (execution,), rows in chosen.group_by(["execution"], maintain_order=True):
        track = _execution_track(dataset, str(execution))
        for row in rows.iter_rows(named=True):
            path = _undo_scaling(track, row["start_s"], row["arrival_s"], row["nominal_s_all"])
            groups = by_work.get(row["task"], {})
            stands = either_kind(groups) or own[row["task"]]
            found[row["task"]] = NominalTask(
                task=row["task"],
                xyz_m=path,
                nominal_s=row["nominal_s_all"],
                dwell_s=stands.dwell_s,
                wait_s=stands.wait_s,
                standstill_s=stands.standstill_s,
                by_work=groups,
            )
    return found


def _execution_track(dataset: Dataset, execution: str) -> tuple[Vector, Floats, Vector]:
    """Return times, TCP and program rate of one execution: logged rows if these have the scaling, else samples."""
    tcp = ("tcp_x_m", "tcp_y_m", "tcp_z_m")
    native = dataset.native_robot(execution, ("t_s", *tcp, "scaling"))
    if native is not None and native["scaling"].is_not_null().any():
        xyz = native.select(tcp).to_numpy()
        return native["t_s"].to_numpy(), xyz, native["scaling"].to_numpy()  # includes the speed slider
    samples = dataset.samples([execution])
    xyz = samples.select("robot_x_m", "robot_y_m", "robot_z_m").to_numpy()
    speed = samples.select(pl.col("scaling") * pl.col("slider").fill_null(1.0)).to_series()
    return samples["t_s"].to_numpy(), xyz, speed.to_numpy()


def _slider_loss(tasks: pl.DataFrame) -> pl.Expr:
    """Return the time lost to the operator's speed slider, s; 0 if it is not separated from the scaling."""
    return pl.col("lost_slider_s").fill_null(0.0)


def usual_slider(dataset: Dataset) -> float:
    """Return the position of the operator's speed slider in most executions, equal to 0.01, else 1.

    Estimates are for it: a cell whose slider always stood at 70 % has cycles at 70 %.
    """
    stood = [nominal_s / slowed_s for nominal_s, slowed_s in _motions(dataset).values()]
    position, times = Counter(round(each, 2) for each in stood).most_common(1)[0] if stood else (1.0, 0)
    same = [each for each in stood if round(each, 2) == position]
    return sum(same) / times if 2 * times > len(stood) else 1.0


def slider_losses(dataset: Dataset) -> dict[str, float]:
    """Return the share of each execution's time lost to the operator's speed slider beyond its usual position."""
    usual, durations = usual_slider(dataset), dict(dataset.executions.select("execution", "duration_s").iter_rows())
    return {
        name: (slowed_s - nominal_s / usual) / max(durations[name], 1e-9)
        for name, (nominal_s, slowed_s) in _motions(dataset).items()
        if name in durations
    }


def _motions(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Return the nominal time of the motions of each execution, and their time at its speed slider, s."""
    tasks = dataset.tasks().filter(pl.col("nominal_s") > 0.0)
    both = pl.col("nominal_s").sum(), (pl.col("nominal_s") + _slider_loss(tasks)).sum().alias("slowed_s")
    return {name: (nominal_s, slowed_s) for name, nominal_s, slowed_s in tasks.group_by("execution").agg(*both).rows()}


def turned_otherwise(dataset: Dataset) -> set[str]:
    """Return the executions whose speed slider stood elsewhere than usual: an estimate is not for them."""
    return {name for name, share in slider_losses(dataset).items() if abs(share) > SLIDER_LOSS}


def _undo_scaling(track: tuple[Vector, Floats, Vector], start_s: float, arrival_s: float, nominal_s: float) -> Floats:
    """Return the TCP over nominal time, shape (K, 3), stretched to the median nominal duration."""
    t, xyz, scaling = track
    inside = (t >= start_s - 1e-9) & (t <= arrival_s + 1e-9)
    t, xyz, s = t[inside], xyz[inside], scaling[inside]
    known = np.flatnonzero(np.isfinite(s))
    s = fill_nearest(s, known) if len(known) else np.ones(len(s))
    elapsed = np.concatenate([[0.0], np.cumsum(s[:-1] * np.diff(t))])
    elapsed *= nominal_s / max(float(elapsed[-1]), 1e-9)
    grid = np.arange(max(2, round(nominal_s / STEP_S) + 1)) * (nominal_s / max(1, round(nominal_s / STEP_S)))
    return np.column_stack([np.interp(grid, elapsed, xyz[:, axis]) for axis in range(3)])
