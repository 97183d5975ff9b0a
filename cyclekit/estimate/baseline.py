"""The baseline: logged executions that other cycles are compared with, and their mean times per task."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.config.sequences import PLAN
from cyclekit.estimate.logged_both import logged_of_both, logged_plan
from cyclekit.estimate.operator.latest_pace import at_latest_pace, logged_pace, share_of_pace
from cyclekit.estimate.result import AWAY, ELSEWHERE, PARTS, SPLIT, CycleEstimate, PlannedShare, TaskShare
from cyclekit.estimate.robot.nominal import turned_otherwise
from cyclekit.estimate.statistics.bias import half_width_95
from cyclekit.estimate.statistics.distribution import CycleDistribution, wilson
from cyclekit.estimate.statistics.resample import TOGETHER, Z95, resampled
from cyclekit.estimate.statistics.same_work import plan_goals, work_of
from cyclekit.learning.task_times.runs import logged_runs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import OperatorPaceCard
    from cyclekit.dataset.cards.task_model import PaceCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.statistics.same_work import Work
    from cyclekit.estimate.validation.check import Check
    from cyclekit.learning.task_times.runs import Run
    from cyclekit.schema import Floats, Vector

LOGGED = "logged executions"
"""Name of a baseline of logged executions, beside `random orders`."""
NOTHING = "nothing: it is the order of the logged executions"
"""What an order saves against its own logs."""
MIN_RUNS = 5
"""Minimum number of executions of the usual order to use it alone as baseline; below it, all of the same work."""
LEVELS = (0.05, 0.5, 0.95)
"""Quantile levels reported for logged executions."""


@dataclass(frozen=True)
class Baseline:
    """The baseline: logged executions, or an estimate chosen by name.

    Attributes:
        executions: Number of logged executions; 0 for an estimate.
        mean_s: Mean cycle time.
        low_s, high_s: 95 % interval of the mean, from resampled executions; both equal the mean for one execution.
        missed: Number of executions longer than the takt time; None without a takt time.
        within: Share of executions within the takt time, with its 95 % interval; None without a takt time.
        order: The order that all of them ran; None if they ran several.
        others: Number of executions of the same work in other orders, which do not count.
        names: Names of the executions.
        sequence: Name of the sequence chosen as baseline; None without one.
        as_logged_s: Mean cycle time as logged, if all else is at the operator's latest pace or rolled out like the
            estimates (`rolled_out`); None: all is as logged.
        pace_share: Share of a cycle that follows the operator's pace; None: all is as logged.
    """

    executions: int
    mean_s: float
    low_s: float
    high_s: float
    missed: int | None = None
    within: tuple[float, float, float] | None = None
    order: tuple[str, ...] | None = None
    others: int = 0
    names: tuple[str, ...] = ()
    sequence: str | None = None
    as_logged_s: float | None = None
    pace_share: float | None = None

    def rolled_out(self, check: Check | None) -> Baseline:
        """Return logged executions as estimates have them, with any operators: only the order then differs.

        Args:
            check: The validation of the estimates; None changes nothing.
        """
        by = 1.0 if check is None or not self.executions else check.like_for_like
        if by == 1.0:
            return self
        times_s = {name: by * getattr(self, name) for name in ("mean_s", "low_s", "high_s")}
        logged_s = self.mean_s if self.as_logged_s is None else self.as_logged_s
        return replace(self, **times_s, as_logged_s=logged_s)

    def is_own(self, found: CycleEstimate) -> bool:
        """Return whether these are logged executions of the estimate's own order: the model's error is no saving."""
        return self.order is not None and self.executions > 0 and self.order == _order_of(found)

    def compared(self, found: CycleEstimate) -> tuple[float, tuple[float, float, float]]:
        """Return the mean to compare an estimate with, and what that saves with the 95 % interval of two means, s.

        An order saves nothing against its own logs.
        """
        if self.is_own(found):
            return self.mean_s, (0.0, 0.0, 0.0)
        saved_s = self.mean_s - found.expected_s
        off_s = float(np.hypot(self.high_s - self.low_s, found.expected_high_s - found.expected_low_s)) / 2
        return self.mean_s, (saved_s, saved_s - off_s, saved_s + off_s)

    @property
    def missed_share(self) -> float | None:
        """Share of the executions longer than the takt time."""
        return None if self.within is None else 1.0 - self.within[0]

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values, without the names of the executions."""
        values = {name: value for name, value in vars(self).items() if name != "names"}
        return values | {"missed_share": self.missed_share}


