"""Learns task times from the task lists of a dataset, and evaluates them on held-out orders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs
from scipy.special import stdtrit

from cyclekit.config import Wait
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards.task_model import PAST, HeldOutCard, JointCard, PaceCard, TaskModelCard, TaskTimesCard
from cyclekit.errors import ConfigError, DatasetError, EstimateError, UnknownName, command_line
from cyclekit.learning.interludes import find_interludes, find_rework
from cyclekit.learning.task_times.clocks import in_one_clock
from cyclekit.learning.task_times.joint import joint_tasks, marked
from cyclekit.learning.task_times.pace import pace_drift
from cyclekit.learning.task_times.partly import needed_together
from cyclekit.learning.task_times.planned_starts import starts_before_plan
from cyclekit.learning.task_times.rates import TaskRates, fit_rates
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import Run, as_if_whole, every_run, one_at_a_time, without_failures
from cyclekit.learning.task_times.starts import Starts, learn_starts
from cyclekit.learning.unproven import unproven
from cyclekit.parallel.one_thread import one_thread

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Ints, Progress, Vector

MIN_EXECUTIONS = 5
"""Minimum number of executions."""
MIN_ORDERS = 5
"""Minimum number of orders to hold out whole orders; with fewer, single executions are held out."""
FOLDS = 5
"""Number of cross-validation folds."""
CYCLES = 200
"""Number of simulated cycles per held-out execution."""
MANY, ASKED = 1000, 5
"""Number of cycles per plan, and number of plans, for the standard error from finite logs."""


@one_thread()
def learn_task_times(dataset: Dataset, *, seed: int = 0, progress: Progress | None = None) -> TaskModelCard:
    """Return the task times learned from the task lists of a dataset.

    Args:
        dataset: Dataset with task lists.
        seed: Seed of random draws.
        progress: Called with the share done.

    Raises:
        DatasetError: There are too few complete executions, or none has a task of another one.
        ConfigError: The cell file tells of waits at places, or of a task that no list has.
    """
    every, agents = every_run(dataset)
    runs, cut = ([run for run in every if run.cut is ends] for ends in (False, True))
    if len(runs) < MIN_EXECUTIONS:
        msg = f"{dataset.place}: executions whose tasks all have an end: {len(runs)}; {MIN_EXECUTIONS} are needed"
        raise DatasetError(msg, cure=f"Ingest more logs. What is known: {command_line('inspect', dataset.place)}")
    _check_names(dataset, runs)
    given = dataset.card.settings.waits
    _check_waits(runs, agents, given)
    single = one_at_a_time(runs, MIN_EXECUTIONS)
    clean = without_failures(single, MIN_EXECUTIONS)
    model = learn_runs(clean, agents, cut=cut, given=given, seed=seed, folds=FOLDS, progress=progress)
    left_out = {"failed": len(single) - len(clean), "at_once": len(runs) - len(single)}
    return structs.replace(model, dataset=dataset.path.name, **left_out)


def _check_names(dataset: Dataset, runs: Sequence[Run]) -> None:
    """Refuse task lists in which every execution has names of its own, as with its number in them."""
    names = [{(agent, done.task) for agent, some in run.tasks.items() for done in some} for run in runs]
    if sum(map(len, names)) == len(set().union(*names)):
        example = runs[0].tasks[min(runs[0].tasks)][0].task
        msg = f"{dataset.place}: no task is in two executions: each has names of its own, such as {example!r}"
        raise DatasetError(msg, cure="Give a task the same name in all executions, without their number, and ingest.")


def _check_waits(runs: Sequence[Run], agents: Mapping[str, str], given: Sequence[Wait]) -> None:
    """Refuse waits of the cell file at places, or with unknown tasks."""
    pairs = {(agents[name], done.task) for run in runs for name, some in run.tasks.items() for done in some}
    every = sorted({task for _, task in pairs})
    for wait in given:
        if wait.task is None:
            msg = f"cell.toml [[waits]] of the {wait.agent}: {wait.before or wait.leaving or wait.spot} tells of places"
            raise ConfigError(f"{msg}, and task lists have none", cure='task = "weld"')
        mine = sorted({task for kind, task in pairs if (kind == "robot") == (wait.agent == "robot")})
        for name, known in ((wait.task, mine), (wait.until, every)):
            if name is not None and name not in known:
                raise UnknownName(f"cell.toml [[waits]] of the {wait.agent}", "task", name, known)


def learn_runs(
    runs: Sequence[Run],
    agents: Mapping[str, str],
    *,
    cut: Sequence[Run] = (),
    given: Sequence[Wait] = (),
    seed: int = 0,
    folds: int = FOLDS,
    progress: Progress | None = None,
) -> TaskModelCard:
    """Return the task times learned from executions.

    Args:
        runs: At least MIN_EXECUTIONS.
        agents: `robot` or `operator` by agent name.
        cut: Other executions, within whose tasks a log ends: they tell how long tasks take, if no clock was off.
        given: What tasks do not wait for, as the cell file tells.
        seed: Seed of random draws.
        folds: Number of cross-validation folds over the orders; 0: no held-out orders.
        progress: Called with the share done.
    """
    tell = progress or (lambda _fraction, _text: None)
    kinds: dict[str, Agent] = {agent: "robot" if kind == "robot" else "operator" for agent, kind in agents.items()}
    agents = kinds
    told = {agent: [wait for wait in given if wait.agent == kind] for agent, kind in agents.items()}
    runs, clocks = in_one_clock(runs, agents, told)
    cut = () if clocks else cut
    model = structs.replace(_learned(runs, agents, told, cut), clocks=clocks)
    tell(1.0 / (folds + 1), "task times")
    if not folds:
        return model

    def judge(given: Mapping[str, Sequence[Wait]]) -> tuple[HeldOutCard | None, dict[str, float]]:
        return _judged(
            runs, agents, given, cut, seed, folds, lambda done: tell((1.0 + done) / (folds + 1), "held-out orders")
        )

    judged, off = judge(told)
    if judged is not None and judged.order_error > 0.0 and any(one.needs for one in model.tasks):
        never = {
            agent: [Wait(agent=kind, task=one.task, never=True) for one in model.tasks if one.agent == agent]
            for agent, kind in kinds.items()
        }
        of_none, other = judge(never)
        if of_none is not None and (said := unproven(off, other)):
            model = structs.replace(_learned(runs, agents, never, cut), clocks=clocks, warnings=(said,))
            unknown = float(
                np.sqrt(np.mean(np.square([*other.values()])))
            )  # waits as work look like chance: all counts
            judged = structs.replace(of_none, order_error=max(of_none.order_error, unknown))
    return structs.replace(model, held_out=judged)


def plan_of(run: Run) -> list[PlannedTask]:
    """Return an execution as a plan: the order of each agent, and the planned starts."""
    return [
        PlannedTask(agent, done.task, None if np.isnan(done.planned_s) else max(done.planned_s, 0.0))
        for agent, some in run.tasks.items()
        for done in some
    ]


def rolled_run(model: TaskModelCard, run: Run, *, cycles: int = CYCLES, seed: int = 0) -> Vector:
    """Return durations of simulated cycles of an execution's plan at its own pace, shape (cycles,), s.

    Raises:
        UnknownName: The model does not know one of its tasks.
        EstimateError: Its tasks wait for each other.
    """
    pace = {agent: float(found.factor(run.number)) for agent, found in model.pace.items()}
    return roll_plan(model, plan_of(run), cycles=cycles, seed=seed, pace=pace).duration_s


def _learned(
    runs: Sequence[Run], agents: Mapping[str, str], told: Mapping[str, Sequence[Wait]], cut: Sequence[Run]
) -> TaskModelCard:
    pairs = sorted({(agent, done.task) for run in runs for agent, some in run.tasks.items() for done in some})
    joint = joint_tasks(runs)
    runs = marked(runs, joint)
    more = as_if_whole(cut, runs)
    rates = fit_rates([*runs, *more], pairs)
    sessions = _sessions([*runs, *more])
    paces = {agent: _pace(rates, agent, sessions) for agent, kind in agents.items() if kind == "operator"}
    pace = {agent: found for agent, found in paces.items() if found}
    starts = {agent: learn_starts(runs, agent, told[agent]) for agent in sorted({agent for agent, _ in pairs})}
    starts = needed_together(starts)
    interludes = tuple(one for agent in agents for one in find_interludes(agent, _done(runs, agent)))
    ends = {agent: [[(done.task, done.end_s) for done in run.tasks.get(agent, ())] for run in runs] for agent in agents}
    interludes += tuple(one for agent in agents for one in find_rework(agent, ends[agent]))
    tasks = tuple(
        _task(*pair, starts[pair[0]][pair[1]], rates[pair], pace.get(pair[0]), joint.get(pair)) for pair in pairs
    )
    early = starts_before_plan(runs)
    return TaskModelCard(
        agents=dict(agents),  # type: ignore[arg-type]  # of these two
        tasks=tasks,
        interludes=interludes,
        pace=pace,
        before_plan=early,
        executions=len(runs),
    )


def _done(runs: Sequence[Run], agent: str) -> list[list[tuple[str, float, float]]]:
    """Return the tasks of an agent in each execution, with their durations and without a wait within them, s."""
    return [[(done.task, done.took_s, 0.0) for done in run.tasks.get(agent, ())] for run in runs]


def _sessions(runs: Sequence[Run]) -> Ints:
    """Return the number of the session of each execution by its number; -1: no such execution is given."""
    found = np.full(max(run.number for run in runs) + 1, -1)
    found[[run.number for run in runs]] = np.unique([run.session for run in runs], return_inverse=True)[1]
    return found


def _pace(rates: Mapping[tuple[str, str], TaskRates], agent: str, sessions: Ints) -> PaceCard | None:
    """Return the trend of an agent's pace over all its tasks; None if there is none."""
    mine = [each for (name, _), each in rates.items() if name == agent]
    log_work = [np.log(each.work) - np.log(each.work).mean() for each in mine]
    number = np.concatenate([each.number for each in mine])
    return pace_drift(number, np.concatenate(log_work), sessions[number])


