"""Search over orders of the same visits, scored on all operator tracks at once by the table of arrivals.

If there are few orders, all are tried. Otherwise three searches are combined: greedy (the visit with the least loss
comes next), Monte Carlo (random orders), and a local search from the best of both that moves one visit or swaps two
until no step improves the score.
"""

from __future__ import annotations

from dataclasses import replace
from math import factorial
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.estimate.plan.jobs import Jobs, tasks_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from cyclekit.estimate.cycle.transit import TransitTable
    from cyclekit.schema import Floats, Ints, Progress

    Order = tuple[str, ...]

FEW_ORDERS = 6000
"""Maximum number of orders for an exhaustive search (7! = 5040)."""
RANDOM_ORDERS = 400
STARTS = 4
"""Number of best random orders from which local searches start, in addition to the greedy order."""


class Scorer:
    """Durations of orders on the tracks `which`, shape (k,); None: all tracks.

    `executions`: number of independent operators of these tracks; None: orders are ranked by their means only.
    """

    def __init__(
        self,
        table: TransitTable,
        jobs: Jobs,
        *,
        which: Ints | None = None,
        seed: int = 0,
        executions: int | None = None,
    ) -> None:
        self._table, self.jobs, self._seed = table, jobs, seed
        self._rows, self._executions = which, executions

    @classmethod
    def of_unfinished(cls, scorer: Scorer) -> Scorer:
        """Return a scorer of unfinished orders: the robot does not return to the end after them."""
        unfinished = replace(scorer.jobs, end=None)
        return cls(scorer._table, unfinished, which=scorer._rows, seed=scorer._seed, executions=scorer._executions)

    @property
    def nominal_s(self) -> dict[str, float]:
        """Duration of each task without an operator, s."""
        return {task.task: task.nominal_s + task.dwell_s + task.wait_s for task in self._table.tasks}

    def durations(self, orders: Sequence[Order]) -> Floats:
        """Return the duration of each order on each track, shape (orders, k), s."""
        found = self._table.durations([tasks_of(self.jobs.places(order)) for order in orders], seed=self._seed)
        return found if self._rows is None else np.asarray(found[:, self._rows])

    def means(self, orders: Sequence[Order]) -> Floats:
        """Return the mean duration of each order, shape (orders,), s."""
        return np.asarray(self.durations(orders).mean(axis=1))

    def scores(self, orders: Sequence[Order]) -> Floats:
        """Return the scores that rank orders, shape (orders,), s: the mean plus its standard error.

        The minimum of many means is often due to a few operators. Of two orders with similar means, the one with less
        varying cycles is more likely to be as good with other operators.
        """
        found = self.durations(orders)
        means = np.asarray(found.mean(axis=1))
        if self._executions is None:
            return means
        with np.errstate(invalid="ignore"):  # abandoned cycles are inf
            return np.asarray(means + np.nan_to_num(found.std(axis=1)) / self._executions**0.5)


def best_order(scorer: Scorer, *, seed: int = 0, progress: Progress | None = None) -> tuple[Order, str, int]:
    """Return the best order found, the kind of search (`all orders` or `search`), and the number of orders scored."""
    tell = progress or (lambda fraction, text: None)
    jobs = scorer.jobs
    if factorial(len(jobs.visit)) <= FEW_ORDERS:
        orders = list(every_order(jobs))
        tell(0.5, f"trying {len(orders)} orders")
        searched = "all orders of logged tasks" if jobs.unlogged else "all orders"
        return orders[int(scorer.scores(orders).argmin())], searched, len(orders)
    rng = np.random.default_rng(seed)
    greedy = greedy_order(scorer)
    random = [random_order(jobs, rng) for _ in range(RANDOM_ORDERS)]
    ranked = [random[i] for i in np.argsort(scorer.scores(random))[:STARTS]]
    tried, found = RANDOM_ORDERS, []
    for number, start in enumerate([greedy, *ranked]):
        tell(number / (STARTS + 1), f"local search {number + 1} of {STARTS + 1}")
        order, score, count = _improved(scorer, start)
        found.append((score, order))
        tried += count
    return min(found)[1], "search", tried