def baseline_of(
    dataset: Dataset,
    work: Work,
    takt_s: float | None,
    named: CycleEstimate | None = None,
    pace: Sequence[OperatorPaceCard | PaceCard] = (),
) -> Baseline | None:
    """Return the baseline: the logged executions of this work at the usual speed slider, with an operator.

    If one order makes up more than half of them, and at least MIN_RUNS, it is the usual one, and counts alone. None if
    there are none. The cycle of a plan ends when both agents are done.

    Args:
        dataset: The logs.
        work: The work of the cycles.
        takt_s: The takt time, s.
        named: The sequence chosen as baseline: its logged executions are used, or its estimate if it was never logged.
        pace: Accepted changes of the operator's pace: logged cycles are then counted at his latest pace.
    """
    durations = dict(dataset.executions.filter("complete").select("execution", "duration_s").iter_rows())
    logged = {name: [order] for name, order in _orders(dataset).items()}
    if work.plan and (both := logged_of_both(dataset)):
        durations, logged = (
            {name: getattr(one, key) for name, one in both.items()} for key in ("duration_s", "orders")
        )
    other = turned_otherwise(dataset)
    ran = {
        one.execution: order
        for one in dataset.card.executions
        for order in logged.get(one.execution, ())
        if one.execution in durations and not one.reference and one.execution not in other and _does(order, work)
    }
    if named is not None:
        ran = {name: places for name, places in ran.items() if places == _order_of(named)}
        if not ran:
            return _estimated(named, takt_s)
    if not ran:
        return None
    every = dict(ran)
    (order, times), count = Counter(ran.values()).most_common(1)[0], len(ran)
    if times >= MIN_RUNS and 2 * times > count:
        ran = {name: places for name, places in ran.items() if places == order}
    names, same = tuple(ran), len(set(ran.values())) == 1
    cycles_s = np.array([durations[name] for name in names], dtype=np.float64)
    logged_s, at_pace = cycles_s, logged_pace(dataset, pace)
    share = None if at_pace is None else share_of_pace(at_pace, durations, every)
    error_s = 0.0
    if at_pace is not None and share is not None:
        cycles_s, error_s = at_latest_pace(at_pace, share, names, logged_s)
    low_s, high_s = _interval(names, cycles_s, error_s)
    missed = None if takt_s is None else int((cycles_s > takt_s).sum())
    within = None if missed is None else (1 - missed / len(names), *wilson(1 - missed / len(names), len(names)))
    mean_s, name, usual = float(cycles_s.mean()), named.name if named else None, order if same else None
    as_logged = {} if share is None else {"as_logged_s": float(logged_s.mean()), "pace_share": share.mean}
    others = count - len(names)
    return Baseline(len(names), mean_s, low_s, high_s, missed, within, usual, others, names, name, **as_logged)


def _orders(dataset: Dataset) -> dict[str, tuple[str, ...]]:
    """Return the order of each execution: its places or, for task lists, the tasks of robot and operator."""
    found = {one.execution: tuple(one.places) for one in dataset.card.executions if one.places}
    if not found:
        tasks = dataset.every_task().sort("start_s").select("execution", "agent", "task")
        for (name,), rows in tasks.group_by(["execution"], maintain_order=True):
            found[str(name)] = _plan_order(rows.select("agent", "task").rows())
    return found


def _order_of(named: CycleEstimate) -> tuple[str, ...]:
    if not named.tracks:
        return _plan_order([(task.kind, task.task) for task in named.plan])
    if named.places[:1] != (PLAN,):
        return named.places
    return (PLAN, *sorted(plan_goals(named.places[1:]), key=lambda task: not task.startswith("robot: ")))


