"""Rates of a task: in the two halves of another's task, and while another waits after one of his tasks."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np
import pytest
from msgspec import structs
from scipy.special import ndtri

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards.task_model import HeldOutCard, PaceCard, PartsCard, TaskModelCard, TaskTimesCard
from cyclekit.errors import UnknownName
from cyclekit.estimate.result import CycleEstimate
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.learning.task_times import fit
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.parts import task_parts
from cyclekit.learning.task_times.rates import MORE, TaskRates, fit_rates
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run

AGENTS = {"arm": "robot", "worker": "operator"}
MOUNT_S, PACK_S = 4.0, 3.0
WELD = ("arm", "weld")


def runs_of(
    count: int, *, second: float = 1.0, waiting: float = 1.0, shortest_s: float = 0.0, seed: int = 1
) -> list[Run]:
    """The worker mounts, waits, and packs; the arm's weld begins at a random time.

    Args:
        count: Number of executions.
        second: Rate of the weld in the second half of the mount.
        waiting: Rate of the weld while the worker waits.
        shortest_s: Shortest wait, s; the longest is 6 s.
        seed: Seed of the draws.
    """
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        packs = MOUNT_S + rng.uniform(shortest_s, 6.0)
        start, work = rng.uniform(0.0, 9.0), 5.0 * np.exp(0.03 * rng.standard_normal())
        edges = [(MOUNT_S / 2.0, 1.0), (MOUNT_S, second), (packs, waiting), (np.inf, 1.0)]
        worker = (DoneTask("mount", 0.0, MOUNT_S), DoneTask("pack", packs, packs + PACK_S, packs))
        weld = DoneTask("weld", start, _end(start, work, edges), start)
        found.append(Run(str(number), {"arm": (weld,), "worker": worker}, number))
    return found


def weld_of(runs: list[Run]) -> TaskRates:
    return fit_rates(runs, [WELD])[WELD]


def _end(t: float, left: float, edges: list[tuple[float, float]]) -> float:
    """Return when work is done that begins at `t`, at each rate until its edge."""
    for edge, rate in edges:
        if left <= max(edge - t, 0.0) * rate:
            return t + left / rate
        left, t = left - max(edge - t, 0.0) * rate, max(edge, t)
    raise AssertionError


@pytest.mark.parametrize("second", [0.4, 1.6])
def test_the_second_half_of_a_task_has_a_rate_of_its_own(second: float) -> None:
    found = weld_of(runs_of(150, second=second))
    assert found.later["worker: mount"] == pytest.approx(second, rel=0.2)
    assert found.later["worker: pack"] == pytest.approx(1.0, abs=0.2)
    assert found.rates["worker: mount"] / found.rates[""] == pytest.approx(np.sqrt(second), rel=0.2)


@pytest.mark.parametrize("waiting", [0.4, 1.6])
def test_an_agent_that_waits_has_an_effect_of_his_own(waiting: float) -> None:
    found = weld_of(runs_of(150, waiting=waiting))
    assert found.waiting["worker: mount"] == pytest.approx(waiting, rel=0.2)
    assert "worker: pack" not in found.waiting  # after it he has no task: he does not wait


def test_what_changes_nothing_is_shrunk_to_nothing() -> None:
    off = []
    for seed in range(5):
        found = weld_of(runs_of(15, seed=seed))
        off += [*found.later.values(), *found.waiting.values()]
    assert np.abs(np.log(off)).mean() < 0.08


def runs_without_effects(seed: int) -> list[Run]:
    rng, runs = np.random.default_rng(seed), []
    for number in range(6):
        tasks = {}
        for agent, names in {"arm": "abc" * 2, "worker": "uvw" * 2}.items():
            ends = np.cumsum(5.0 * np.exp(0.1 * rng.standard_normal(len(names))))
            order, starts = rng.permutation(list(names)), [0.0, *ends[:-1]]
            tasks[agent] = tuple(DoneTask(str(name), *at) for name, *at in zip(order, starts, ends, strict=True))
        runs.append(Run(str(number), tasks, number))
    return runs


def test_few_executions_of_tasks_that_depend_on_nothing_show_no_effects() -> None:
    pairs = [*(("arm", name) for name in "abc"), *(("worker", name) for name in "uvw")]
    found = [each for seed in (1, 2, 3) for each in fit_rates(runs_without_effects(seed), pairs).values()]
    every = np.concatenate([[*each.rates.values(), *each.after.values(), *each.turns] for each in found])
    assert np.abs(np.log(every)).mean() < 0.013  # 0.016 with few rounds of the fit


def test_a_plan_takes_longer_where_the_operator_waits_in_the_way() -> None:
    model = learn_runs(runs_of(150, waiting=0.3, shortest_s=1.0), AGENTS, folds=0)
    for packs, weld_s in ((MOUNT_S + 0.1, 5.0), (MOUNT_S + 3.0, 5.0 + 0.7 * 3.0), (60.0, 5.0 / 0.3)):
        plan = [
            PlannedTask("arm", "weld", not_before_s=MOUNT_S),
            PlannedTask("worker", "mount"),
            PlannedTask("worker", "pack", not_before_s=packs),
        ]
        rolled = roll_plan(model, plan, cycles=200)
        assert (rolled.end_s - rolled.start_s)[:, 0].mean() == pytest.approx(weld_s, rel=0.1)


@cache
def learned_of(count: int) -> TaskModelCard:
    return learn_runs(runs_of(count), AGENTS, folds=0)


def _exact(**changed: dict[str, float]) -> TaskModelCard:
    """A model in which the weld takes 5 s and the mount 4 s."""
    model = learned_of(10)
    tasks = []
    for task in model.tasks:
        work = {"weld": 5.0, "mount": MOUNT_S, "pack": PACK_S}[task.task]
        plain = structs.replace(
            task, work_s=(work,), rates={}, later={}, waiting={}, after={}, turns=(), lags_s=(0.0,), planned=True
        )
        tasks.append(structs.replace(plain, **changed) if task.task == "weld" else plain)
    return structs.replace(model, tasks=tuple(tasks))


def test_the_mean_of_few_cycles_is_not_off_by_the_luck_of_a_seed() -> None:
    """The seed is the same for every plan, so all of them would be too long or too short alike."""
    times_s = np.random.default_rng(1).exponential(4.0, 60)
    parts = PartsCard(first_s=tuple(times_s), gap_s=tuple(times_s))
    lags_s = tuple((0.1 * times_s).tolist())
    card = TaskTimesCard(
        agent="arm", task="load", usual_s=4.0, work_s=tuple(times_s), rates={}, after={}, lags_s=lags_s, parts=parts
    )
    model = TaskModelCard(agents={"arm": "robot"}, tasks=(card,), executions=60)
    rolled = [roll_plan(model, [PlannedTask("arm", "load")], cycles=50, seed=seed) for seed in range(8)]
    took_s = np.array([some.end_s.mean() for some in rolled])
    assert took_s.mean() == pytest.approx(2.1 * times_s.mean(), abs=0.25)
    assert took_s.std() < 0.4  # with independent draws 1.1 s
    one = roll_plan(model, [PlannedTask("arm", "load")], cycles=60).end_s.ravel()
    assert len(np.unique(one)) > 40  # they are not the same cycles again and again


def test_a_plan_is_rolled_out_with_the_rates_of_both_halves_and_of_the_wait() -> None:
    plan = [
        PlannedTask("arm", "weld"),
        PlannedTask("worker", "mount"),
        PlannedTask("worker", "pack", not_before_s=20.0),
    ]
    slow = {"later": {"worker: mount": 0.25}, "waiting": {"worker: mount": 0.5}}
    ends = roll_plan(_exact(**slow), plan, cycles=2).end_s
    # 2 s at rate 2, 2 s at 0.5: all work is done as the mount ends
    assert ends[:, 0] == pytest.approx([4.0, 4.0])
    assert ends[:, 1] == pytest.approx([4.0, 4.0])
    # 4 s at rate 0.25 leave 4 s of work; the worker waits: rate 0.5
    ends = roll_plan(_exact(rates={"worker: mount": 0.25}, waiting=slow["waiting"]), plan, cycles=2).end_s
    assert ends[:, 0] == pytest.approx([12.0, 12.0])
    # after his last task he does not wait
    ends = roll_plan(_exact(rates={"worker: mount": 0.25}, waiting=slow["waiting"]), plan[:2], cycles=2).end_s
    assert ends[:, 0] == pytest.approx([8.0, 8.0])


def test_of_two_robots_a_plan_says_which() -> None:
    model = learn_runs(runs_of(10), {"arm": "robot", "worker": "robot"}, folds=0)
    with pytest.raises(UnknownName, match=r"unknown agent 'robot'\.?\n.*Known: arm, worker\."):
        roll_plan(model, [PlannedTask("robot", "weld")])


def _weld_alone(
    orders: int, bias: float, deviations: np.ndarray, pace_error: float = 0.0, within: float = 0.001
) -> CycleEstimate:
    """The estimate of a weld, about 5.0 +- 0.15 s, by a model with these errors on held-out orders."""
    pace = {"arm": PaceCard(law="linear", change=-0.2, first=0, last=59, error=pace_error)} if pace_error else {}
    model = structs.replace(learned_of(60), pace=pace)
    judged = HeldOutCard(
        orders=orders, bias=bias, within=within, order_error=abs(bias), learning_error=0.0, deviations=tuple(deviations)
    )
    plan = TaskSequence.of_plan("weld", [PlannedTask("arm", "weld")])
    (found,) = estimate_plans(
        structs.replace(model, held_out=judged), [plan], refused=lambda _, error: pytest.fail(str(error))
    )
    return found


def test_a_bias_on_held_out_orders_is_corrected_once() -> None:
    scatter = np.random.default_rng(1).standard_normal(100)
    rolled = np.array(_weld_alone(2, 0.0, np.zeros(6)).durations_s)
    plain = _weld_alone(50, 0.0, scatter)
    biased = _weld_alone(50, 0.1, (scatter - 0.1 * rolled.mean() / rolled.std()) / 1.1)
    assert biased.expected_s == pytest.approx(plain.expected_s / 1.1)
    assert plain.quantiles_s[0.5] == pytest.approx(plain.expected_s, rel=0.01)
    assert biased.quantiles_s[0.5] == pytest.approx(biased.expected_s, rel=0.015)


def test_a_bias_below_three_standard_errors_widens_the_interval_of_the_mean_instead() -> None:
    scatter = np.random.default_rng(1).standard_normal(100)
    plain, unsure, sure = (_weld_alone(50, 0.1, scatter, within=within) for within in (0.001, 0.04, 0.033))
    assert unsure.expected_s == pytest.approx(1.1 * plain.expected_s)
    assert sure.expected_s == pytest.approx(plain.expected_s)
    error = (sure.expected_high_s / sure.expected_s - 1.0) / 1.96
    assert error == pytest.approx(0.033, rel=0.01)
    assert (unsure.expected_high_s / unsure.expected_s - 1.0) / 1.96 == pytest.approx(np.hypot(0.1, 0.04), rel=0.01)


def test_a_bias_that_is_not_significant_does_not_shift_single_cycles() -> None:
    scatter = np.random.default_rng(1).standard_normal(100)
    found = _weld_alone(50, 0.0, scatter + 0.5)
    assert np.mean(found.durations_s) == pytest.approx(found.expected_s)


def test_the_error_of_the_latest_pace_widens_single_cycles() -> None:
    scatter = np.random.default_rng(1).standard_normal(100)
    sure, unsure = (np.array(_weld_alone(50, 0.0, scatter, error).durations_s) for error in (1e-6, 0.05))
    assert unsure.std() == pytest.approx(np.hypot(sure.std(), 0.05 * sure.mean()), rel=0.05)


def test_few_held_out_executions_that_scatter_more_than_the_rollout_widen_single_cycles() -> None:
    def width_s(orders: int, spread: float) -> float:
        single = _weld_alone(orders, 0.0, spread * np.array([-1.0, 1.0] * 6)).quantiles_s
        return single[0.95] - single[0.05]

    usual_s = width_s(2, 3.0)  # of so few orders the scatter is not known
    assert width_s(6, 0.3) == pytest.approx(usual_s)
    assert width_s(6, 3.0) == pytest.approx(3.0 * usual_s * 2.015 / 1.645, rel=0.01)


def test_rolled_out_cycles_count_beside_held_out_executions_that_do_not_scatter_more() -> None:
    def width_s(spread: float) -> float:
        scatter = np.random.default_rng(1).permutation(ndtri((np.arange(60) + 0.5) / 60))
        single = _weld_alone(60, 0.0, spread * scatter).quantiles_s
        return single[0.95] - single[0.05]

    usual_s = width_s(1.0)
    assert 0.8 < width_s(0.7) / usual_s < 0.95
    assert width_s(1.6) == pytest.approx(1.6 * usual_s, rel=0.1)


def test_an_order_that_ran_often_counts_as_one_order_for_single_cycles() -> None:
    rng = np.random.default_rng(1)
    first, *others = permutations("abc")
    runs = []
    for number, (order, took_s) in enumerate([*[(first, 1.0)] * 30, *((order, 1.3) for order in others)]):
        ends = np.cumsum(took_s * np.exp(0.02 * rng.standard_normal(3))).tolist()
        tasks = [DoneTask(*each) for each in zip(order, [0.0, *ends], ends, strict=False)]
        runs.append(Run(str(number), {"arm": tuple(tasks)}, number))
    judged = learn_runs(runs, {"arm": "robot"}).held_out
    assert judged is not None
    assert len(judged.deviations) == 36
    assert np.median(judged.deviations) > 0.0  # five of the six orders take longer than the others say


def pairs_of(count: int, *, law: str, seed: int = 1) -> list[Run]:
    """The arm welds while the worker mounts twice, packs between, and is alone with a third of the welds.

    Args:
        count: Number of executions.
        law: `nth`: the weld is slow during the second mount; `at start`: it takes twice as long if it begins during a
            mount; `nothing`.
        seed: Seed of the draws.
    """
    rng, found = np.random.default_rng(seed), []
    for number in range(count):
        worker = tuple(DoneTask(task, at, at + 6.0) for task, at in (("mount", 0.0), ("pack", 6.0), ("mount", 12.0)))
        start, work = rng.uniform(0.0, 22.0), 4.0 * np.exp(0.03 * rng.standard_normal())
        if law == "at start" and (start < 6.0 or 12.0 <= start < 18.0):
            work *= 2.0
        slow = 0.4 if law == "nth" else 1.0
        end = _end(start, work, [(12.0, 1.0), (18.0, slow), (np.inf, 1.0)])
        found.append(Run(str(number), {"arm": (DoneTask("weld", start, end, start),), "worker": worker}, number))
    return found


def test_the_second_occurrence_of_a_task_may_have_a_rate_of_its_own() -> None:
    found = weld_of(pairs_of(50, law="nth"))
    assert found.nth["worker: mount"][1] / found.nth["worker: mount"][0] == pytest.approx(0.4, rel=0.25)
    model = learn_runs(pairs_of(50, law="nth"), AGENTS, folds=0)
    for begins, weld_s in ((0.5, 4.0), (12.5, 5.5 + 4.0 - 0.4 * 5.5)):
        plan = [PlannedTask("arm", "weld", not_before_s=begins)]
        plan += [PlannedTask("worker", name) for name in ("mount", "pack", "mount")]
        rolled = roll_plan(model, plan, cycles=100)
        assert (rolled.end_s - rolled.start_s)[:, 0].mean() == pytest.approx(weld_s, rel=0.12)


def test_the_task_at_the_start_may_change_the_whole_task() -> None:
    found = weld_of(pairs_of(50, law="at start"))
    assert found.at_start["worker: mount"] / found.at_start["worker: pack"] == pytest.approx(2.0, rel=0.2)
    model = learn_runs(pairs_of(50, law="at start"), AGENTS, folds=0)
    for begins, weld_s in ((5.0, 8.0), (7.0, 4.0)):
        plan = [PlannedTask("arm", "weld", not_before_s=begins)]
        plan += [PlannedTask("worker", name) for name in ("mount", "pack", "mount")]
        rolled = roll_plan(model, plan, cycles=100)
        assert (rolled.end_s - rolled.start_s)[:, 0].mean() == pytest.approx(weld_s, rel=0.12)


@pytest.mark.parametrize("count", [8, 30])
def test_tasks_that_show_no_such_effect_get_none(count: int) -> None:
    for seed in range(4):
        found = weld_of(pairs_of(count, law="nothing", seed=seed))
        assert (found.nth, found.nth_waiting, found.at_start) == ({}, {}, {})
        assert (found.position, found.position_waiting, found.own_position) == ({}, {}, ())


SLOTS_S = (3.0, 5.0, 4.0)
"""Time of a place at the first, second and third position in its agent's order."""


