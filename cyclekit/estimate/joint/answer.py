"""Estimates for cells in which one agent waits for the other, and for plans of both agents."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.sequences import PLAN
from cyclekit.errors import EstimateError
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.joint.check import JointCheck, judge_joint
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.repetitions import cycles_per_resample
from cyclekit.estimate.joint.roll import JointCell, longest_s
from cyclekit.estimate.joint.shares import operator_shares, planned_shares, task_shares
from cyclekit.estimate.joint.stop_overs import with_stop_overs
from cyclekit.estimate.joint.unended import waits_without_source, waits_without_task
from cyclekit.estimate.limits import (
    limits_of_logs,
    no_answer,
    refuse_biased,
    with_work,
)
from cyclekit.estimate.ranked import Unranked
from cyclekit.estimate.result import SPLIT, CycleEstimate, TaskShare
from cyclekit.estimate.robot.nominal import NominalTask, nominal_tasks
from cyclekit.estimate.soundness import FEW_EXECUTIONS, MIN_SUPPORT, findings_of
from cyclekit.estimate.statistics.distribution import CycleDistribution
from cyclekit.estimate.statistics.resample import drawn_errors, interval_of_mean
from cyclekit.estimate.validation.question import LAID_OUT, ROLLED, VALIDATED, Altered, Question
from cyclekit.learning.networks.cell import trained_on
from cyclekit.learning.out_of_core import in_memory
from cyclekit.text.numbers import fixed, percent

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.cards.coupling import CommonPaceCard
    from cyclekit.estimate.joint.roll import Plan, RolledBoth
    from cyclekit.estimate.joint.stop_overs import StopOver
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.schema import Floats, Ints, Progress, Vector

    _Refuse = Callable[[TaskSequence, EstimateError], None]

CYCLES, OF_MANY, MANY, BEST = 1000, 120, 40, 12
"""Cycles per plan; with more than MANY plans, OF_MANY cycles each, then CYCLES for the BEST."""
WHY = "both agents rolled out together: learned safety function, logged walks and stays, who waits for whom"
WHY_ALONE = "robot rolled out with learned waits for signals, beside the logged speed or courses of people"
RESAMPLES = 1000
NOT_JUDGED = "too few of them can be rolled out"

ALONE = (
    "the plan has no task of the operator: nobody slows the robot, and it waits for nobody; name his tasks, or give "
    "the robot's places alone (places = [...]): his tasks are then drawn from the logs"
)
COMPOSED = (
    "no log has exactly as many visits to the places where one agent waits for the other: what the operator does "
    "between them is put together from parts of logged executions"
)


def waits_are_known(model: SafetyModel, altered: Altered | None = None) -> bool:
    """Return whether wait conditions of the agents are known, or were before the cell was altered."""
    card = altered.coupling if altered is not None else model.card.coupling
    return card is not None and (card.coupled or altered is not None)


def estimate_both(
    ask: Question,
    sequences: Sequence[TaskSequence],
    *,
    validate: bool,
    other_cell: bool,
    refuse: _Refuse,
    tell: Progress,
) -> list[Unranked]:
    """Return the expected cycle time of each sequence from a rollout of both agents.

    Args:
        ask: The question; its `check` is used if it is of joint rollouts.
        sequences: The sequences.
        validate: Validate by joint rollouts of the orders of logged executions, and correct the bias.
        other_cell: Estimate even if the model has a large bias on these logs.
        refuse: Called with each sequence that has no answer, and the reason.
        tell: Called with the fraction done and a text.

    Raises:
        ModelError: The model has a large bias on the logged executions.
        EstimateError: No operator was logged.
    """
    dataset, left_out = in_memory(ask.dataset)
    nominal: Mapping[str, NominalTask] = nominal_tasks(dataset)
    altered = ask.altered
    nominal = altered.tasks(nominal) if altered else nominal
    card = altered.coupling if altered else ask.model.card.coupling
    dynamics = altered.dynamics if altered else None
    cell = JointCell(ask.model, dataset, card, dynamics=dynamics, as_logged=ask.model.card.coupling)
    cell.pace = cell.work_pace = 1.0 / altered.pace if altered else 1.0
    answers = JointAnswers(ask, cell, nominal)
    judged = ask.check if isinstance(ask.check, JointCheck) else None
    if judged is None and validate and altered is None:
        tell(LAID_OUT, "validating on logged executions")
        judged = answers.check()
        tell(VALIDATED, "rolling out")
    if not other_cell:
        refuse_biased(judged, own=trained_on(ask.model.card, dataset))

    def rolling(done: float, text: str) -> None:
        tell(VALIDATED + (ROLLED - VALIDATED) * done, text)

    found = answers.found(sequences, judged, refuse, rolling)
    limits = [*([left_out] if left_out else []), *limits_of_logs(dataset, cell.model, cell.logged or None)]
    pace = () if cell.coupling is None or cell.coupling.pace is None else (cell.coupling.pace,)
    paced = [one.said for one in pace]
    entries = []
    for entry, means_s in found:
        entry, of_other_work, of_work = with_work(entry, _process_tasks(entry.places, nominal, cell))
        known = findings_of(
            cell.model, judged, dataset, executions=entry.executions, support=entry.support,
            validated=None if altered is not None else NOT_JUDGED if validate else "",
        )  # fmt: skip
        findings = (*of_other_work, *entry.findings, *known)
        entry = replace(entry, findings=findings, limits=(*of_work, *paced, *limits), pace=pace)
        entries.append(Unranked(entry, means_s))
    tell(1.0, "done")
    return entries


def _process_tasks(places: Sequence[str], nominal: Mapping[str, NominalTask], cell: JointCell) -> list[NominalTask]:
    """Return the robot's tasks of an order of places at whose goals it waits for nobody."""
    if places[:1] == (PLAN,):
        return []
    tasks = [nominal[f"{start}->{goal}"].of_work(places) for start, goal in pairwise(places)]
    return [task for task in tasks if cell.gates.own_s("robot", task.task.partition("->")[2]) is None]


