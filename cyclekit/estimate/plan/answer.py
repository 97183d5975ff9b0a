"""The order found, and what it saves beside other operators than those that it was chosen with."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.unknown_height import height_notes
from cyclekit.errors import EstimateError, ModelError, UnknownName, command_line
from cyclekit.estimate.baseline import LOGGED, NOTHING, baseline_of
from cyclekit.estimate.cycle.transit import TransitTable, transit_table
from cyclekit.estimate.finding import Finding, light_of
from cyclekit.estimate.joint.answer import waits_are_known
from cyclekit.estimate.limits import ENDLESS, refuse_unknown_mover, validated
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.plan.both import best_of_both
from cyclekit.estimate.plan.jobs import ROW
from cyclekit.estimate.plan.search import Scorer, best_order, first_order, random_order
from cyclekit.estimate.robot.nominal import NominalTask, nominal_tasks
from cyclekit.estimate.robot.signal_states import on_states_of
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.statistics.resample import resampled
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit.learning.networks.cell import refuse_other_cell
from cyclekit.parallel.one_thread import one_thread
from cyclekit.text.numbers import decimals_of, difference, fixed, seconds, with_interval
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import polars as pl

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.baseline import Baseline
    from cyclekit.estimate.plan.jobs import Jobs
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.estimate.validation.check import Check
    from cyclekit.plots.drawing import Drawing
    from cyclekit.schema import Floats, Progress

    Order = tuple[str, ...]

WALKED = 10
"""Number of different orders to compare with that are simulated; of more, the rest only use the table of arrivals."""
RANDOM = "random orders"
"""What the order found is compared with where no execution of the same work was logged."""
RANDOM_BASIS = 200
"""Number of random orders to compare with, if no logged order does the same work."""


@dataclass(frozen=True, repr=False)
class OrderPlan(Result):
    """The order found.

    Attributes:
        order: The visits in order; the least mean plus standard error of all orders tried.
        places: All places in order, including `via`.
        expected_s: Its mean cycle time, as `estimate` returns it for `sequence`: with its allowance.
        against: Basis of comparison: `logged executions` of the same work, `random orders` if there are none.
        against_s: Mean cycle time of these, as a baseline (`estimate.baseline`), or of random orders.
        saves_s: against_s - expected_s, and its 95 % interval from resampled executions, widened by a doubted bias;
            zeros where the order found is that of the logged executions.
        allowance: Factor in expected_s for having been chosen: on one half of the executions, the order chosen on the
            other half saves less than on its own (mean of both halves).
        searched: `all orders`, `all orders of logged tasks` (others need unlogged tasks) or `search`.
        tried: Number of orders scored.
        executions: Number of logged executions behind the result.
        expected_low_s, expected_high_s: 95 % interval of `expected_s`.
        findings: What is known about the basis of its estimate.
        unlogged: Tasks never logged with a known speed scaling; orders that need one were left out.
        notes: Limits of the answer, one sentence each.
        operator: The operator's places in order, if his order was searched too.
    """

    order: tuple[str, ...]
    places: tuple[str, ...]
    expected_s: float
    against: str
    against_s: float
    saves_s: tuple[float, float, float]
    searched: str
    tried: int
    executions: int
    expected_low_s: float = float("nan")
    expected_high_s: float = float("nan")
    findings: tuple[Finding, ...] = ()
    unlogged: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    operator: tuple[str, ...] | None = None
    allowance: float = 1.0

    def sequence(self, name: str) -> TaskSequence:
        """Return the order as a sequence: the robot's places or, if the operator's was searched too, a plan of both."""
        if self.operator is None:
            return TaskSequence(name, self.places, allowance=self.allowance)
        tasks = [PlannedTask("robot", f"{a}->{b}") for a, b in pairwise(self.places)]
        return TaskSequence.of_plan(name, [*tasks, *(PlannedTask("operator", place) for place in self.operator)])

    def plot(self) -> Drawing:
        """Return a figure of the mean cycle time of the order and of the others (matplotlib)."""
        from cyclekit.plots.results import order_figure

        interval_s = (self.expected_low_s, self.expected_high_s)
        return order_figure(", ".join(self.order), self.against, (self.expected_s, self.against_s), interval_s)

    def to_dict(self) -> dict[str, object]:
        """Return the plan as plain JSON values."""
        plain = {name: list(value) if isinstance(value, tuple) else value for name, value in vars(self).items()}
        return plain | light_of(self.findings)

    def to_frame(self) -> pl.DataFrame:
        """Return one row per visit of the order found."""
        import polars as pl

        return pl.DataFrame({"visit": range(1, len(self.order) + 1), "place": self.order})

    def _lines(self) -> list[str]:
        against = f"saves {self.saving_in_words}" + (f" against {self.against}" if any(self.saves_s) else "")
        return [f"{seconds(self.expected_s, self.against_s)}; {against}", f"order {', '.join(self.order)}"]

    @property
    def saving_in_words(self) -> str:
        """The saving as the two means differ in the text, with its interval."""
        if not any(self.saves_s):
            return NOTHING
        places = decimals_of(self.expected_s, self.against_s)
        return with_interval(difference(self.against_s, self.expected_s, places), *self.saves_s[1:], places)


@one_thread()
def plan(
    model: SafetyModel,
    dataset: Dataset,
    jobs: Jobs,
    *,
    seed: int = 0,
    validate: bool = True,
    check: Check | None = None,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> OrderPlan:
    """Search the order of `jobs` with the least expected cycle time; of similar ones, the more certain.

    The arguments are described at `cyclekit.plan_order`. Orders that need a task never logged are left out.

    Raises:
        ModelError: The model does not predict the present scaling; or as in `estimate`.
        UnknownName: A place does not exist.
        EstimateError: Every allowed order needs a task that was never logged, or there is no operator track.
    """
    if model.problem != "now":
        msg = f"the model predicts problem {model.problem!r}; a plan needs the present scaling"
        cure = f"Train one: {command_line('train', dataset.place, '--problem', 'now', '--out', 'MODEL')}"
        raise ModelError(msg, cure=cure)
    refuse_unknown_mover(dataset)
    refuse_other_cell(model.card, dataset, other_cell=other_cell)
    model = on_states_of(model, dataset)
    tasks, unlogged = _tasks(jobs, dataset)
    jobs = replace(jobs, unlogged=frozenset(unlogged))
    some = jobs.places(first_order(jobs, lambda _, options: options))  # refuse before tracks are simulated
    tasks = {name: task.of_work(some) for name, task in tasks.items()}
    if jobs.operator or waits_are_known(model):
        asked = {"validate": validate, "other_cell": other_cell}
        return _of_both(model, dataset, jobs, seed=seed, check=check, progress=progress, **asked)
    length = max(task.nominal_s + task.dwell_s + task.wait_s for task in tasks.values()) * (2 * len(jobs.visit) + 2)
    if check is None and validate:
        check, _ = validated(model, dataset, seed=seed)
    tracks = operator_tracks(dataset, horizon_s=3.0 * length, model=model)
    table = transit_table(model, tasks, tracks, progress=progress)
    every = Scorer(table, jobs, seed=seed, executions=len(set(tracks.executions)))
    order, searched, tried = best_order(every, seed=seed, progress=progress)
    today = baseline_of(dataset, work_of(some), None)
    basis = _logged_orders(dataset, jobs, today) or _random_orders(jobs, seed)
    looked_up = float(every.means([order])[0])
    if not np.isfinite(looked_up):
        raise EstimateError(f"{jobs.shown}: cycles do not end within {fixed(3 * length, 0)} s", cure=ENDLESS)
    seen_s = float(every.means(basis).mean()) - looked_up
    allowance = 1.0 + max(0.0, seen_s - _unseen(table, jobs, basis, tracks.executions, seed)) / looked_up
    walked = partial(estimate, model, dataset, seed=seed, extrapolate=True, other_cell=other_cell)
    best = TaskSequence("order 0", jobs.places(order), allowance=allowance)
    (found,) = walked([best], validate=validate, check=check)
    each_s = _mean_of(basis, every, partial(walked, validate=False, check=found.check)) - np.array(found.durations_s)
    around_s = np.quantile(resampled(tracks.executions, seed) @ each_s, (0.025, 0.975)) - each_s.mean()
    against_s = found.expected_s + float(each_s.mean())
    if today is not None:
        against_s = today.rolled_out(found.check).mean_s
    saved_s = against_s - found.expected_s
    doubt_s = _doubt_s(found, saved_s)
    low_s, high_s = (saved_s + around_s + (-doubt_s, doubt_s)).tolist()
    own = today is not None and today.is_own(found)
    return OrderPlan(
        order=order,
        places=jobs.places(order),
        expected_s=found.expected_s,
        against=LOGGED if today is not None else RANDOM,
        against_s=against_s,
        saves_s=(0.0, 0.0, 0.0) if own else (saved_s, low_s, high_s),
        searched=searched,
        tried=tried,
        executions=len(set(tracks.executions)),
        expected_low_s=found.expected_low_s,
        expected_high_s=found.expected_high_s,
        findings=found.findings,
        unlogged=tuple(unlogged),
        notes=tuple(height_notes(dataset.samples(columns=["human_x_m", "human_z_m"]))),
        allowance=allowance,
    )


def _of_both(
    model: SafetyModel,
    dataset: Dataset,
    jobs: Jobs,
    *,
    seed: int,
    validate: bool,
    check: Check | None,
    other_cell: bool,
    progress: Progress | None,
) -> OrderPlan:
    tell = progress or (lambda fraction, text: None)
    sequence, order, found, saved, tried = best_of_both(
        model, dataset, jobs, seed=seed, validate=validate, check=check, other_cell=other_cell, tell=tell
    )
    operator = tuple(task.name for task in sequence.plan if task.agent == "operator")
    today = baseline_of(dataset, work_of(sequence.places, sequence.operator), None, pace=found.pace)
    against_s = found.expected_s + saved[0]
    if today is not None:
        against_s, saved = today.rolled_out(found.check).compared(found)
    return OrderPlan(
        order=order,
        places=jobs.places(order),
        expected_s=found.expected_s,
        against=LOGGED if today is not None else RANDOM,
        against_s=against_s,
        saves_s=saved,
        searched="search",
        tried=tried,
        executions=found.executions,
        expected_low_s=found.expected_low_s,
        expected_high_s=found.expected_high_s,
        findings=found.findings,
        unlogged=tuple(sorted(jobs.unlogged)),
        operator=operator or None,
    )


def _mean_of(
    orders: Sequence[Order], table: Scorer, walked: Callable[[list[TaskSequence]], list[CycleEstimate]]
) -> Floats:
    """Return the mean duration of orders on each track, shape (K,), s; repeated orders count repeatedly."""
    times = Counter(orders)
    some = [list(times)[i] for i in np.linspace(0, len(times) - 1, min(len(times), WALKED)).astype(int)]
    wanted = [TaskSequence(f"order {n}", table.jobs.places(order)) for n, order in enumerate(some)]
    found = {each.name: each.durations_s for each in walked(wanted)}
    durations = np.array([found[each.name] for each in wanted])
    if len(some) == len(times):
        return np.asarray(np.average(durations, axis=0, weights=[times[order] for order in some]))
    return np.asarray(table.durations(orders).mean(axis=0) * (durations.mean() / table.means(some).mean()))


def _doubt_s(found: CycleEstimate, saved_s: float) -> float:
    """Return the possible error of a saving to either side, s, if the validation doubts the rollout.

    A rollout's error is in its safety loss, and orders differ in that: the doubted share of the saving equals the
    doubted share of the loss, and is at most the whole bias.
    """
    bias_s = found.expected_s * found.check.doubted_bias if found.check else 0.0
    return min(bias_s, abs(saved_s) * bias_s / found.safety_loss_s) if found.safety_loss_s > 0.0 else bias_s


def _tasks(jobs: Jobs, dataset: Dataset) -> tuple[dict[str, NominalTask], list[str]]:
    """Return every task that an allowed order may need, and which of them were never logged."""
    known = nominal_tasks(dataset)
    for name in (*(place for job in jobs.visit for place in job.split(ROW)), jobs.start, jobs.end, jobs.via):
        if name is not None and name not in dataset.places:
            raise UnknownName(jobs.shown, "place", name, dataset.places)
    for name in (*(place for job in jobs.operator for place in job.split(ROW)), jobs.operator_end):
        if name is not None and name not in dataset.human_places:
            raise UnknownName(jobs.shown, "place of the operator", name, dataset.human_places)
    wanted = jobs.needed()
    missing = sorted(wanted.difference(known))
    return {task: known[task] for task in wanted if task in known}, missing


def _logged_orders(dataset: Dataset, jobs: Jobs, today: Baseline | None) -> list[Order]:
    """Return the orders of the executions of a baseline that the jobs allow; none without one."""
    found = []
    for one in dataset.card.executions if today else ():
        order = tuple(place for place in one.places if place in jobs.visit)
        wanted = jobs.places(order) if sorted(order) == sorted(jobs.visit) and jobs.allowed(order) else None
        if today and one.execution in today.names and wanted == one.places[: len(wanted or ())]:
            found.append(order)
    return found


def _random_orders(jobs: Jobs, seed: int) -> list[Order]:
    rng = np.random.default_rng(seed)
    return [random_order(jobs, rng) for _ in range(RANDOM_BASIS)]


def _unseen(table: TransitTable, jobs: Jobs, basis: list[Order], executions: tuple[str, ...], seed: int) -> float:
    """Return the mean saving, on one half of the executions, of orders chosen on the other half, s."""
    names = np.unique(np.array(executions))
    first = np.isin(np.array(executions), np.random.default_rng(seed).permutation(names)[: len(names) // 2])
    savings = []
    for mine in (first, ~first):
        chooser, judge = (
            Scorer(table, jobs, which=np.flatnonzero(half), seed=seed, executions=len(set(np.array(executions)[half])))
            for half in (mine, ~mine)
        )
        if not mine.any() or mine.all():
            return float("nan")
        order, _, _ = best_order(chooser, seed=seed)
        savings.append(float(judge.means(basis).mean() - judge.means([order])[0]))
    return float(np.mean(savings))