def placed_in(count: int, *, slow_at: int | None, slots: bool, seed: int = 1) -> list[Run]:
    """The worker mounts once and packs twice, and waits after each; the arm places once and moves twice.

    Args:
        count: Number of executions.
        slow_at: Position at which the mount, and the wait after it, slow the arm to a fifth; None = none.
        slots: The place takes `SLOTS_S`; otherwise 4 s.
        seed: Seed of the draws.
    """
    rng, found = np.random.default_rng(seed), []
    for number in range(count):
        mine = rng.permutation(["mount", "pack", "pack"]).tolist()
        worker = tuple(DoneTask(task, 7.0 * at, 7.0 * at + 5.0, 7.0 * at) for at, task in enumerate(mine))
        at = mine.index("mount")
        slow = 0.2 if at == slow_at else 1.0
        edges = [(7.0 * at, 1.0), (7.0 * at + 7.0, slow), (np.inf, 1.0)]
        arm, t = [], float(rng.uniform(0.0, 6.0))
        for position, task in enumerate(rng.permutation(["place", "move", "move"]).tolist()):
            work = (SLOTS_S[position] if slots and task == "place" else 4.0) * np.exp(0.03 * rng.standard_normal())
            begins = t
            t = _end(t, work, edges)
            arm.append(DoneTask(task, begins, t))
        found.append(Run(str(number), {"arm": tuple(arm), "worker": worker}, number))
    return found