def pace_errors(
    cell: JointCell, planner: Planner, sequences: Sequence[TaskSequence], *, seed: int
) -> dict[TaskSequence, float]:
    """Return the standard deviation of each mean because the operator's latest pace is uncertain, as a share.

    It is 0 where his pace did not change, and where cycles do not end.
    """
    pace = cell.coupling.pace if cell.coupling is not None else None
    if pace is None:
        return {}
    slower = cell.at_pace(*(1.0 if one is None else float(np.exp(one.error)) for one in (pace.work, pace.walk)))
    means = np.full((2, len(sequences)), np.nan)
    for each, makes, found in ((cell, planner, means[0]), (slower, Planner(slower, planner.nominal), means[1])):
        plans = [makes.plan(sequence) for sequence in sequences]
        until_s = max((longest_s(plan) for plan in plans), default=0.0)
        rolled = each.roll(plans, cycles=OF_MANY, seed=seed, until_s=until_s)
        found[:] = [np.nan if isinstance(one, EstimateError) else one.duration_s.mean() for one in rolled]
    ended = np.isfinite(means).all(axis=0)
    ratio = np.divide(means[1], means[0], out=np.ones(len(sequences)), where=ended)
    return dict(zip(sequences, np.abs(ratio - 1.0).tolist(), strict=True))


