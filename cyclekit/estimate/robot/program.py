"""The program of a sequence: its motions and standstills along nominal time.

`rollout` computes how fast that time advances with an operator in the cell.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from cyclekit.errors import EstimateError, UnknownName
from cyclekit.estimate.robot.nominal import NominalTask

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats


MAX_BETWEEN = 3
"""Maximum number of places between start and goal of a task that was never logged, for a proposed way."""


@dataclass(frozen=True)
class Program:
    """Motions and standstills of a sequence along nominal time.

    Attributes:
        tasks: The tasks, each a motion and a standstill.
        edges_s: Nominal time at the end of each motion and each standstill, alternating, shape (2 * tasks,).
    """

    tasks: tuple[NominalTask, ...]
    edges_s: Floats

    @property
    def length_s(self) -> float:
        """Duration at scaling 1 including standstills: the exact sum over the tasks."""
        return float(self.edges_s[-1])


def lay_out(sequence: TaskSequence, nominal: Mapping[str, NominalTask], dataset: Dataset) -> Program:
    """Return the program of a sequence.

    Raises:
        UnknownName: A place does not exist.
        EstimateError: A task was never logged.
    """
    if sequence.plan:
        msg = f"{sequence.shown}: a plan for robot and operator, and this model knows positions, not task lists"
        raise EstimateError(msg, cure="Name the robot's places, or train on task lists of both agents.")
    places = dataset.places
    for place in sequence.places:
        if place not in places:
            raise UnknownName(sequence.shown, "place", place, places)
    if missing := [task for task in sequence.tasks if task not in nominal]:
        seen = f"{sequence.shown}: task {missing[0]!r} was never logged with a known speed scaling"
        cure = _by_way_of(missing[0], dataset) or f"Use tasks that were: {_tasks_from(missing[0], nominal)}."
        raise EstimateError(seen, cure=cure)
    tasks = tuple(nominal[task].of_work(sequence.places) for task in sequence.tasks)
    parts = [part for task in tasks for part in (task.nominal_s, task.dwell_s + task.wait_s)]
    return Program(tasks, np.cumsum(parts))


def _by_way_of(task: str, dataset: Dataset) -> str | None:
    """Return by which places the robot usually goes from the start of a task to its goal in the logs, as a cure."""
    start, _, goal = task.partition("->")
    ways = Counter[tuple[str, ...]]()
    for went in (one.places for one in dataset.card.executions):
        for number, place in enumerate(went):
            ahead = went[number + 1 : number + MAX_BETWEEN + 2]
            if place == start and goal in ahead[1:]:
                ways[ahead[: ahead.index(goal, 1)]] += 1
    if not ways:
        return None
    between, times = max(ways.items(), key=lambda way: (way[1], -len(way[0])))
    names = " and ".join(between)
    return f"In the logs the robot goes from {start} to {goal} by {names} ({times} times): name {names} between them."


def _tasks_from(task: str, nominal: Mapping[str, NominalTask]) -> str:
    start = task.partition("->")[0]
    known = sorted(name for name in nominal if name.startswith(f"{start}->")) or sorted(nominal)
    return ", ".join(known[:8]) + (" …" if len(known) > 8 else "")


def draw_standstills(
    program: Program, count: int, seed: int, known: dict[tuple[str, int], Floats] | None = None
) -> Floats:
    """Return a standstill time per cycle and task, shape (count, tasks), s: quantiles of logged ones, shuffled.

    Rare long waits for parts make cycles differ; mean standstills would hide that. A task draws the same standstills in
    every program, and others at its second occurrence in a program, so that programs are compared under the same
    conditions. `known`: a cache of draws, shared between programs with the same tasks.
    """
    known = {} if known is None else known
    drawn, times = [], Counter[str]()
    for task in program.tasks:
        key = task.key, times[task.task]
        if key not in known:
            known[key] = standstills_of(task, count, seed, key[1])
        drawn.append(known[key])
        times[task.task] += 1
    return np.column_stack(drawn)


def standstills_of(task: NominalTask, count: int, seed: int, occurrence: int) -> Floats:
    """Return standstill times of a task at its n-th occurrence in a program, shape (count,), s: `draw_standstills`."""
    rng = np.random.default_rng([seed, crc32(task.task.encode()), occurrence])
    level = (np.arange(count) + 0.5) / count
    standstills: Floats = np.maximum(rng.permutation(np.quantile(task.standstill_s, level)), 1e-3)
    return standstills