def took_s(model: TaskModelCard, arm: list[str], worker: list[str], begins_s: float) -> list[float]:
    """Return the mean time of each task of the arm; its first begins at `begins_s`, the worker's every 7 s."""
    plan = [PlannedTask("arm", task, not_before_s=None if at else begins_s) for at, task in enumerate(arm)]
    plan += [PlannedTask("worker", task, not_before_s=7.0 * at) for at, task in enumerate(worker)]
    at_once = [structs.replace(one, lags_s=(0.0,), lag_after_s={}) for one in model.tasks]
    rolled = roll_plan(structs.replace(model, tasks=tuple(at_once)), plan, cycles=200)
    return (rolled.end_s - rolled.start_s).mean(axis=0)[: len(arm)].tolist()


def test_where_another_is_in_his_order_may_slow_a_task_also_while_he_waits() -> None:
    model = learn_runs(placed_in(60, slow_at=0, slots=False), AGENTS, folds=0)
    move = next(task for task in model.tasks if task.task == "move")
    assert move.position
    assert move.position_waiting
    first, _ = took_s(model, ["move", "move"], ["mount", "pack", "pack"], 0.0)
    assert first == pytest.approx(7.0 + 4.0 - 7.0 * 0.2, rel=0.1)  # slow until the next pack
    later, _ = took_s(model, ["move", "move"], ["pack", "mount", "pack"], 7.5)
    assert later == pytest.approx(4.0, rel=0.1)