def _task(
    agent: str,
    task: str,
    starts: Starts,
    rates: TaskRates,
    pace: PaceCard | None,
    joint: JointCard | None,
) -> TaskTimesCard:
    now = 1.0 / pace.factor(rates.number) if pace else np.ones(len(rates.number))
    return TaskTimesCard(
        agent=agent,
        task=task,
        usual_s=rates.usual_s * float(now.mean()),
        work_s=_kept(rates.work * now),
        rates=dict(rates.rates),
        later=dict(rates.later),
        waiting=dict(rates.waiting),
        nth=dict(rates.nth),
        nth_waiting=dict(rates.nth_waiting),
        position=dict(rates.position),
        position_waiting=dict(rates.position_waiting),
        at_start=dict(rates.at_start),
        after=dict(rates.after),
        turns=rates.turns,
        own_position=rates.own_position,
        needs=starts.needs,
        joint=joint,
        planned=starts.planned,
        parts=starts.parts,
        lags_s=_kept(starts.lags_s),
        need_lags_s=_kept(starts.need_lags_s),
        lag_after_s=dict(starts.lag_after_s),
    )


def _kept(values: Vector) -> tuple[float, ...]:
    """Return at most PAST of the values, evenly spaced."""
    step = max(-(-len(values) // PAST), 1)
    return tuple(round(float(value), 6) for value in values[::step])


@dataclass(frozen=True)
class _HeldOut:
    """One held-out execution with its estimate."""

    number: int
    order: tuple[tuple[str, ...], ...]
    mean_s: float
    sd_s: float
    true_s: float


def _judged(
    runs: Sequence[Run],
    agents: Mapping[str, str],
    told: Mapping[str, Sequence[Wait]],
    cut: Sequence[Run],
    seed: int,
    folds: int,
    tell: Callable[[float], None],
) -> tuple[HeldOutCard | None, dict[str, float]]:
    """Return the errors on held-out orders, and the logarithm of logged over mean estimated duration by execution."""
    orders = sorted({run.order for run in runs})
    rng = np.random.default_rng(seed)
    if len(orders) >= MIN_ORDERS:
        number = dict(zip(orders, rng.permutation(len(orders)) % folds, strict=True))
        fold_of = np.array([number[run.order] for run in runs])
    else:
        fold_of = rng.permutation(len(runs)) % folds
    found: list[_HeldOut] = []
    models = []
    for fold in range(folds):
        held = [run for run, of in zip(runs, fold_of, strict=True) if of == fold]
        rest = [run for run, of in zip(runs, fold_of, strict=True) if of != fold]
        model = _learned(rest, agents, told, cut)
        models.append(model)
        rolled: dict[tuple[object, ...], Vector] = {}  # an order often repeats with the same plan: roll it once
        for run in held:
            same = tuple(plan_of(run)), tuple(float(pace.factor(run.number)) for pace in model.pace.values())
            try:
                took_s = rolled[same] if same in rolled else rolled_run(model, run, seed=seed + len(rolled))
            except (UnknownName, EstimateError):  # has a task that is in no other order
                continue
            rolled[same] = took_s
            found.append(
                _HeldOut(run.number, run.order, float(took_s.mean()), float(took_s.std(ddof=1)), run.duration_s)
            )
        tell(float(fold + 1))
    off = {str(one.number): float(np.log(one.true_s / one.mean_s)) for one in found}
    if len(found) < MIN_EXECUTIONS:
        return None, off
    asked = [runs[number] for number in rng.permutation(len(runs))[:ASKED]]
    return structs.replace(_summed_up(found), learning_error=_learning_error(models, asked, seed)), off


def _learning_error(models: Sequence[TaskModelCard], asked: Sequence[Run], seed: int) -> float:
    """Return the jackknife standard error of estimates relative to them, averaged over some executions' plans."""
    found = []
    for run in asked:
        try:
            means = [roll_plan(model, plan_of(run), cycles=MANY, seed=seed).duration_s.mean() for model in models]
        except (UnknownName, EstimateError):  # has a task that is in no other fold
            continue
        found.append(float(np.var(means) * (len(means) - 1)) / float(np.mean(means)) ** 2)
    few = float(stdtrit(max(len(models) - 1, 1), 0.975)) / 1.96  # correction for few folds
    return few * float(np.sqrt(np.mean(found))) if found else 0.0


def _summed_up(found: Sequence[_HeldOut]) -> HeldOutCard:
    """Return the errors by order, and the deviations of single executions."""
    by_order: dict[tuple[tuple[str, ...], ...], list[_HeldOut]] = {}
    for each in found:
        by_order.setdefault(each.order, []).append(each)
    true_s, estimate_s = np.array(
        [(sum(each.true_s for each in some), sum(each.mean_s for each in some)) for some in by_order.values()]
    ).T
    errors = (
        1.0 - true_s / estimate_s
    )  # an order may have one execution: divided by its time, its chance would be a bias
    spread = np.array([each.sd_s / each.mean_s for each in found])
    chance = float(np.mean(spread**2) * np.mean([1.0 / len(some) for some in by_order.values()]))
    chance *= 1.0 + np.sqrt(2.0 / len(errors))  # allows for the sampling error of the mean of squares
    error = float(np.sqrt(max(np.mean(errors**2) - chance, 0.0)))
    each_off = errors if len(errors) > 1 else np.array([1.0 - each.true_s / each.mean_s for each in found])
    within = float(each_off.std(ddof=1) / np.sqrt(len(each_off)))
    kept = _kept(np.clip(_deviations(list(by_order.values())), -1e3, 1e3))
    return HeldOutCard(
        orders=len(by_order),
        bias=float(1.0 / (1.0 - errors.mean()) - 1.0),
        within=within,
        order_error=error,
        learning_error=0.0,
        deviations=kept,
    )


def _deviations(by_order: Sequence[Sequence[_HeldOut]]) -> Vector:
    """Return the deviations of executions from their estimates, the same number of each order.

    The next plan is another order, so an order that ran often tells no more about it than one that ran once.
    """
    each = -(-sum(len(some) for some in by_order) // len(by_order))
    levels = (np.arange(each) + 0.5) / each
    found = [[(one.true_s - one.mean_s) / max(one.sd_s, 1e-3 * one.mean_s) for one in some] for some in by_order]
    return np.concatenate([np.quantile(some, levels, method="hazen") for some in found])