class JointAnswers:
    """Estimates of plans in one cell from joint rollouts."""

    def __init__(self, ask: Question, cell: JointCell, nominal: Mapping[str, NominalTask]) -> None:
        """Set the question, the cell and its nominal tasks."""
        self._ask, self._cell = ask, cell
        self._planner = Planner(cell, nominal)

    def check(self) -> JointCheck | None:
        """Return the validation by joint rollouts of the orders of logged executions; None with too few."""
        return judge_joint(self._cell, self._planner, levels=self._ask.quantiles, seed=self._ask.seed)

    def found(
        self, sequences: Sequence[TaskSequence], check: JointCheck | None, refuse: _Refuse, tell: Progress
    ) -> list[tuple[CycleEstimate, Vector]]:
        """Return the estimate of each sequence with an answer, and its mean in each resample (RESAMPLES,), s."""
        plans = {sequence: plan for sequence in sequences if (plan := self._plan(sequence, refuse)) is not None}
        rolled = self._rolled(plans, refuse, tell)
        through = self._through(rolled)
        drawn = resample_counts(self._ask.seed, cycles_per_resample(self._cell))
        weights = drawn / drawn.sum(axis=1, keepdims=True)
        shifts = session_shifts(self._ask.seed, self._cell.common)
        pace_error = pace_errors(self._cell, self._planner, list(rolled), seed=self._ask.seed)
        found = []

        def its_weights(cycles: RolledBoth) -> Floats:
            return weights if shifts is None else with_sessions(weights, shifts, cycles.shared)

        for sequence, cycles in rolled.items():
            problem = no_answer(self._ask, sequence, cycles, longest_s(cycles.plan))
            if problem is not None:
                refuse(sequence, problem)
                continue
            error = pace_error.get(sequence, 0.0)
            entry = self._entry(sequence, cycles, check, its_weights(cycles), error)
            if sequence in through:
                its, left_out = through[sequence]
                entry = with_stop_overs(entry, self._entry(sequence, its, check, its_weights(its), error), left_out)
            found.append(entry)
        return found

    def _through(
        self, rolled: Mapping[TaskSequence, RolledBoth]
    ) -> dict[TaskSequence, tuple[RolledBoth, list[StopOver]]]:
        """Return the cycles of sequences with the stop-overs of the operator that they leave out, and these."""
        found = {}
        for sequence, cycles in rolled.items():
            if (other := self._planner.through(sequence)) is None:
                continue
            asked, until_s = len(cycles.duration_s), longest_s(plan := self._planner.plan(other[0]))
            (its,) = self._cell.roll([plan], cycles=asked, seed=self._ask.seed, until_s=until_s)
            if not isinstance(its, EstimateError) and no_answer(self._ask, sequence, its, until_s) is None:
                found[sequence] = its, other[1]
        return found

    def _plan(self, sequence: TaskSequence, refuse: _Refuse) -> Plan | None:
        try:
            return self._planner.plan(sequence)
        except EstimateError as error:
            refuse(sequence, error)
        return None

    def _rolled(
        self, plans: dict[TaskSequence, Plan], refuse: _Refuse, tell: Progress
    ) -> dict[TaskSequence, RolledBoth]:
        """Return the cycles of plans; of many plans, the fastest are rolled out again with more cycles."""
        few = len(plans) <= MANY
        found = self._some(plans, CYCLES if few else OF_MANY, refuse, tell)
        if few:
            return found
        best = sorted(found, key=lambda each: float(found[each].duration_s.mean()))[:BEST]
        return found | self._some({each: plans[each] for each in best}, CYCLES, refuse, tell)

    def _some(
        self, plans: dict[TaskSequence, Plan], cycles: int, refuse: _Refuse, tell: Progress
    ) -> dict[TaskSequence, RolledBoth]:
        found: dict[TaskSequence, RolledBoth] = {}
        until_s = max((longest_s(plan) for plan in plans.values()), default=0.0)
        rolled = self._cell.roll(list(plans.values()), cycles=cycles, seed=self._ask.seed, until_s=until_s)
        for number, (sequence, cycle) in enumerate(zip(plans, rolled, strict=True)):
            tell(number / len(plans), f"rolling out {sequence.name}")
            if isinstance(cycle, EstimateError):
                refuse(sequence, cycle)
            else:
                found[sequence] = cycle
        return found

    def _entry(
        self,
        sequence: TaskSequence,
        cycles: RolledBoth,
        check: JointCheck | None,
        weights: Floats,
        pace_error: float,
    ) -> tuple[CycleEstimate, Vector]:
        ask, factor = self._ask, check.factor if check else 1.0
        durations = np.resize(cycles.duration_s, weights.shape[1]) * factor
        expected = float(durations.mean())
        means = weights @ durations
        error = float(np.hypot(check.model_error if check else 0.0, pace_error))
        judged = len(check.residuals) if check else FEW_EXECUTIONS
        low, high = interval_of_mean(
            means,
            model_error=error,
            judged=judged,
            bias_s=check.doubted_bias * expected if check else 0.0,
            seed=ask.seed,
        )
        shares = _slowed(task_shares(cycles), factor)
        split = {part: sum(getattr(share, part) for share in shares) for part in SPLIT}
        bias = check.doubted_bias if check else 0.0
        errors = drawn_errors(error, judged, ask.seed, count=len(weights))

        def single(cycles_s: Vector) -> Vector:
            return check.single(cycles_s) if check else cycles_s

        def band(ends_s: Vector) -> tuple[float, ...]:
            levels = (min(ask.quantiles), max(ask.quantiles)) if len(ask.quantiles) > 1 else ()
            return tuple(CycleDistribution(single(ends_s)).quantile(level) for level in levels)

        entry = CycleEstimate(
            name=sequence.name,
            places=sequence.places,
            expected_s=expected,
            expected_low_s=low,
            expected_high_s=high,
            distribution=CycleDistribution(single(durations), weights, errors, bias, executions=self._cell.executions),
            levels=ask.quantiles,
            **split,
            support=cycles.support,
            tracks=len(durations),
            limits=(),
            tasks=tuple(shares),
            safety_by_activity_s={name: lost for name, lost in cycles.activity_s.items() if lost > 0.0},
            durations_s=tuple(durations.tolist()),
            estimator=ask.estimator,
            why=WHY_ALONE if self._cell.unseen else WHY,
            executions=self._cell.executions,
            calibrated=check is not None and check.coverage is not None,
            takt_s=ask.takt_s,
            extrapolated=cycles.support < MIN_SUPPORT,
            operator=sequence.operator,
            asked=sequence.plan,
            check=check,
            plan=tuple(planned_shares(cycles, factor, band)),
            operator_at={} if len(cycles.operators) == 1 else operator_shares(cycles, expected / factor),
            idle_s=max(expected - sum(split.values()), 0.0),
            findings=tuple(_left_out(cycles, self._cell)),
        )
        return entry, means