def test_a_task_may_take_longer_at_its_own_position() -> None:
    model = learn_runs(placed_in(40, slow_at=None, slots=True), AGENTS, folds=0)
    for at, slot_s in enumerate(SLOTS_S):
        arm = ["move", "move"]
        arm.insert(at, "place")
        assert took_s(model, arm, ["pack", "mount", "pack"], 1.0)[at] == pytest.approx(slot_s, rel=0.05)
    assert next(task for task in model.tasks if task.task == "move").own_position == ()


def test_the_maximum_is_found_in_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects whose spreads differ by a factor of a thousand need no hundreds of steps."""
    parts = task_parts(runs_of(60, second=0.4, waiting=0.5), *WELD).without({kind for kinds in MORE for kind in kinds})
    spreads = fit.SPREADS | {"later": 1e-3, "previous": 1e-4, "turn": 1e-4}
    prior = np.array([spreads[kind] for kind in parts.kinds])
    steps, density = [], fit._density

    def counted(*args: object, **_: object) -> tuple[float, object]:
        steps.append(1)
        return density(*args)  # type: ignore[arg-type]  # of the same function

    monkeypatch.setattr(fit, "_density", counted)
    found = fit.best_at(parts, spreads, fit.begin_at(parts), -8.0)
    assert len(steps) < 40
    away = found + 0.05 * np.random.default_rng(1).standard_normal((50, len(found)))
    assert density(found, parts, prior)[0] < min(density(at, parts, prior)[0] for at in away)


def test_a_search_goes_on_from_a_known_likelihood_to_the_same_maximum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each part of a repetition is summed up once, not once more for the directions of the next search."""
    parts = task_parts(runs_of(60, second=0.4, waiting=0.5), *WELD).without({kind for kinds in MORE for kind in kinds})
    begin = fit.best_at(parts, fit.SPREADS, fit.begin_at(parts), -8.0)
    spreads, there = {kind: 0.5 * spread for kind, spread in fit.SPREADS.items()}, fit.Quadratic(parts, begin)
    there.updated(1.0)  # scatter of another fit, which must not matter
    found, known = fit.best_at(parts, spreads, begin, -1.0), fit.evidence(parts, begin, spreads)
    monkeypatch.setattr(fit, "Quadratic", None)
    assert np.array_equal(fit.best_at(parts, spreads, begin, -1.0, there), found)
    assert fit.evidence(parts, begin, spreads, there) == known
