"""Search for the fastest order of both agents' tasks, by a model of task times.

before = [["bring", "weld"]]            # the first, second ... bring before the first, second ... weld
[[task]]
agent = "robot"
name = "bring"
times = 3                               # number of repetitions; default 1
[[task]]
agent = "operator"
name = "mount"
times = 3
not_before_s = 5.0                      # optional: earliest start
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Annotated

import numpy as np
from msgspec import Meta

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.config.toml_file import read_toml, to_dataclass
from cyclekit.config.write import sequence_to_toml
from cyclekit.errors import ConfigError, EstimateError, UnknownName
from cyclekit.estimate.baseline import LOGGED, NOTHING
from cyclekit.estimate.gantt import gantt_figure
from cyclekit.estimate.statistics.resample import Z95
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.learning.task_times.learn import plan_of
from cyclekit.learning.task_times.prepared import agent_of
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import always_in_a_row
from cyclekit.text.numbers import decimals_of, difference, seconds, with_interval
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import polars as pl

    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.estimate.baseline import Baseline
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.learning.task_times.runs import Run
    from cyclekit.plots.drawing import Drawing
    from cyclekit.schema import Progress

    Order = tuple[int, ...]

RANDOM, MOVES, CYCLES = 60, 240, 48
"""Number of random initial orders, of moves tried on the best ones, and of cycles rolled out per order."""
STARTS, FINAL, FINAL_CYCLES = 2, 12, 600
"""Number of random orders that are improved by moves; number of best orders rolled out again, and their cycles."""
TRIES = 20
"""Number of attempts at a random order: one in which tasks stay together may come to a task that can never start."""
_EXAMPLE = """For example:
  [[task]]
  agent = "robot"
  name = "bring"
  times = 3"""


@dataclass(frozen=True)
class JobTask:
    """One kind of task: agent, name, number of repetitions, and earliest start, s."""

    agent: str
    name: str
    times: Annotated[int, Meta(ge=1, le=1000)] = 1
    not_before_s: Annotated[float, Meta(ge=0.0, le=1e6)] | None = None


@dataclass(frozen=True)
class TaskJobs:
    """The work of both agents.

    Attributes:
        task: Kinds of tasks.
        before: Pairs of names: the k-th of the first ends before the k-th of the second starts.
        shown: Name of the jobs in messages.
    """

    task: tuple[JobTask, ...] = ()
    before: tuple[tuple[str, str], ...] = ()
    shown: str = "the jobs"


@dataclass(frozen=True, repr=False)
class TaskOrderPlan(Result):
    """The order found for both agents.

    Attributes:
        estimate: Its estimate.
        tasks: The tasks of each agent, in order.
        against: Basis of comparison: `logged executions`, `logged orders` as estimated, or `random orders`.
        against_s: Mean cycle time of these orders.
        saves_s: against_s minus the expected cycle time, and its 95 % interval.
        tried: Number of orders scored.
    """

    estimate: CycleEstimate
    tasks: tuple[PlannedTask, ...]
    against: str
    against_s: float
    saves_s: tuple[float, float, float]
    tried: int

    def against_today(self, today: Baseline) -> TaskOrderPlan:
        """Return it compared with logged executions of the same work."""
        against_s, saves_s = today.compared(self.estimate)
        return replace(self, against=LOGGED, against_s=against_s, saves_s=saves_s)

    def plot(self) -> Drawing:
        """Return the plan as a time chart of both agents (matplotlib figure)."""
        return gantt_figure([self.estimate])

    def to_dict(self) -> dict[str, object]:
        """Return the plan as plain JSON values."""
        return {
            "order": [task.shown for task in self.tasks],
            "expected_s": self.estimate.expected_s,
            "against": self.against,
            "against_s": self.against_s,
            "saves_s": list(self.saves_s),
            "tried": self.tried,
            "estimate": self.estimate.to_dict(),
        }

    def to_frame(self) -> pl.DataFrame:
        """Return one row per task: agent, task, start, end and wait, s."""
        import polars as pl

        rows = [(one.agent, one.task, one.start_s, one.end_s, one.wait_s) for one in self.estimate.plan]
        return pl.DataFrame(rows, schema=["agent", "task", "start_s", "end_s", "wait_s"], orient="row")

    def to_toml(self) -> str:
        """Return the order as a sequence file."""
        return "# Written by cyclekit plan\n" + sequence_to_toml(TaskSequence.of_plan("planned", self.tasks))

    def _lines(self) -> list[str]:
        expected_s = self.estimate.expected_s
        against = f"saves {self.saving_in_words}" + (f" against {self.against}" if any(self.saves_s) else "")
        return [f"{seconds(expected_s, self.against_s)}; {against}", *(task.shown for task in self.tasks)]

    @property
    def saving_in_words(self) -> str:
        """The saving as the two means differ in the text, with its interval."""
        if not any(self.saves_s):
            return NOTHING
        places = decimals_of(self.estimate.expected_s, self.against_s)
        saved_s = difference(self.against_s, self.estimate.expected_s, places)
        return with_interval(saved_s, *self.saves_s[1:], places)


def load_task_jobs(path: Path | str) -> TaskJobs:
    """Read a jobs file for both agents.

    Raises:
        ConfigError: It cannot be read, or names places instead of tasks.
    """
    raw = read_toml(path)
    if "task" not in raw:
        seen = f"{path}: no [[task]] in it, and a model of task times orders tasks of both agents"
        raise ConfigError(seen, cure=_EXAMPLE)
    return to_dataclass(str(path), raw, TaskJobs, shown=str(path))


def plan_tasks(
    model: TaskModelCard,
    jobs: TaskJobs,
    runs: Sequence[Run] = (),
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> TaskOrderPlan:
    """Search the order of both agents' tasks with the least expected cycle time.

    Args:
        model: Task times learned from task lists.
        jobs: The work.
        runs: Logged executions; those of the same work are the basis of comparison. Tasks that followed each other
            in all of them stay together, and what was always an agent's first or last task stays that.
        seed: Seed of the search and of the draws.
        progress: Called with the fraction done and a text.

    Raises:
        UnknownName: An agent or a task was never logged.
        ConfigError: A precedence constraint names no task of the jobs.
        EstimateError: No order is possible.
    """
    search = _Search(model, jobs, always_in_a_row(runs), seed)
    tell = progress or (lambda _fraction, _text: None)
    tell(0.05, "random orders")
    first = [search.random() for _ in range(RANDOM)]
    for number, order in enumerate(sorted(first, key=search.score)[:STARTS]):
        tell(0.2 + 0.3 * number, "moving tasks")
        search.improve(order, MOVES // STARTS)
    best = min(search.best(), key=lambda order: search.rolled(order, FINAL_CYCLES))
    tell(0.9, "estimating")
    basis, against = _basis(search, runs, first)
    found, *others = _estimates(model, [search.plan(best), *basis], seed)
    against_s = float(np.mean([each.expected_s for each in others]))
    saved = against_s - found.expected_s
    error = (found.expected_high_s - found.expected_low_s) / (2 * Z95) / found.expected_s * max(abs(saved), 0.0)
    spread = Z95 * float(np.hypot(error, search.noise_s(best)))
    return TaskOrderPlan(
        found, tuple(search.plan(best)), against, against_s, (saved, saved - spread, saved + spread), len(search.scored)
    )


class _Search:
    """Orders as sequences of all tasks in which every needed task comes first, so that none ends in a deadlock."""

    def __init__(
        self, model: TaskModelCard, jobs: TaskJobs, in_a_row: Mapping[tuple[str, str], str], seed: int
    ) -> None:
        self.model, self.jobs, self.seed = model, jobs, seed
        self.rng = np.random.default_rng(seed)
        self.tasks = [PlannedTask(job.agent, job.name, job.not_before_s) for job in jobs.task for _ in range(job.times)]
        names = [agent_of(model, task, jobs.shown) for task in self.tasks]
        self.keys = [(name, task.name) for name, task in zip(names, self.tasks, strict=True)]
        self.turn = [self.keys[:number].count(key) for number, key in enumerate(self.keys)]
        self.at = {(key, turn): number for number, (key, turn) in enumerate(zip(self.keys, self.turn, strict=True))}
        self.in_a_row = in_a_row
        self.after = self._together()
        self.first = self._precedence()
        self.scored: dict[Order, float] = {}

    def _together(self) -> dict[int, int]:
        """Return by task the one that stays directly before it, if the work has both equally often."""
        found = {}
        for number, (key, turn) in enumerate(zip(self.keys, self.turn, strict=True)):
            other = (key[0], self.in_a_row.get(key, ""))
            if self.keys.count(other) == self.keys.count(key):
                found[number] = self.at[other, turn]
        return found

    def _precedence(self) -> list[set[int]]:
        """Return for each task the numbers of the tasks that must come before it."""
        needs = {(card.agent, card.task): card.needs for card in self.model.tasks}
        for name in {name for pair in self.jobs.before for name in pair}:
            if name not in {task for _, task in self.keys}:
                raise UnknownName(self.jobs.shown, "task in before", name, {task for _, task in self.keys})
        found = []
        for number, (key, turn) in enumerate(zip(self.keys, self.turn, strict=True)):
            if key not in needs:
                raise UnknownName(self.jobs.shown, f"task of {key[0]}", key[1], {b for a, b in needs if a == key[0]})
            wanted = [((need.agent, need.task), turn - need.back) for need in needs[key]]
            told = {one for one, other in self.jobs.before if other == key[1]}
            wanted += [(other, turn) for other in set(self.keys) if other[1] in told]
            mine = {self.at[one] for one in [*wanted, (key, turn - 1)] if one in self.at}
            mine |= {self.after[number]} if number in self.after else set()
            found.append(mine | {other for other in range(len(self.keys)) if self._is_before(other, number)})
        return found

    def _is_before(self, one: int, other: int) -> bool:
        """Return whether one of two tasks of an agent was always its first, or the other always its last."""
        agent, task = self.keys[one]
        is_first, is_last = self.in_a_row.get((agent, task)) == "", self._is_last(other)
        return agent == self.keys[other][0] and one != other and ((is_first and self._is_once(one)) or is_last)

    def _is_last(self, number: int) -> bool:
        agent, task = self.keys[number]
        return self.in_a_row.get((agent, "")) == task and self._is_once(number)

    def _is_once(self, number: int) -> bool:
        return self.keys.count(self.keys[number]) == 1

    def random(self) -> Order:
        """Return a random order that satisfies the precedence."""
        found = next((order for order in (self._drawn() for _ in range(TRIES)) if order), None)
        if found is None:
            msg = f"{self.jobs.shown}: no order is possible: tasks wait for each other"
            raise EstimateError(msg, cure="Take a pair out of before, or add the task that is waited for.")
        return found

    def _drawn(self) -> Order | None:
        order: list[int] = []
        due: dict[str, int] = {}
        follows = {one: other for other, one in self.after.items()}
        while len(order) < len(self.tasks):
            able = [n for n in range(len(self.tasks)) if n not in order and self.first[n] <= set(order)]
            free = [n for n in able if due.get(self.keys[n][0], n) == n]
            if not free:
                return None
            order.append(int(self.rng.choice(free)))
            due.pop(self.keys[order[-1]][0], None)
            if order[-1] in follows:
                due[self.keys[order[-1]][0]] = follows[order[-1]]
        return self._merged(self._by_agent(order))

    def _by_agent(self, order: Sequence[int]) -> dict[str, list[int]]:
        """Return the tasks of each agent in order; the first, second ... of a kind in turn."""
        found: dict[str, list[int]] = {name: [] for name in sorted({name for name, _ in self.keys})}
        turn = Counter[tuple[str, str]]()
        for number in order:
            key = self.keys[number]
            found[key[0]].append(self.at[key, turn[key]])
            turn[key] += 1
        return found

    def _merged(self, by_agent: Mapping[str, Sequence[int]]) -> Order | None:
        """Return the order of all tasks in which each agent does its own as given; None if they wait for each other."""
        left, found = {name: list(mine) for name, mine in by_agent.items()}, list[int]()
        while any(left.values()):
            name = next((name for name, mine in left.items() if mine and self.first[mine[0]] <= set(found)), None)
            if name is None:
                return None
            found.append(left[name].pop(0))
        return tuple(found)

    def plan(self, order: Order) -> list[PlannedTask]:
        """Return an order as a plan: each agent's tasks in order, with the precedence of the jobs."""
        agents = sorted({self.tasks[n].agent for n in order}, key=lambda agent: agent != "robot")
        told = {task: tuple(a for a, b in self.jobs.before if b == task) for _, task in self.keys}
        mine = [self.tasks[n] for agent in agents for n in order if self.tasks[n].agent == agent]
        return [replace(task, after=told[task.name]) for task in mine]

    def rolled(self, order: Order, cycles: int) -> float:
        """Return the mean cycle time of an order, s."""
        return float(roll_plan(self.model, self.plan(order), cycles=cycles, seed=self.seed).duration_s.mean())

    def score(self, order: Order) -> float:
        """Return the mean cycle time of few cycles, s; every order has the same draws."""
        if order not in self.scored:
            self.scored[order] = self.rolled(order, CYCLES)
        return self.scored[order]

    def improve(self, order: Order, moves: int) -> None:
        """Try random moves of single tasks, or of those that stay together; keep what does not take longer."""
        for _ in range(moves):
            moved = self._moved(order)
            if moved and self.score(moved) <= self.score(order):
                order = moved

    def _moved(self, order: Order) -> Order | None:
        """Return the order with one task of an agent elsewhere, and with it those that stay together with it."""
        name = self.keys[int(self.rng.integers(len(order)))][0]
        groups: list[list[int]] = []
        for number in self._by_agent(order)[name]:
            if number in self.after:
                groups[-1].append(number)
            else:
                groups.append([number])
        group = groups.pop(int(self.rng.integers(len(groups))))
        groups.insert(int(self.rng.integers(len(groups) + 1)), group)
        return self._merged(self._by_agent([*(n for n in order if self.keys[n][0] != name), *chain(*groups)]))

    def best(self) -> list[Order]:
        """Return the best orders scored."""
        return sorted(self.scored, key=lambda order: self.scored[order])[:FINAL]

    def noise_s(self, order: Order) -> float:
        """Return the standard error of the mean of the rolled-out cycles, s."""
        took = roll_plan(self.model, self.plan(order), cycles=FINAL_CYCLES, seed=self.seed).duration_s
        return float(took.std(ddof=1) / np.sqrt(FINAL_CYCLES))


def _basis(search: _Search, runs: Sequence[Run], random: Sequence[Order]) -> tuple[list[list[PlannedTask]], str]:
    """Return the basis of comparison: at most FINAL logged orders of the same work, else random ones."""
    work = Counter(search.keys)
    same = {
        run.order: run for run in runs if Counter((a, t.task) for a, some in run.tasks.items() for t in some) == work
    }
    if same:
        plans = [plan_of(run) for run in list(same.values())[:FINAL]]
        return [[replace(task, not_before_s=None) for task in plan] for plan in plans], "logged orders"
    return [search.plan(order) for order in random[:FINAL]], "random orders"


def _estimates(model: TaskModelCard, plans: Sequence[Sequence[PlannedTask]], seed: int) -> list[CycleEstimate]:
    def refuse(_: TaskSequence, error: EstimateError) -> None:
        raise error

    asked = [TaskSequence.of_plan("planned" if n == 0 else f"{n}", plan) for n, plan in enumerate(plans)]
    found = {each.name: each for each in estimate_plans(model, asked, seed=seed, refused=refuse)}
    return [found[sequence.name] for sequence in asked]