def _plan_order(tasks: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    return (PLAN, *(f"{agent}: {task}" for agent, task in sorted(tasks, key=lambda each: each[0] != "robot")))


def _does(order: tuple[str, ...], work: Work) -> bool:
    """Return whether an order does this work; tasks of task lists are compared by name, whatever the agent's name."""
    if order[:1] != (PLAN,):
        return work_of(order) == work
    mine, wanted = (
        sorted(visit.rpartition(": ")[2] for visit in some) for some in (work_of(order).visits, work.visits)
    )
    return mine == wanted


def _estimated(named: CycleEstimate, takt_s: float | None) -> Baseline:
    within = None if takt_s is None else named.within(takt_s)
    interval = named.expected_low_s, named.expected_high_s
    return Baseline(0, named.expected_s, *interval, None, within, named.places, sequence=named.name)


def _interval(names: Sequence[str], cycles_s: Vector, more_s: float = 0.0) -> tuple[float, float]:
    """Return the 95 % interval of the mean of cycles, shape (N,), s; Student's t widens it for few cycles.

    `more_s`: another standard error of the mean, which the scatter of the cycles does not show.
    """
    mean_s, count = float(cycles_s.mean()), len(cycles_s)
    if count < 2:
        return mean_s - Z95 * more_s, mean_s + Z95 * more_s
    error_s = float((resampled(names, 0, together=TOGETHER) @ cycles_s).std()) * (count / (count - 1)) ** 0.5
    half_s = float(np.hypot(half_width_95(error_s, count), Z95 * more_s))
    return mean_s - half_s, mean_s + half_s


def logged_order(dataset: Dataset) -> tuple[str, ...]:
    """Return the complete executions of the most frequent order; if no order repeats, the one of median length."""
    alone = [one.execution for one in dataset.card.executions if one.reference]
    complete = dataset.executions.filter("complete").sort("duration_s")["execution"].to_list()
    tasks = dataset.tasks().sort("start_s").group_by("execution").agg("task")
    of = {name: tuple(order) for name, order in tasks.iter_rows() if name not in alone}
    names = [name for name in complete if name in of]
    if not names:
        return ()
    order, times = Counter(of[name] for name in names).most_common(1)[0]
    if times == 1:
        return (names[len(names) // 2],)
    return tuple(name for name in names if of[name] == order)


def logged_cycle(dataset: Dataset, names: Sequence[str], title: str, *, both: bool = False) -> CycleEstimate | None:
    """Return logged executions of one order as an estimate: mean task times and quantiles of the cycles.

    None if the robot's tasks are unknown, or differ between the executions. With `both`, if the operator's tasks are
    the same too, it has the tasks of both agents, and its cycle ends when both are done.
    """
    tasks = dataset.tasks().filter(pl.col("execution").is_in(list(names))).sort("execution", "start_s")
    each = [rows for _, rows in tasks.group_by(["execution"], maintain_order=True)]
    if not each or len({tuple(rows["task"]) for rows in each}) > 1:
        return None
    begins_s = [float(rows["start_s"][0]) for rows in each]
    ends_s = np.array([rows["end_s"].to_numpy() - begin_s for rows, begin_s in zip(each, begins_s, strict=True)])
    single = len(each) > 1
    band: list[list[float | None]] = [[None, None]] * ends_s.shape[1]
    if single:
        band = np.quantile(ends_s, (LEVELS[0], LEVELS[-1]), axis=0, method="weibull").T.tolist()
    begun_s = np.concatenate([np.zeros((len(each), 1)), ends_s[:, :-1]], axis=1)
    parts_s = np.stack([_parts_s(rows) for rows in each]).mean(axis=0)
    took_s = (ends_s - begun_s).mean(axis=0)
    parts_s[:, 3] += took_s - parts_s.sum(axis=1)  # time between two tasks counts as wait
    shares = tuple(
        TaskShare(task, float(took), *parts, *ends)
        for task, took, parts, ends in zip(each[0]["task"], took_s, parts_s.tolist(), band, strict=True)
    )
    plan = logged_plan(dataset, names) if both else ()
    durations = logged_of_both(dataset) if plan else {}
    cycles_s = np.array([durations[name].duration_s for name in names]) if plan else ends_s[:, -1]
    split = dict(zip(SPLIT, parts_s.sum(axis=0).tolist(), strict=True))
    low_s, high_s = _interval(names, cycles_s)
    logged = CycleDistribution(cycles_s, executions=len(each)) if single else None
    places = next(tuple(one.places) for one in dataset.card.executions if one.execution == names[0])
    return CycleEstimate(
        title, places, float(cycles_s.mean()), low_s, high_s, logged, **split,
        support=1.0, tracks=len(each), limits=(), tasks=shares, safety_by_activity_s={},
        durations_s=tuple(cycles_s.tolist()), estimator="logged", why="logged executions", executions=len(each),
        operator_at={} if plan else _operator_at(dataset, names, begins_s, float(cycles_s.mean())),
        plan=plan, idle_s=max(float(cycles_s.mean()) - sum(split.values()), 0.0),
    )  # fmt: skip


def listed_cycles(dataset: Dataset) -> dict[str, CycleEstimate]:
    """Return logged executions of task lists as estimates, by key: `most` is the mean of the most frequent order.

    If no order repeats, the keys are `shortest`, `middle` and `longest` execution. Empty without task lists.
    """
    runs, _ = logged_runs(dataset)
    if not runs:
        return {}
    names = Counter(run.order for run in runs)
    order, times = names.most_common(1)[0]
    if times > 1:
        same = [run.name for run in runs if run.order == order]
        found = listed_cycle(dataset, same, f"{times} logged executions of one order")
        return {} if found is None else {"most": found}
    by_length = sorted(runs, key=lambda run: run.duration_s)
    chosen = {"middle": by_length[len(runs) // 2], "shortest": by_length[0], "longest": by_length[-1]}
    one_by_one = {run.name: which for which, run in reversed(chosen.items())}  # a single execution is the middle
    drawn = {which: listed_cycle(dataset, [name], name) for name, which in one_by_one.items()}
    return {which: found for which in ("shortest", "middle", "longest") if (found := drawn.get(which)) is not None}


def listed_cycle(dataset: Dataset, names: Sequence[str], title: str) -> CycleEstimate | None:
    """Return executions of task lists in one order as an estimate; None if their orders differ."""
    runs, kinds = logged_runs(dataset)
    asked = set(names)
    runs = [run for run in runs if run.name in asked]
    if len({run.order for run in runs}) != 1:
        return None
    plan = [share for agent in runs[0].tasks for share in _listed(runs, agent, kinds[agent])]
    robot = [share for share in plan if share.kind == "robot"]
    work_s, wait_s = sum(share.end_s - share.start_s for share in robot), sum(share.wait_s for share in robot)
    cycles_s = np.array([run.duration_s for run in runs])
    mean_s, (low_s, high_s) = float(cycles_s.mean()), _interval(tuple(run.name for run in runs), cycles_s)
    logged = CycleDistribution(cycles_s, executions=len(runs)) if len(runs) > 1 else None
    return CycleEstimate(
        title, (), mean_s, low_s, high_s, logged, work_s, 0.0, 0.0, wait_s,
        support=1.0, tracks=0, limits=(), tasks=(), safety_by_activity_s={}, durations_s=tuple(cycles_s.tolist()),
        estimator="logged", why="logged executions", executions=len(runs),
        plan=tuple(sorted(plan, key=lambda share: share.start_s)),
    )  # fmt: skip


def _listed(runs: Sequence[Run], agent: str, kind: str) -> list[PlannedShare]:
    """Return the tasks of an agent, with mean times over executions of one order."""
    times_s = np.array([[(done.start_s, done.end_s) for done in run.tasks[agent]] for run in runs])
    wait_s = times_s[:, :, 0] - np.concatenate([np.zeros((len(runs), 1)), times_s[:, :-1, 1]], axis=1)
    start_s, end_s = times_s.mean(axis=0).T.tolist()
    waits_s = np.maximum(wait_s, 0.0).mean(axis=0).tolist()
    band: list[list[float | None]] = [[None, None]] * len(end_s)
    if len(runs) > 1:
        band = np.quantile(times_s[:, :, 1], (LEVELS[0], LEVELS[-1]), axis=0, method="weibull").T.tolist()
    tasks = [done.task for done in runs[0].tasks[agent]]
    return [
        PlannedShare(agent, kind, task, begin, end, wait, {}, low, high)
        for task, begin, end, wait, (low, high) in zip(tasks, start_s, end_s, waits_s, band, strict=True)
    ]


def _parts_s(rows: pl.DataFrame) -> Floats:
    """Return motion, safety loss, dwell and wait of each task, shape (tasks, 4), s; unknown loss counts as motion."""
    parts = [pl.col(name).fill_null(0.0) for name in ("safety_loss_s", "dwell_s", "wait_s")]
    motion = pl.col("end_s") - pl.col("start_s") - pl.sum_horizontal(parts)  # a wait may be short of the place
    return np.asarray(rows.select(motion.clip(0.0).alias("motion"), *parts).to_numpy(), dtype=np.float64)


def _operator_at(
    dataset: Dataset, names: Sequence[str], begins_s: Sequence[float], cycle_s: float
) -> dict[str, tuple[float, ...]]:
    columns = ["execution", "t_s", "human_task", "human_x_m"]
    samples = dataset.samples(list(names), columns=columns)
    begin = pl.col("execution").replace_strict(dict(zip(sorted(names), begins_s, strict=True)), return_dtype=pl.Float64)
    part = ((pl.col("t_s") - begin) / cycle_s * PARTS).floor().cast(pl.Int64)
    doing = pl.coalesce(
        "human_task", pl.when(pl.col("human_x_m").is_null()).then(pl.lit(AWAY)).otherwise(pl.lit(ELSEWHERE))
    )
    known = samples.select(part=part, doing=doing).filter(pl.col("part").is_between(0, PARTS - 1))
    if known.is_empty() or set(known["doing"]) <= {AWAY}:
        return {}
    count = known.group_by("part").len().rename({"len": "all"})
    shares = known.group_by("part", "doing").len().join(count, on="part")
    found: dict[str, list[float]] = {}
    for at, name, times, every in shares.sort("doing", "part").select("part", "doing", "len", "all").iter_rows():
        found.setdefault(name, [0.0] * PARTS)[at] = round(times / every, 4)
    return {name: tuple(parts) for name, parts in found.items()}
