"""Validation of joint rollouts on the orders of logged executions: bias, and the spread of single cycles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, TypedDict

import numpy as np
import polars as pl
from scipy.special import stdtrit

from cyclekit.dataset.cards.notes import UNPROVEN
from cyclekit.errors import EstimateError
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.repetitions import repetitions
from cyclekit.estimate.joint.roll import longest_s
from cyclekit.estimate.joint.unended import lacks_visit
from cyclekit.estimate.joint.unexplained import unexplained_waits
from cyclekit.estimate.robot.safety import OnStates
from cyclekit.estimate.statistics.bias import bias_of
from cyclekit.estimate.statistics.by_order import error_by_order
from cyclekit.estimate.statistics.conformal import with_expected
from cyclekit.estimate.validation.check import FEW_EXECUTIONS, MAX_EXECUTIONS, MIN_EXECUTIONS, OWN_BIAS, Check, compare
from cyclekit.estimate.validation.logged import logged_durations, logged_sequences
from cyclekit.estimate.validation.several import open_wait
from cyclekit.text.numbers import fixed, percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.estimate.joint.roll import JointCell, RolledBoth
    from cyclekit.schema import Floats, Vector

DRAWS = 60
"""Number of cycles rolled out per logged execution."""
FEWEST, USUAL = 5, 40
"""Numbers of executions below which intervals of single cycles do not become wider, and with which rollouts were found
to scatter as the logs do."""
LEAST_SPREAD = 0.5
"""Minimum standard deviation of rolled-out cycles, as a share of the usual difference of logged cycles from them:
cycles that seem not to vary would otherwise make the scores of all others huge."""
MIDDLE = 0.6745
"""Median absolute value of a standard normal distribution."""
MOST = 0.5
"""Minimum share of the executions with each visit of the operator for which the robot waits, to use these alone."""
SAME_PACE = 0.03
"""Difference of the logarithms of paces of the operator that count as one."""


class _Scatter(TypedDict, total=False):
    """How single cycles scatter: attributes of a `JointCheck`."""

    scores: tuple[float, ...]
    ranks: tuple[float, ...]
    least_spread: float


@dataclass(frozen=True)
class JointCheck(Check):
    """Comparison of joint rollouts with the logs.

    Attributes:
        scores: Differences of logged cycles from the means of their rollouts, in standard deviations of these, if they
            scatter more than the rollouts; else empty.
        ranks: Shares of rolled-out cycles that are shorter than the logged one, and PRIOR evenly spread ones, if
            `scores` is empty; empty with few executions.
        widening: Factor on the deviations of cycles from their mean, without `scores`: above 1 with few executions.
        least_spread: Minimum standard deviation of rolled-out cycles for `scores`, as a share of their mean.
        unexplained_s: Mean wait of the robot per execution without a known condition, s.
        by_order: Standard deviation of the error of another order, from that between logged ones, as a share of the
            duration; it widens the interval of the mean.
        order_shown: Whether that is beyond chance.
        missed: Number of executions without a visit of the operator for which the robot waited; they are not compared.
        unended: Number of executions whose rollouts end in a deadlock or do not end; they are not compared.
    """

    scores: tuple[float, ...] = ()
    ranks: tuple[float, ...] = ()
    widening: float = 1.0
    least_spread: float = 0.0
    unexplained_s: float = 0.0
    by_order: float = 0.0
    order_shown: bool = False
    missed: int = 0
    unended: int = 0

    @property
    def model_error(self) -> float:
        """As of `Check`, with the error that depends on the order."""
        return float(np.hypot(super().model_error, self.by_order))

    @property
    def look_at(self) -> str:
        """Where to look for the cause of a bias first: what ends the waits is the usual one."""
        return (
            "log the buttons, bits and sensors that end waits of robot and operator, or give these waits in [[waits]] "
            "of the cell file; also look at"
        )

    @property
    def with_own(self) -> str:
        """What the executions were rolled out with to find the bias."""
        return "their own orders of robot and operator"

    @property
    def with_others(self) -> str:
        """What they were rolled out with to find the coverage."""
        return "the same orders in simulated cycles"

    @property
    def doubted_bias(self) -> float:
        """Bias without a known cause, as a share of the duration: it is corrected, but may differ for other orders."""
        return (abs(self.own_bias) if self.biased(OWN_BIAS) else 0.0) + self.open_wait

    @property
    def findings(self) -> tuple[Finding, ...]:
        """As of `Check`, with what was not compared, depends on the order, or waits for something unknown."""
        found = [*super().findings]
        if self.missed:
            every = self.missed + self.unended + self.executions
            text = (
                f"in {self.missed} of {every} logged executions a visit of the operator was missed for which the robot "
                "waited: they are not in the validation"
            )
            found.append(Finding("missed-visits", "amber", text, "look at his track there"))
        if self.unended:
            text = (
                f"{self.unended} of {self.unended + self.executions} logged orders end in a deadlock or do not end "
                "when they are rolled out: they are not in the validation, and the waits learned are wrong for them"
            )
            found.append(
                Finding("deadlocks", "amber", text, "give the waits in [[waits]] of the cell file", covered=False)
            )
        if self.order_shown:
            text = (
                "something that depends on the order was not learned: logged orders differ from their rollouts beyond "
                f"chance; the interval of the mean is wider by that (standard deviation {percent(self.by_order, 1)})"
            )
            found.append(Finding("order", "amber", text))
        if self.unexplained_s:
            text = (
                f"the robot waits {fixed(self.unexplained_s, 1)} s in an execution for something that no "
                "condition explains; "
                "in other orders it may wait longer or shorter, and the interval of the mean is wider by that"
            )
            found.append(Finding("unexplained-waits", "amber", text))
        return tuple(found)

    def single(self, cycles_s: Vector) -> Vector:
        """Return corrected cycles (K,), s, as equally probable single ones, conformal with the logged executions.

        A rollout has the shape of the cycles of each order. So the cycle of each level is the one at the level that
        logged executions have in their own rollouts. If these are wider than the rollouts, their scores in standard
        deviations count.
        """
        mean_s, count = float(np.mean(cycles_s)), len(cycles_s)
        levels = np.arange(1, count + 1) / (count + 1)
        if self.scores:
            spread_s = max(float(np.std(cycles_s, ddof=1)), self.least_spread * mean_s)
            ordered = mean_s + spread_s * np.quantile(np.array(self.scores), levels, method="weibull")
        else:
            at = np.quantile(np.array(self.ranks), levels, method="weibull") if self.ranks else levels
            ordered = mean_s + self.widening * (np.quantile(cycles_s, at) - mean_s)
        found = np.empty(count)
        found[np.argsort(cycles_s, kind="stable")] = ordered
        return found


def judge_joint(cell: JointCell, planner: Planner, *, levels: Sequence[float], seed: int) -> JointCheck | None:
    """Roll out the orders of logged executions and compare; None if fewer than MIN_EXECUTIONS of them end.

    Args:
        cell: The cell.
        planner: Makes the plans of these orders.
        levels: Quantile levels that the estimate will report.
        seed: Seed of the draws.
    """
    rolled = roll_logged(cell, planner, seed=seed)
    sequences, simulated = rolled.sequences, rolled.cycles_s
    if len(sequences) < MIN_EXECUTIONS:
        return None
    logged = logged_durations(cell.dataset, sequences)
    unseen = set(cell.model.card.held_out)
    held_out = np.array([each.name in unseen for each in sequences])
    means = simulated.mean(axis=1)
    found = compare(logged, means, simulated, held_out, levels)
    off = logged / means - 1.0  # the chance of a cycle is in the logged duration, which therefore is the numerator
    bias = bias_of(-off / (1.0 + off.mean()), held_out)
    found = replace(found, own_bias=bias.bias, own_error=bias.error)
    enough = len(sequences) >= FEW_EXECUTIONS
    scatter = _scatter(logged, simulated * found.factor) if enough else _Scatter()
    mean_s = float(logged.mean())
    learned = cell.coupling is not None and cell.coupling.coupled
    by_order, shown = _by_order(off, sequences, cell, simulated)
    waits = unexplained_waits(cell.dataset, [each.name for each in sequences], mean_s, learned=learned)
    unseen_s = float(np.hypot(waits.by_order_s, _unseen_people_s(cell, [each.name for each in sequences])))
    ours = {
        **scatter,
        "widening": widening(len(sequences), repetitions(cell)),
        "unexplained_s": waits.wait_s,
        "unseen_error": unseen_s / mean_s,
        "open_wait": open_wait(cell.dataset, [each.name for each in sequences], mean_s),
        "missed": rolled.missed,
        "unended": rolled.unended,
        "by_order": by_order,
        "order_shown": shown,
    }
    return JointCheck(**{**vars(found), **ours})


class LoggedRollouts(NamedTuple):
    """Rollouts of the orders of logged executions.

    Attributes:
        sequences: The orders, in the order of the executions; their names are those of the executions.
        cycles_s: Durations of their cycles, shape (orders, DRAWS), s.
        missed: Number of executions left out because a visit of the operator was missed.
        unended: Number of executions left out because some of their cycles do not end.
    """

    sequences: list[TaskSequence]
    cycles_s: Floats
    missed: int
    unended: int


def roll_logged(cell: JointCell, planner: Planner, *, seed: int) -> LoggedRollouts:
    """Roll out the orders of logged executions, evenly spaced ones if there are more than MAX_EXECUTIONS."""
    sequences = [each for each in logged_sequences(cell.dataset, planner.nominal) if each.name in cell.logged]
    if len(sequences) > MAX_EXECUTIONS:
        sequences = [sequences[i] for i in np.linspace(0, len(sequences) - 1, MAX_EXECUTIONS).astype(int)]
    orders = {each.name: tuple(visit.place for visit in cell.logged[each.name]) for each in sequences}
    every = [replace(each, operator=orders[each.name]) for each in sequences]
    whole = with_every_visit(planner, every)
    rolled = _at_their_paces(cell, planner, whole, seed)
    ended = [
        (sequence, np.resize(cycles.duration_s, DRAWS))
        for sequence, cycles in zip(whole, rolled, strict=True)
        if not isinstance(cycles, EstimateError) and np.isfinite(cycles.duration_s).all()
    ]
    cycles_s = np.array([cycles for _, cycles in ended]).reshape(-1, DRAWS)
    return LoggedRollouts([each for each, _ in ended], cycles_s, len(every) - len(whole), len(whole) - len(ended))


def with_every_visit(planner: Planner, sequences: list[TaskSequence]) -> list[TaskSequence]:
    """Return the executions in which each visit of the operator was seen for which the robot waited; all if few are.

    A rollout of the others lacks a wait, so it is too short, and no bias of the model.
    """
    plans = [planner.plan(each) for each in sequences]
    lack = [any(lacks_visit(plan.robot, operator) for operator in plan.operators) for plan in plans]
    whole = [each for each, lacks in zip(sequences, lack, strict=True) if not lacks]
    return whole if len(whole) >= max(MOST * len(sequences), MIN_EXECUTIONS) else sequences


def _by_order(off: Vector, sequences: Sequence[TaskSequence], cell: JointCell, simulated: Floats) -> tuple[float, bool]:
    """Return the error due to the order of the robot, of the operator or of both, and whether it is beyond chance.

    The largest that is shown, or of all if none is. With a model of states it is none.

    Where waits were seen and nothing is known that ends them, all that single executions are off by more than their
    rollouts scatter, shape (E, K), may be due to the order.
    """
    if isinstance(cell.model, OnStates):
        return 0.0, False
    if any(one.code == UNPROVEN for one in cell.model.card.warnings):
        own = float((simulated.std(axis=1, ddof=1) / simulated.mean(axis=1)).mean())
        error = float(np.sqrt(max(off.var(ddof=1) - own**2, 0.0)))
        return error, error > 0.0
    orders = [(sequence.places, sequence.operator) for sequence in sequences]
    groups: list[list[object]] = [[robot for robot, _ in orders], [operator for _, operator in orders], [*orders]]
    return max((error_by_order(off, some) for some in groups), key=lambda one: one[::-1])


def widening(executions: int, count: int) -> float:
    """Return the factor on deviations of single cycles from their mean; 1 with USUAL executions or more.

    It is Student's factor of a prediction interval: the scatter is known from so many executions, and the mean of each
    part of a cycle from `count` repetitions.
    """
    few = _student(max(executions, FEWEST)) * (1.0 + 1.0 / max(count, FEWEST)) ** 0.5
    return float(max(few / (_student(USUAL) * (1.0 + 1.0 / USUAL) ** 0.5), 1.0))


def _student(executions: int) -> float:
    return float(stdtrit(executions - 1, 0.95))


def _at_their_paces(
    cell: JointCell, planner: Planner, sequences: Sequence[TaskSequence], seed: int
) -> list[RolledBoth | EstimateError]:
    """Return the cycles of logged executions, each at about the operator's pace in it."""
    paces = [np.round(np.log(cell.paces.get(each.name, (1.0, 1.0))) / SAME_PACE).tolist() for each in sequences]
    found: dict[str, RolledBoth | EstimateError] = {}
    for pace in sorted({(work, walk) for work, walk in paces}):
        mine = [each for each, its in zip(sequences, paces, strict=True) if tuple(its) == pace]
        then, way = cell, planner
        if any(pace):
            then = cell.at_pace(*np.exp(SAME_PACE * np.array(pace)).tolist())
            way = Planner(then, planner.nominal)
        plans = [way.plan(each) for each in mine]
        until_s = max((longest_s(plan) for plan in plans), default=0.0)
        rolled = then.roll(plans, cycles=DRAWS, seed=seed, until_s=until_s)
        found |= zip((each.name for each in mine), rolled, strict=True)
    return [found[each.name] for each in sequences]


