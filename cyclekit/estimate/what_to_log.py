"""What to log next: missing or rare tasks, and the number of executions for a narrower interval."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import DatasetError
from cyclekit.estimate.statistics.resample import Z95
from cyclekit.text.numbers import percent
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset

ENOUGH = 5
"""Minimum number of repetitions of a task: with fewer, single ones determine its motion (median) and dwell (mean)."""
FEW_PART = 0.1
"""Maximum share of the executions that visit a found place which may be none."""
SHORT_S = 0.1
"""Maximum median dwell at a found place which may be none, s."""
WITHIN = 0.01
"""Requested half-width of the 95 % interval of the mean cycle time, as a share of the mean."""


@dataclass(frozen=True)
class OrderToLog:
    """An order to log.

    Attributes:
        name: Name of the requested sequence; empty if the order was built from logged tasks.
        places: Ordered places, the start first.
        executions: Number of executions to log.
        adds: The missing and rare tasks in it.
    """

    name: str
    places: tuple[str, ...]
    executions: int
    adds: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class RecordingPlan(Result):
    """What to log next; as a frame, one row per order.

    Attributes:
        missing: Requested tasks that were never logged with a known speed scaling.
        rare: Number of repetitions of tasks logged fewer than ENOUGH times.
        orders: Orders with these tasks, in as few executions as were found.
        executions: Complete executions logged so far.
        half_width: Half-width of the 95 % interval of the mean logged cycle time, as a share of the mean; None with
            fewer than two executions.
        within: The requested half-width.
        more: Total number of executions to log, of these orders and of those logged so far.
        doubtful: Found places that may be none (`doubtful_places`), whose rare tasks are not asked for.
    """

    missing: tuple[str, ...]
    rare: Mapping[str, int]
    orders: tuple[OrderToLog, ...]
    executions: int
    half_width: float | None
    within: float
    more: int
    doubtful: tuple[str, ...] = ()

    @property
    def lines(self) -> list[str]:
        """The plan in sentences; empty if nothing is missing."""
        return self.in_words(str)

    def in_words(self, shown: Callable[[str], str]) -> list[str]:
        """Return the plan in sentences, with tasks and places formatted by `shown`."""
        found = [f"missing: {', '.join(map(shown, self.missing))}"] if self.missing else []
        if self.rare:
            rare = ", ".join(f"{shown(task)} ({count})" for task, count in self.rare.items())
            found.append(f"logged fewer than {ENOUGH} times: {rare}")
        for one in self.orders:
            name = f" (sequence {one.name!r})" if one.name else ""
            times = f"{one.executions} execution{'s' * (one.executions != 1)}"
            found.append(f"log {times} of {', '.join(map(shown, one.places))}{name}")
        if self.doubtful:
            names = ", ".join(map(shown, self.doubtful))
            why = "the robot only waits there, or stood there in few executions"
            found.append(f"not asked for: tasks of {names}: {why}; if it works there, name it in cell.toml")
        if self.half_width is not None and self.half_width > self.within:
            known = (
                f"the mean cycle time of {self.executions} executions is known to "
                f"± {percent(self.half_width, 1)} (95 % CI)"
            )
            why = "the interval narrows with the root of their number"
            found.append(f"{known}; for ± {percent(self.within, 1)} log {self.more} more in all: {why}")
        return found

    def _frame_rows(self) -> list[dict[str, object]]:
        return [
            {"order": ", ".join(one.places), "executions": one.executions, "adds": ", ".join(one.adds)}
            for one in self.orders
        ]

    def _lines(self) -> list[str]:
        return self.lines or ["nothing is lacking"]


def what_to_log(dataset: Dataset, sequences: Sequence[TaskSequence] = (), *, within: float = WITHIN) -> RecordingPlan:
    """Return what to log next, for these sequences or, without any, for the logged tasks.

    Args:
        dataset: The logs so far, with positions of the robot.
        sequences: The sequences to estimate.
        within: Requested half-width of the 95 % interval of the mean cycle time, as a share of the mean.

    Raises:
        DatasetError: The dataset holds no robot tasks.
    """
    dataset.require_positions()
    counts: dict[str, int] = dict(
        dataset.tasks().filter(pl.col("nominal_s").is_not_null()).group_by("task").len().sort("task").iter_rows()
    )
    if not counts:
        raise DatasetError(f"{dataset.place}: no robot task in it", cure="Log executions that drive to places.")
    of_places = [one for one in sequences if one.tasks and not one.plan]
    asked = dict.fromkeys(task for one in of_places for task in one.tasks) or dict.fromkeys(counts)
    few = {task: counts.get(task, 0) for task in asked if counts.get(task, 0) < ENOUGH}
    none = doubtful_places(dataset)
    left_out = {task: none & set(task.split("->")) for task, count in few.items() if count}
    lacking = {task: count for task, count in few.items() if not left_out.get(task)}
    usable = {task: count for task, count in counts.items() if not left_out.get(task)}
    orders = _of_sequences(of_places, lacking) if of_places else _one_tour(dataset, usable, lacking)
    executions, half = _half_width(dataset)
    wanted = 0 if half is None else math.ceil(executions * (half / within) ** 2) - executions
    more = max(wanted, sum(one.executions for one in orders))
    missing = tuple(task for task, count in lacking.items() if count == 0)
    rare = {task: count for task, count in lacking.items() if count}
    doubtful = tuple(sorted(set().union(*left_out.values())))
    return RecordingPlan(missing, rare, tuple(orders), executions, half, within, more, doubtful)


def doubtful_places(dataset: Dataset) -> set[str]:
    """Return found places of the robot that may be none: it only waits there, or stood there in few executions.

    Places named in the cell file, and those where an execution starts or ends, are never doubtful.
    """
    whole = [one.places for one in dataset.card.executions if one.complete and one.places]
    ends = {place for places in whole for place in (places[0], places[-1])}
    often = Counter(place for places in whole for place in set(places))
    visits = dataset.tasks().group_by("goal_place").agg(pl.col("dwell_s").median(), pl.col("wait_s").median())
    waits = {place for place, dwell, wait in visits.iter_rows() if (dwell or 0.0) < SHORT_S < (wait or 0.0)}
    few = {place for place, times in often.items() if times < ENOUGH and times <= FEW_PART * len(whole)}
    found = {name for name, place in dataset.card.places.items() if place.inferred}
    return (found - ends) & (waits | few)


def _half_width(dataset: Dataset) -> tuple[int, float | None]:
    """Return the number of complete executions, and the half-width of the 95 % interval of the mean, as a share.

    Executions of different work differ in duration: the spread around the sum of the mean durations of their tasks
    counts, not that of the durations themselves.
    """
    whole = dataset.executions.filter("complete").select("execution", "duration_s")
    if whole.height < 2:
        return whole.height, None
    took_s = dataset.whole_tasks().with_columns(took_s=pl.col("end_s") - pl.col("start_s"))
    usual_s = took_s.with_columns(usual_s=pl.col("took_s").mean().over("task")).group_by("execution")
    beside = whole.join(usual_s.agg(pl.col("usual_s").sum()), on="execution", how="left")
    spreads = (whole["duration_s"].std(), (beside["duration_s"] - beside["usual_s"]).drop_nulls().std())
    spread_s = min(float(one) for one in spreads if one is not None)  # type: ignore[arg-type]
    return whole.height, Z95 * spread_s / math.sqrt(whole.height) / float(whole["duration_s"].mean())  # type: ignore[arg-type]


def _of_sequences(sequences: Sequence[TaskSequence], lacking: Mapping[str, int]) -> list[OrderToLog]:
    """Cover lacking tasks by the sequences: greedily the one with the most repetitions that are still needed."""
    left = {task: ENOUGH - count for task, count in lacking.items()}
    found: list[OrderToLog] = []
    while any(left.values()):
        gains = {one: sum(min(left.get(task, 0), n) for task, n in Counter(one.tasks).items()) for one in sequences}
        best = max(gains, key=lambda one: gains[one])
        times = Counter(best.tasks)
        count = max(math.ceil(left[task] / n) for task, n in times.items() if left.get(task, 0))
        adds = tuple(task for task in times if left.get(task, 0))
        found.append(OrderToLog(best.name, best.places, count, adds))
        left |= dict.fromkeys(adds, 0)
    return found


def _one_tour(dataset: Dataset, counts: Mapping[str, int], lacking: Mapping[str, int]) -> list[OrderToLog]:
    """Return one order of logged tasks that covers the rare ones, nearest first, to the usual end if possible."""
    if not lacking:
        return []
    whole = [one.places for one in dataset.card.executions if one.whole and len(one.places) > 1]
    ends = Counter((places[0], places[-1]) for places in whole).most_common(1)
    (start, end), _ = ends[0] if ends else ((next(iter(lacking)).partition("->")[0], ""), 0)
    ways = [(a, b) for a, _, b in (task.partition("->") for task in counts)]
    left, places = {tuple(task.split("->")) for task in lacking}, [start]
    while left:
        way = _way(places[-1], {a for a, _ in left}, ways)
        if way is None:
            break
        places += way[1:]
        places.append(min(b for a, b in left if a == places[-1]))
        left -= set(pairwise(places))
    back = _way(places[-1], {end}, ways) if end else None
    places += back[1:] if back else []
    adds = tuple(f"{a}->{b}" for a, b in dict.fromkeys(pairwise(places)) if f"{a}->{b}" in lacking)
    if not adds:
        return []
    return [OrderToLog("", tuple(places), ENOUGH - min(lacking[task] for task in adds), adds)]


def _way(start: str, goals: Iterable[str], ways: Sequence[tuple[str, str]]) -> list[str] | None:
    """Return the places of a shortest path over logged tasks to one of the goals; None without one."""
    wanted, seen, waiting = set(goals), {start}, deque([[start]])
    while waiting:
        places = waiting.popleft()
        if places[-1] in wanted:
            return places
        for a, b in ways:
            if a == places[-1] and b not in seen:
                seen.add(b)
                waiting.append([*places, b])
    return None