def every_order(jobs: Jobs) -> Iterator[Order]:
    """Yield every allowed order once."""

    def following(done: Order, left: tuple[str, ...]) -> Iterator[Order]:
        if not left:
            yield done
        for name in jobs.next_of(left, done[-1] if done else None):
            yield from following((*done, name), tuple(without(left, name)))

    yield from following((), jobs.visit)


def greedy_order(scorer: Scorer) -> Order:
    """Return the order in which each next visit minimises the time so far relative to nominal time.

    Raises:
        EstimateError: As in `first_order`.
    """
    nominal, unfinished = scorer.nominal_s, Scorer.of_unfinished(scorer)

    def least_lost_first(done: Order, options: list[str]) -> list[str]:
        orders = [(*done, name) for name in options]
        free = np.array([sum(nominal[task] for task in tasks_of(unfinished.jobs.places(order))) for order in orders])
        return [options[i] for i in np.argsort(unfinished.means(orders) / free, kind="stable")]

    return first_order(scorer.jobs, least_lost_first)


def random_order(jobs: Jobs, rng: np.random.Generator) -> Order:
    """Return an allowed order; each next visit is drawn from the allowed ones.

    Raises:
        EstimateError: As in `first_order`.
    """

    def drawn(_: Order, options: list[str]) -> Iterator[str]:
        while options:
            chosen = str(rng.choice(options))
            options.remove(chosen)
            yield chosen

    return first_order(jobs, drawn)


def first_order(jobs: Jobs, ranked: Callable[[Order, list[str]], Iterable[str]]) -> Order:
    """Return the first allowed order found when next visits are tried in ranked order (depth-first).

    Raises:
        EstimateError: Every allowed order needs a task that was never logged.
    """
    dead: set[tuple[str | None, Order]] = set()  # states from which no order was found

    def completed(done: Order, left: list[str]) -> Order | None:
        last = done[-1] if done else None
        if not left:
            return done
        if (state := (last, tuple(sorted(left)))) in dead:
            return None
        options = jobs.next_of(left, last)
        for name in ranked(done, options) if options else ():
            if (found := completed((*done, name), without(left, name))) is not None:
                return found
        dead.add(state)
        return None

    if (order := completed((), list(jobs.visit))) is None:
        names = sorted(jobs.unlogged)
        seen = f"{jobs.shown}: every order needs a task that was never logged with a known speed scaling"
        raise EstimateError(f"{seen}: {some(names)}", cure="Log these tasks, or leave their places out.")
    return order


def some(names: Sequence[str], most: int = 8) -> str:
    """Return the first few of many names, and the number of others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _improved(scorer: Scorer, order: Order) -> tuple[Order, float, int]:
    """Improve an order by the best move or swap until none helps; return it, its score, and the number scored."""
    best, tried = float(scorer.scores([order])[0]), 1
    while True:
        around = [near for near in dict.fromkeys(_neighbours(order)) if scorer.jobs.allowed(near)]
        if not around:
            return order, best, tried
        scores = scorer.scores(around)
        tried += len(around)
        if scores.min() >= best - 1e-9:
            return order, best, tried
        order, best = around[int(scores.argmin())], float(scores.min())


def _neighbours(order: Order) -> Iterator[Order]:
    for i in range(len(order)):
        rest = order[:i] + order[i + 1 :]
        for j in range(len(order)):
            if j != i:
                yield (*rest[:j], order[i], *rest[j:])
        for j in range(i + 1, len(order)):
            swapped = list(order)
            swapped[i], swapped[j] = swapped[j], swapped[i]
            yield tuple(swapped)


def without(names: Sequence[str], name: str) -> list[str]:
    """Return the names with one `name` removed."""
    rest = list(names)
    rest.remove(name)
    return rest
