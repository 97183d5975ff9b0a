"""Search for the fastest order of both agents, if one waits for the other or the jobs include both agents' work."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.errors import EstimateError
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell
from cyclekit.estimate.joint.search import Pair, best_pairs, mean_times, orders_to_try, rolled_cycles
from cyclekit.estimate.plan.jobs import ROW, Jobs
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.statistics.resample import RESAMPLES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.joint.legs import Agenda
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.estimate.validation.check import Check
    from cyclekit.schema import Floats, Ints, Progress, Vector

ALL_PAIRS = 60_000
"""Maximum number of pairs of orders for an exhaustive search."""
RANDOM = 24
"""Number of random orders to compare with."""


class PairSearch:
    """The orders of robot and operator that jobs allow."""

    def __init__(self, model: SafetyModel, dataset: Dataset, jobs: Jobs, seed: int) -> None:
        """Generate the orders.

        Raises:
            UnknownName: A place does not exist.
            EstimateError: No order of logged tasks is allowed, or no logged operator order fits.
        """
        self.cell = JointCell(model, dataset, model.card.coupling)
        self._planner, self._jobs = Planner(self.cell, nominal_tasks(dataset)), jobs
        self.robots = orders_to_try(jobs, seed)
        self.operators: list[tuple[str, ...]] = [jobs.operator] if jobs.operator else []
        if len(jobs.operator) > 1:
            mine = replace(
                jobs, visit=jobs.operator, start="", end=None, via=None, before=(), operator=(), unlogged=frozenset()
            )
            self.operators = orders_to_try(mine, seed)
        plans = [self._planner.plan(self.sequence(robot, None, "order")) for robot in self.robots]
        self.robot_agendas = [plan.robot for plan in plans]
        self.operator_agendas: Sequence[Agenda] = [
            self._planner.operator(self._operator_places(order), jobs.shown) for order in self.operators
        ] or plans[0].operators

    def sequence(self, robot: tuple[str, ...], operator: tuple[str, ...] | None, name: str) -> TaskSequence:
        """Return orders as a sequence: a plan of both agents, or the robot's places only."""
        places = self._jobs.places(robot)
        if operator is None:
            known = self._operator_places(self.operators[0]) if getattr(self, "operators", None) else None
            return TaskSequence(name, places, known)
        plan = [PlannedTask("robot", f"{a}->{b}") for a, b in pairwise(places)]
        plan += [PlannedTask("operator", place) for place in self._operator_places(operator)]
        return TaskSequence.of_plan(name, plan)

    def pairs(self) -> tuple[list[Pair], int]:
        """Return the fastest pairs by mean times, and the number of pairs evaluated.

        With too many pairs: all orders of the operator with a sample of the robot's; all of the robot's with the best
        of those; all of the operator's with the best of these.
        """
        robots, operators = np.arange(len(self.robot_agendas)), np.arange(len(self.operator_agendas))
        looked = 0
        if self.operators and len(robots) * len(operators) > ALL_PAIRS:
            some = np.unique(np.linspace(0, len(robots) - 1, ALL_PAIRS // len(operators)).astype(np.int64))
            first_s = self._means_s(some, operators)
            best = np.argsort(first_s.min(axis=0), kind="stable")[: max(1, ALL_PAIRS // len(robots))]
            second_s = self._means_s(robots, best)
            robots = np.argsort(second_s.min(axis=1), kind="stable")[: len(some)]
            looked = first_s.size + second_s.size
        means_s = self._means_s(robots, operators)
        found = best_pairs(means_s if self.operators else _mean_of_ended(means_s))
        numbered = [replace(pair, robot=int(robots[pair.robot])) for pair in found]
        return numbered, looked + means_s.size

    def _means_s(self, robots: Ints, operators: Ints) -> Floats:
        some = [self.robot_agendas[n] for n in robots.tolist()]
        others = [self.operator_agendas[n] for n in operators.tolist()]
        return mean_times(self.cell, some, others, both=bool(self.operators))

    def sequence_of(self, robot: int, operator: int, name: str) -> TaskSequence:
        """Return a pair of orders, given by numbers, as a sequence."""
        return self.sequence(self.robots[robot], self.operators[operator] if self.operators else None, name)

    def cycles_s(self, sequences: Sequence[TaskSequence], seed: int) -> list[Vector]:
        """Return the durations of cycles of each sequence, s; inf for a deadlock."""
        found = rolled_cycles(self.cell, [self._planner.plan(each) for each in sequences], seed)
        return [np.full(1, np.inf) if each is None else each for each in found]

    def _operator_places(self, order: tuple[str, ...]) -> tuple[str, ...]:
        places = [place for job in order for place in job.split(ROW)]
        end = [self._jobs.operator_end] if self._jobs.operator_end else []
        return self.cell.segments.stop_overs.through([*places, *end])


def _mean_of_ended(found: Floats) -> Floats:
    """Return the mean over the operators with which a cycle ends, shape (robots, 1)."""
    ends = np.isfinite(found)
    total = np.where(ends, found, 0.0).sum(axis=1)
    return np.where(ends.any(axis=1), total / np.maximum(ends.sum(axis=1), 1), np.inf)[:, None]


def best_of_both(
    model: SafetyModel,
    dataset: Dataset,
    jobs: Jobs,
    *,
    seed: int,
    validate: bool,
    check: Check | None,
    other_cell: bool,
    tell: Progress,
) -> tuple[TaskSequence, tuple[str, ...], CycleEstimate, tuple[float, float, float], int]:
    """Search the orders of both agents.

    Returns:
        The best pair as a sequence, the robot's order, its estimate, its saving over random orders (mean and 95 %
        interval, s), and the number of pairs evaluated.

    Raises:
        EstimateError: Every pair of orders ends in a deadlock.
    """
    search = PairSearch(model, dataset, jobs, seed)
    tell(0.1, f"{len(search.robots)} orders of the robot, {max(len(search.operators), 1)} of the operator")
    pairs, looked = search.pairs()
    if not pairs:
        raise EstimateError(
            f"{jobs.shown}: every order ends in a deadlock of robot and operator",
            cure="Give the operator the jobs that the robot waits for, and the other way round.",
        )
    tell(0.5, f"rolling out the best {len(pairs)}, and {RANDOM} random ones")
    best = [search.sequence_of(pair.robot, pair.operator, "planned") for pair in pairs]
    cycles = search.cycles_s(best, seed)
    scores = [
        each.mean() + each.std() / search.cell.executions**0.5 if np.isfinite(each).all() else np.inf for each in cycles
    ]
    number = int(np.argmin(scores))
    rng = np.random.default_rng(seed)
    others = [
        search.sequence_of(
            int(rng.integers(len(search.robots))), int(rng.integers(max(len(search.operators), 1))), "drawn"
        )
        for _ in range(RANDOM)
    ]
    drawn = [each for each in search.cycles_s(others, seed) if np.isfinite(each).all()]
    (mine,) = estimate(
        model,
        dataset,
        [best[number]],
        seed=seed,
        validate=validate,
        check=check,
        other_cell=other_cell,
        extrapolate=True,
    )
    saved = np.mean(drawn, axis=0) - cycles[number] if drawn else np.zeros(1)
    return best[number], search.robots[pairs[number].robot], mine, _saved(saved, seed), looked


def _saved(saved_s: Floats, seed: int) -> tuple[float, float, float]:
    drawn = np.random.default_rng(seed).choice(saved_s, (RESAMPLES, len(saved_s))).mean(axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975)).tolist()
    return float(saved_s.mean()), low, high