def _left_out(cycles: RolledBoth, cell: JointCell) -> list[Finding]:
    """Return findings on the cycles and waits that the rollout of a plan leaves out."""
    until_s, part = longest_s(cycles.plan), cycles.left_out
    ended = (
        f"{percent(part, 1)} of the cycles are left out: they end in a deadlock or do not end within "
        f"{fixed(until_s, 0)} s"
    )
    unsourced = waits_without_source((cycles.plan.robot, *cycles.plan.operators), cell.coupling)
    told = waits_without_task(cycles.plan.robot, *cycles.plan.operators) if cycles.plan.both else ()
    alone = [ALONE] if cycles.plan.both and not cell.unseen and not cycles.plan.operators[0].tasks else []
    by_code = {
        "operator-left-out": alone,
        "cycles-left-out": [ended] if part else [],
        "composed": [COMPOSED] if cycles.plan.composed else [],
        "waits-left-out": [*unsourced, *told],
    }
    return [Finding(code, "amber", text) for code, texts in by_code.items() for text in texts]


def _slowed(shares: Sequence[TaskShare], factor: float) -> list[TaskShare]:
    """Return the split of cycles `factor` times as long: safety loss and wait, which are learned, absorb the change."""
    if factor == 1.0:
        return list(shares)
    open_s = sum(share.safety_loss_s + share.wait_s for share in shares)
    more = (factor - 1.0) * sum(share.expected_s for share in shares)
    times = max(1.0 + more / open_s, 0.0) if open_s > 0.0 else 1.0
    found = []
    for share in shares:
        lost, wait = share.safety_loss_s * times, share.wait_s * times
        whole = share.nominal_s + lost + share.dwell_s + wait
        found.append(TaskShare(share.task, whole, share.nominal_s, lost, share.dwell_s, wait))
    return found


def resample_counts(seed: int, count: int, cycles: int = CYCLES) -> Ints:
    """Return how often each cycle is drawn per resample, (RESAMPLES, cycles); a resample has `count` draws."""
    rng = np.random.default_rng(seed)
    return np.asarray(rng.multinomial(max(count, 2), np.full(cycles, 1.0 / cycles), RESAMPLES))


def session_shifts(seed: int, common: CommonPaceCard | None) -> Vector | None:
    """Return by how much the mean of what durations share is off in each resample, (RESAMPLES,), in its own spread.

    Few sessions of people who came once tell the mean pace less surely than so many executions would (Student's t).
    None where sessions do not differ, or where the same people come again.
    """
    if common is None or not common.between * common.once:
        return None
    drawn = np.random.default_rng(seed + 2).standard_t(max(common.sessions - 1, 1), RESAMPLES)
    return np.asarray(drawn * (common.between * common.once / common.sessions) ** 0.5)


def with_sessions(weights: Floats, shifts: Vector, shared: Vector) -> Floats:
    """Return the weights of cycles in resamples (R, K) with the mean of what durations share shifted in each.

    Args:
        weights: Weights; each row sums to 1.
        shifts: The shift in each resample, shape (R,).
        shared: Normal scores of the shared part in each cycle, repeated if there are fewer than K.
    """
    count = weights.shape[1]
    some = np.resize(shared, count)
    return np.asarray(weights + np.outer(shifts, some - some.mean()) / count)