def _unseen_people_s(cell: JointCell, executions: Sequence[str]) -> float:
    """Return how far an order may move the time lost to people in an execution where no log shows them, s.

    That is the safety loss and, where one operator serves several places in turn, also the waits for him: the order
    in which he will serve them is unknown.
    """
    if not isinstance(cell.model, OnStates):
        return 0.0
    in_turn = cell.coupling is not None and cell.coupling.in_turn is not None
    parts = [pl.col(name).fill_null(0.0) for name in ("safety_loss_s", "wait_s")[: 1 + in_turn]]
    lost = cell.dataset.tasks().filter(pl.col("execution").is_in(list(executions)))
    sums = lost.group_by("execution").agg(s=pl.sum_horizontal(parts).sum())["s"].to_numpy()
    return cell.model.unseen_error * float(sums.std(ddof=1)) if len(sums) > 1 else 0.0


def _scatter(logged: Vector, simulated: Floats) -> _Scatter:
    """Return `scores` and `least_spread` of logged cycles (E,) in rollouts (E, K) that are too narrow, else `ranks`."""
    ranks = ((simulated < logged[:, None]).sum(axis=1) + 0.5) / (simulated.shape[1] + 1)
    expected = with_expected(ranks, np.array([0.0, 1.0]))
    if len(expected) > len(ranks):
        return {"ranks": tuple(expected.tolist())}
    means = simulated.mean(axis=1)
    off = logged - means
    least = LEAST_SPREAD * float(np.median(np.abs(off) / means)) / MIDDLE
    spread_s = np.maximum(simulated.std(axis=1, ddof=1), np.maximum(least * means, 1e-9))
    return {"scores": tuple((off / spread_s).tolist()), "least_spread": least}
