"""Effect of the order where no log shows people: durations of tasks, given where the robot was before.

An operator with a rhythm meets the robot again and again in some orders, and never in others: in a cell where both fill
two sides in turn, orders that change sides often take up to a tenth longer. No state of an unseen operator is needed to
learn that. The safety loss of a task is modelled as a sum over its time of a rate of the robot's region, and of rates
of pairs of regions: where the robot is, and where it was so many seconds ago. The rates are those of Bayesian linear
regression, whose two prior variances maximise the evidence (MacKay, Bayesian interpolation, Neural Computation 4,
1992). Losses within an execution depend on each other, so their sum has a variance of its own.

Most operators have no such rhythm. Pairs are used only where they raise the evidence by far more than chance does, and
predict the losses of orders that were left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.statistics.resample import RESAMPLES
from cyclekit.estimate.validation.logged import logged_sequences
from cyclekit.learning.unseen.fit import centres_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.schema import Bools, Floats, Ints, Points, Vector

REGIONS = 4
"""Number of regions of the TCP."""
STEP_S = 0.5
"""Time step on the nominal path, s."""
WINDOW_S = 6.0
"""Length of a window of time before, s."""
WINDOWS = 12
"""Number of windows: 72 s, longer than the round of an operator who fills two areas in turn."""
MIN_EVIDENCE = 20.0
"""Minimum gain in log evidence by pairs of regions. With 60 executions it is at most 12 in five simulated cells without
an effect, at least 54 in one with it."""
SHARE = 0.5
"""Weight beside the rollout: equal weights. Alone, the effect is too large in orders that were never logged."""
MIN_EXECUTIONS = 10
"""Minimum number of complete executions."""
LONGER = 1.05
"""Maximum length of an order, as a multiple of the longest logged one."""
FOLDS = 5
"""Number of parts of the orders, each left out once."""
BEYOND = 2.0
"""Minimum covariance of predicted and logged losses of orders left out, in standard errors."""
ITERATIONS = 30
"""Maximum number of updates of the prior variances."""
CONVERGED = 0.02
"""Change in log evidence below which the updates end."""
FIRST_ITERATIONS = 5
"""Minimum number of updates."""


class Regions:
    """Soft regions of the robot, and the share of time in each along the nominal path of each task."""

    def __init__(self, tasks: Mapping[str, NominalTask]) -> None:
        """Divide the paths of all tasks into regions."""
        self.free_s = {name: task.nominal_s + task.dwell_s + task.wait_s for name, task in tasks.items()}
        paths = {name: _path(task) for name, task in tasks.items()}
        self.centres_m = centres_of(np.concatenate(list(paths.values())), REGIONS)
        apart = np.linalg.norm(self.centres_m[:, None] - self.centres_m, axis=2)
        np.fill_diagonal(apart, np.inf)
        self._width_m = max(float(np.median(apart.min(axis=1))) / 2.0, 1e-3) if len(apart) > 1 else 1.0
        self._shares = {name: self._shares_of(path) for name, path in paths.items()}

    def _shares_of(self, path_m: Points) -> Floats:
        away = ((path_m[:, None] - self.centres_m) ** 2).sum(axis=2)
        near = np.exp(-(away - away.min(axis=1, keepdims=True)) / (2.0 * self._width_m**2))
        return np.asarray(near / near.sum(axis=1, keepdims=True))

    def order_free_s(self, tasks: Sequence[str]) -> float:
        """Return the duration of an order of tasks at full speed, s."""
        return sum(self.free_s[name] for name in tasks)

    @property
    def pairs(self) -> Bools:
        """Whether each column of `features` is of a pair of regions, shape (D,)."""
        count = len(self.centres_m)
        return np.arange(count + count**2 * WINDOWS) >= count

    def features(self, tasks: Sequence[str]) -> Floats:
        """Return the seconds that each task of an order spends in each region, and in each pair, shape (tasks, D)."""
        here = np.concatenate([self._shares[name] for name in tasks])
        steps = np.array([len(self._shares[name]) for name in tasks])
        step_s = np.repeat([self.free_s[name] for name in tasks] / steps, steps)
        until = np.vstack([np.zeros(here.shape[1]), np.cumsum(here, axis=0)])
        row, columns = np.arange(len(here)), [here]
        for number in range(WINDOWS):
            first, last = round((number + 1) * WINDOW_S / STEP_S), max(round(number * WINDOW_S / STEP_S), 1)
            since, to = np.maximum(row - first, 0), np.maximum(row - last + 1, 0)
            before = (until[np.maximum(to, since)] - until[since]) / (first - last + 1)
            columns.append((here[:, :, None] * before[:, None, :]).reshape(len(here), -1))
        ends = np.cumsum(steps)
        weighted = np.concatenate(columns, axis=1) * step_s[:, None]
        return np.asarray(np.add.reduceat(weighted, np.append(0, ends[:-1]), axis=0))


def _path(task: NominalTask) -> Points:
    """Return the TCP at about every STEP_S of the motion and the standstill of a task, shape (K, 3)."""
    whole_s = task.nominal_s + task.dwell_s + task.wait_s
    count = max(1, round(whole_s / STEP_S))
    when_s = (np.arange(count) + 0.5) * whole_s / count
    share = np.minimum(when_s / max(task.nominal_s, 1e-9), 1.0)
    return np.asarray(task.xyz_m[np.rint(share * (len(task.xyz_m) - 1)).astype(np.int64)])


class _Losses:
    """Sums over the logged tasks: within executions, and of whole executions."""

    def __init__(self, features: Sequence[Floats], lost_s: Sequence[Vector]) -> None:
        roots = [len(one) ** 0.5 for one in lost_s]
        each, self.lost_s = np.concatenate(features), np.concatenate(lost_s)
        sums = np.array([one.sum(axis=0) / root for one, root in zip(features, roots, strict=True)])
        self.sum_s = np.array([one.sum() / root for one, root in zip(lost_s, roots, strict=True)])
        self.between, self.between_s = sums.T @ sums, sums.T @ self.sum_s
        self.within = each.T @ each - self.between
        self.within_s = each.T @ self.lost_s - self.between_s


@dataclass(frozen=True)
class LossRates:
    """Regression of safety losses on features.

    Attributes:
        mean: Rate of each feature, shape (D,), s/s.
        covariance: Its covariance, shape (D, D).
        evidence: Log evidence of the model.
    """

    mean: Vector
    covariance: Floats
    evidence: float


def rates_of(losses: _Losses, group: Ints) -> LossRates:
    """Return the regression on the columns whose `group` is not negative; each group has one prior variance.

    Args:
        losses: The logged losses.
        group: Number of the group of each feature, shape (D,); -1 = not used.
    """
    used = np.flatnonzero(group >= 0)
    which, pick = group[used], np.ix_(used, used)
    within, between = losses.within[pick], losses.between[pick]
    within_s, between_s = losses.within_s[used], losses.between_s[used]
    size, tasks, executions = np.bincount(which), len(losses.lost_s), len(losses.sum_s)
    inner, outer = max(float(losses.lost_s.var()), 1e-9), max(float(losses.sum_s.var()), 1e-9)
    power = np.bincount(which, np.diag(within + between)) / size / tasks
    prior = inner / np.maximum(power, 1e-12) / size
    squares = float(losses.lost_s @ losses.lost_s), float(losses.sum_s @ losses.sum_s)
    last = -np.inf
    for turn in range(ITERATIONS):
        precision = within / inner + between / outer + np.diag(1.0 / prior[which])
        covariance, target = np.linalg.inv(precision), within_s / inner + between_s / outer
        mean = covariance @ target
        noise = (tasks - executions) * np.log(inner) + executions * np.log(outer)
        fit = (squares[0] - squares[1]) / inner + squares[1] / outer - float(target @ mean)
        spread = float(np.linalg.slogdet(precision)[1] + np.log(prior[which]).sum())
        evidence = -0.5 * (noise + spread + fit)
        if abs(evidence - last) < CONVERGED and turn > FIRST_ITERATIONS:
            break
        last = evidence
        known = np.maximum(size - np.bincount(which, np.diag(covariance)) / prior, 1e-9)
        prior = np.maximum(np.bincount(which, mean**2) / known, 1e-7)
        inside_s = squares[0] - squares[1] + float(mean @ (within @ mean - 2.0 * within_s))
        sums_s = squares[1] + float(mean @ (between @ mean - 2.0 * between_s))
        inner = max(inside_s / max(tasks - executions - float((covariance * within).sum()) / inner, 1.0), 1e-9)
        outer = max(sums_s / max(executions - float((covariance * between).sum()) / outer, 1.0), 1e-9)
    full = np.zeros(len(group))
    full[used] = mean
    every = np.zeros((len(group), len(group)))
    every[pick] = covariance
    return LossRates(full, every, evidence)


@dataclass(frozen=True)
class OrderEffect:
    """Expected cycle times by the tasks before each task, at the level of the logs.

    Attributes:
        regions: Regions of the robot.
        rates: Loss rates of regions and pairs.
        longest_s: Longest logged order at full speed, s.
        level: Factor with which the logged orders take as long in total as they took.
    """

    regions: Regions
    rates: LossRates
    longest_s: float
    level: float = 1.0

    def covers(self, tasks: Sequence[str]) -> bool:
        """Return whether an order is hardly longer than the longest logged one: later, operators may have gone."""
        return self.regions.order_free_s(tasks) <= LONGER * self.longest_s

    def expected_s(self, tasks: Sequence[str]) -> float:
        """Return the expected cycle time of an order of tasks, s."""
        free_s = self.regions.order_free_s(tasks)
        return self.level * (free_s + float(self.regions.features(tasks).sum(axis=0) @ self.rates.mean))

    def uncertain(self, tasks: Sequence[str]) -> Vector:
        """Return factors on `expected_s` by draws of the rates, the same draws for each order, shape (RESAMPLES,)."""
        change_s = self._draws @ self.regions.features(tasks).sum(axis=0)
        return np.asarray(1.0 + self.level * change_s / self.expected_s(tasks))

    @cached_property
    def _draws(self) -> Floats:
        values, vectors = np.linalg.eigh(self.rates.covariance)
        normal = np.random.default_rng(0).standard_normal((RESAMPLES, len(values)))
        return np.asarray(normal * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)


def order_effect(dataset: Dataset) -> OrderEffect | None:
    """Return the effect of the tasks before each task; None if the logs do not show one."""
    nominal = nominal_tasks(dataset)
    orders, took_s = logged_orders(dataset, nominal)
    return order_effect_of(nominal, orders, took_s)


def order_effect_of(
    nominal: Mapping[str, NominalTask], orders: Sequence[tuple[str, ...]], took_s: Sequence[Vector]
) -> OrderEffect | None:
    """Return the effect of the tasks before each task; None if the logs do not show one.

    Args:
        nominal: The tasks as programmed.
        orders: Tasks of each logged execution.
        took_s: Their durations, s.
    """
    if len(orders) < MIN_EXECUTIONS or len(set(orders)) < MIN_EXECUTIONS:
        return None
    regions = Regions({name: nominal[name] for name in dict.fromkeys(task for order in orders for task in order)})
    found = {order: regions.features(order) for order in set(orders)}
    lost_s = [took - [regions.free_s[name] for name in order] for order, took in zip(orders, took_s, strict=True)]
    features = [found[order] for order in orders]
    rates, plain = _with_and_without(_Losses(features, lost_s), regions.pairs)
    if rates.evidence - plain.evidence < MIN_EVIDENCE or not _holds_elsewhere(orders, features, lost_s, regions.pairs):
        return None
    sums_s = sum(float(one.sum()) for one in took_s)
    unit = OrderEffect(regions, rates, max(map(regions.order_free_s, orders)))
    return replace(unit, level=sums_s / sum(map(unit.expected_s, orders)))


def _with_and_without(losses: _Losses, pairs: Bools) -> tuple[LossRates, LossRates]:
    """Return the regression with pairs of regions, and the one without."""
    return rates_of(losses, pairs.astype(np.int64)), rates_of(losses, -pairs.astype(np.int64))


def _holds_elsewhere(
    orders: Sequence[tuple[str, ...]], features: Sequence[Floats], lost_s: Sequence[Vector], pairs: Bools
) -> bool:
    """Return whether pairs predict losses of orders that were left out better than chance (cross-validation).

    Executions of one order count as one case: they may share what no other order has.
    """
    number = {order: count for count, order in enumerate(dict.fromkeys(orders))}
    fold = np.array([number[order] for order in orders]) % FOLDS
    products = np.zeros(len(number))
    for part in range(FOLDS):
        inside, outside = np.flatnonzero(fold != part).tolist(), np.flatnonzero(fold == part).tolist()
        losses = _Losses([features[k] for k in inside], [lost_s[k] for k in inside])
        rates, plain = _with_and_without(losses, pairs)
        for k in outside:
            sums = features[k].sum(axis=0)
            usual_s = float(sums @ plain.mean)
            predicted_s, logged_s = float(sums @ rates.mean) - usual_s, float(lost_s[k].sum()) - usual_s
            products[number[orders[k]]] += predicted_s * logged_s
    return float(products.sum()) > BEYOND * float(np.sqrt((products**2).sum()))


def logged_orders(dataset: Dataset, nominal: Mapping[str, NominalTask]) -> tuple[list[tuple[str, ...]], list[Vector]]:
    """Return the tasks of each complete, uninterrupted execution with an operator, and their durations, s."""
    empty = {one.execution for one in dataset.card.executions if one.reference}
    rows = dataset.whole_tasks().filter(pl.col("safety_loss_s").is_not_null()).sort("execution", "index")
    parts = {str(name): part for (name,), part in rows.group_by(["execution"], maintain_order=True)}
    orders, took_s = [], []
    for one in logged_sequences(dataset, nominal):
        part = parts.get(one.name)
        if one.name not in empty and part is not None and tuple(part["task"]) == tuple(one.tasks):
            orders.append(tuple(one.tasks))
            took_s.append((part["end_s"] - part["start_s"]).to_numpy())
    return orders, took_s
