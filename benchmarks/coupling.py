"""Cells where robot and operator wait for each other: expected cycle times of new orders, waits, wait conditions.

Each scene is logged with its signals, by positions alone, and as a task list; then with two people, a third apart in
pace, in turn by session, with waits in half of the joint tasks, and as if nobody waited for anybody; and by the
robot's log alone with buttons and sensors as its inputs, where the order of the robot is asked for beside operators
in any order of theirs. No signal tells of the machine in `machine-tending`. Orders of both agents that no execution
followed are held against fresh executions. Beside the estimate stand the sums of logged durations of the robot's
tasks (history) and the estimate of a model that knows no conditions.

    python benchmarks/coupling.py --work DIR [--scenes shared-fixture]
        [--kinds signals positions list people half uncoupled robot robot-uncoupled]
        [--executions 60 200] [--seeds 1 2] [--orders 8] [--fresh 1000] [--plans]

With --plans, the order chosen by `plan` is compared with the best other of all orders of a small set of jobs: one half
of the fresh executions determines that one, the other half how much slower the chosen one is (faster, if below 0). All
orders are run with the same random numbers, so with the same gaps between parts: the difference of two orders scatters
less than each.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import Counter
from itertools import permutations, product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cells import JUDGED_SEED, Logged, dataset_of, logged
from msgspec import structs
from rich.console import Console
from rich.table import Table

from cyclekit.api.plan import plan_order
from cyclekit.api.train import train_model
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.estimate.plan.jobs import ROW, Jobs
from cyclekit.estimate.plan.task_orders import JobTask, TaskJobs, plan_tasks
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.learning.task_times import learn
from cyclekit.learning.task_times.runs import logged_runs
from cyclekit_sim import COUPLED, SimulationOptions, fresh_cycles, orders_beside, random_orders
from cyclekit_sim.coupled_list import NAMES, PART, listed_conditions, task_plan
from cyclekit_sim.coupled_scenes import JOINT_TIMES, wired
from cyclekit_sim.coupled_truth import conditions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.dataset.cards.coupling import CouplingCard
    from cyclekit_sim.coupled_program import Order

OUT = Console(width=190)
PLANS = 1000
"""Number of the first order used to judge plans."""
KINDS = {
    "signals": SimulationOptions(),
    "positions": SimulationOptions(signals=False),
    "list": SimulationOptions(task_list=True),
    "people": SimulationOptions(paces=(0.85, 1.15), executions_per_session=10),
    "half": SimulationOptions(coupling=0.5),
    "uncoupled": SimulationOptions(coupling=0.0),
    "robot": SimulationOptions(people="none"),
    "robot-uncoupled": SimulationOptions(people="none", coupling=0.0),
}
PLANNED = ("signals", "positions", "list")
"""Kinds for which `plan` is judged."""
ALONE = ("robot", "robot-uncoupled")
"""Logs of the robot alone, with buttons and sensors as its inputs: the operator's order is unknown, any of these."""
HEAD = ("cell", "logged", "mean |error|, %", "bias, %", "worst, %", "no conditions, %", "history, %", "CI coverage",
        "90 % coverage", "robot waits, s", "operator waits, s", "missed", "invented")  # fmt: skip


@dataclasses.dataclass
class Row:
    """Results of one order: relative errors, coverage of the intervals, and waits as (true, expected), s."""

    error: float
    plain: float
    history: float
    held: bool
    inside: float
    robot_s: tuple[float, float]
    operator_s: tuple[float, float]


def fresh(
    asked: argparse.Namespace,
    scene: str,
    order: Order,
    number: int,
    logged_as: SimulationOptions,
    *,
    paired: bool = False,
) -> NDArray[np.float64]:
    """Return duration, robot's wait and operator's wait of fresh executions (3, N), s; simulated once.

    Without waits, the cycle ends when the robot is home. People take turns by execution. `paired`: the same random
    numbers for every order.
    """
    strength, paces = logged_as.coupling, logged_as.paces
    whose = f"-people-{len(paces)}" if len(paces) > 1 else ""
    whose += "-paired" if paired else ""
    file = asked.work / "fresh-coupled" / f"{scene}{whose}-{strength:g}-{number}-{asked.fresh}.npy"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        options = SimulationOptions(coupling=strength, paces=paces)
        seed = JUDGED_SEED + (PLANS if paired else number)
        found = fresh_cycles(scene, order, cycles=asked.fresh, seed=seed, options=options)
        took_s = found.durations_s if strength else found.robot_s
        np.save(file, np.array([took_s, found.robot_waits_s, found.operator_waits_s]))
    return np.load(file)


def fresh_alone(
    asked: argparse.Namespace, scene: str, order: Order, number: int, logged_as: SimulationOptions
) -> NDArray[np.float64]:
    """As `fresh`, of the robot alone, each beside an operator in another order of his, with the same joint tasks."""
    strength = logged_as.coupling
    file = asked.work / "fresh-coupled" / f"{scene}-beside-{strength:g}-{number}-{asked.fresh}.npy"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        others = orders_beside(scene, order["robot"], JUDGED_SEED + 7, asked.fresh)
        options, seed = SimulationOptions(coupling=strength), JUDGED_SEED + number
        found = fresh_cycles(scene, order, cycles=asked.fresh, seed=seed, options=options, operators=others)
        np.save(file, np.array([found.robot_s, found.robot_waits_s, np.zeros(asked.fresh)]))
    return np.load(file)


def learned(asked: argparse.Namespace, scene: str, kind: str, executions: int, seed: int) -> Logged:
    """Return a logged cell with its model; of the robot alone that of an unseen operator."""
    if kind not in ALONE:
        return logged(asked.work, scene, executions, seed=seed, options=KINDS[kind], kind=kind, rules=True)
    dataset = dataset_of(asked.work, scene, executions, seed=seed, options=KINDS[kind], kind=kind)
    return Logged(scene, dataset, train_model(dataset))


def unseen_orders(asked: argparse.Namespace, scene: str) -> list[tuple[int, Order]]:
    """Return random orders of the scene that were never logged, from another seed than the logs."""
    return list(enumerate(random_orders(scene, JUDGED_SEED, asked.orders)))


def plan_of(name: str, order: Order) -> TaskSequence:
    """Return a plan for both agents: goals of the robot, places of the operator."""
    tasks = [PlannedTask("robot", place) for place in order["robot"][1:]]
    return TaskSequence.of_plan(name, tasks + [PlannedTask("operator", place) for place in order["operator"]])


def rows_of(asked: argparse.Namespace, scene: str, kind: str, executions: int, seed: int) -> tuple[list[Row], int, int]:
    """Return the rows of one set of logs, and the numbers of conditions missed and invented."""
    options = KINDS[kind]
    if kind == "list":
        return _listed(asked, scene, executions, seed)
    cell = learned(asked, scene, kind, executions, seed)
    card = cell.model.card.coupling
    missed, invented = compared(card, scene, kind)
    model = predictor_of(cell.model)  # the rule, as the command does, if training found one
    without = dataclasses.replace(model, card=structs.replace(cell.model.card, coupling=None))
    orders = unseen_orders(asked, scene)
    plans = [plan_of(str(number), order) for number, order in orders]
    places = [TaskSequence(str(number), order["robot"]) for number, order in orders]
    began = time.process_time()
    alone_or_free = kind in ALONE or kind == "uncoupled"
    if alone_or_free:
        both = {each.name: each for each in estimate(model, cell.dataset, places, refused=_refuse)}
    else:
        both = {each.name: each for each in estimate(model, cell.dataset, plans, refused=_refuse)}
    OUT.print(f"{scene}, {kind}, {executions} executions, seed {seed}: {len(both)} of {len(plans)} answered, "
              f"{time.process_time() - began:.1f} s cpu")  # fmt: skip
    alone = {
        name: {
            each.name: each.expected_s
            for each in estimate(without, cell.dataset, places, estimator=name, validate=False, refused=_refuse)
        }
        for name in ("rollout", "history")
    }
    found = []
    for number, order in orders:
        name = str(number)
        if name not in both:
            continue
        truth = fresh_alone if kind in ALONE else fresh
        entry, true = both[name], truth(asked, scene, order, number, options)
        mean = float(true[0].mean())
        told = [sum(share.wait_s for share in entry.plan if share.kind == who) for who in ("robot", "operator")]
        told = [entry.wait_s, 0.0] if kind in ALONE else told
        found.append(
            Row(
                entry.expected_s / mean - 1,
                alone["rollout"].get(name, np.nan) / mean - 1,
                alone["history"].get(name, np.nan) / mean - 1,
                entry.expected_low_s <= mean <= entry.expected_high_s,
                float(np.mean((true[0] >= entry.quantiles_s[0.05]) & (true[0] <= entry.quantiles_s[0.95]))),
                (float(true[1].mean()), told[0]),
                (float(true[2].mean()), told[1]),
            )
        )
        if asked.each:
            OUT.print(f"    {name}: true {mean:.2f}, expected {entry.expected_s:.2f} ({entry.expected_low_s:.2f} to "
                      f"{entry.expected_high_s:.2f}), inside {found[-1].inside:.0%}, waits of the robot "
                      f"{true[1].mean():.2f} ({told[0]:.2f}), of the operator {true[2].mean():.2f} "
                      f"({told[1]:.2f}); {'; '.join(entry.doubts)}")  # fmt: skip
    return found, missed, invented


def _listed(asked: argparse.Namespace, scene: str, executions: int, seed: int) -> tuple[list[Row], int, int]:
    """Return the same as `rows_of`, from a task list."""
    data = dataset_of(asked.work, scene, executions, seed=seed, options=KINDS["list"], kind="list")
    model = learn.learn_task_times(data)
    there = {(str(each["task"]), str(each["needs"]), each["back"]) for each in listed_conditions(COUPLED[scene])}
    got = {(task.task, need.task, need.back) for task in model.tasks for need in task.needs}
    got |= {(task.task, PART, 0) for task in model.tasks if task.parts}
    usual = {(task.agent, task.task): task.usual_s for task in model.tasks}
    found = []
    for number, order in unseen_orders(asked, scene):
        plan = task_plan(COUPLED[scene], order)
        sequence = TaskSequence.of_plan(str(number), [PlannedTask(agent, task) for agent, task in plan])
        (entry,) = estimate_plans(model, [sequence], refused=_refuse)
        true = fresh(asked, scene, order, number, KINDS["list"])
        mean = float(true[0].mean())
        sums = [sum(usual[agent, task] for agent, task in plan if agent == who) for who in ("arm", "worker")]
        waits = [sum(share.wait_s for share in entry.plan if share.kind == kind) for kind in ("robot", "operator")]
        inside = (true[0] >= entry.quantiles_s[0.05]) & (true[0] <= entry.quantiles_s[0.95])
        held = entry.expected_low_s <= mean <= entry.expected_high_s
        robot, operator = (float(part.mean()) for part in true[1:])
        history = max(sums) / mean - 1
        found.append(Row(entry.expected_s / mean - 1, np.nan, history, held, float(inside.mean()),
                         (robot, waits[0]), (operator, waits[1])))  # fmt: skip
        if asked.each:
            OUT.print(f"    {number}: true {mean:.2f}, expected {entry.expected_s:.2f} ({entry.expected_low_s:.2f} to "
                      f"{entry.expected_high_s:.2f}), inside {found[-1].inside:.0%}, waits of the robot {robot:.2f} "
                      f"({waits[0]:.2f}), of the operator {operator:.2f} ({waits[1]:.2f})")  # fmt: skip
    OUT.print(f"{scene}, list, {executions} executions, seed {seed}: {sorted(got)}")
    return found, len(there - got), len(got - there)


def compared(card: CouplingCard | None, scene: str, kind: str) -> tuple[int, int]:
    """Return the numbers of true conditions missed and of false ones found; print those found."""
    known = KINDS[kind].signals
    cell = wired(COUPLED[scene]) if kind in ALONE else COUPLED[scene]
    there = {_true(each, known) for each in conditions(cell)} if KINDS[kind].coupling else set()
    if kind in ALONE:
        there = {_alone(each) for each in conditions(cell) if each["agent"] == "robot" and KINDS[kind].coupling}
    got = set()
    for gate in card.gates if card else ():
        for need in gate.conditions:
            OUT.print(f"    {gate.agent} {gate.at} {gate.place} needs {need.agent} {need.event} {need.place} "
                      f"back {need.back}, signal {need.signal}; held {need.held:.3f}, decided {need.decided} of "
                      f"{gate.passages}; lag {need.lag_s[0]:.2f} to {need.lag_s[-1]:.2f} s, own "
                      f"{gate.own_s[0]:.2f} to {gate.own_s[-1]:.2f} s")  # fmt: skip
            before = gate.agent == "operator" and gate.at == "leave" and gate.place == "bench"
            place = "fixture" if before and scene == "shared-fixture" else gate.place
            got.add((gate.agent, place, need.agent, need.place, need.back))
    return len(there - got), len(got - there)


def _true(condition: dict[str, object], signals: bool) -> tuple[object, ...]:
    needs = condition["needs"]
    assert isinstance(needs, dict)
    whose = (condition["agent"], condition["place"])
    if needs["agent"] == "source":
        return (*whose, "signal", condition["signal"] if signals else f"part at {needs['place']}", needs["back"])
    return (*whose, needs["agent"], needs["place"], needs["back"])


def _alone(condition: dict[str, object]) -> tuple[object, ...]:
    """Return a condition of the robot as its log shows it: by a signal, or by its own last departure."""
    needs = condition["needs"]
    assert isinstance(needs, dict)
    event = ("signal", condition["signal"]) if condition["signal"] else (needs["agent"], needs["place"])
    return (condition["agent"], condition["place"], *event, needs["back"])


def small_jobs(scene: str) -> Jobs:
    """Return three joint tasks and one separate task for each agent."""
    rows = []
    for jobs in (COUPLED[scene].robot_jobs, COUPLED[scene].operator_jobs):
        joint, *more = jobs.values()
        own = more[COUPLED[scene].joint - 1]  # the other joint tasks come first
        rows.append((*[ROW.join(joint)] * JOINT_TIMES, ROW.join(own)))
    return Jobs(visit=rows[0], start="home", end="home", operator=rows[1], operator_end="rest")


def every_pair(scene: str) -> list[Order]:
    """Return all orders of both agents that `small_jobs` allows."""
    jobs = small_jobs(scene)
    robots, operators = (
        [[place for job in order for place in job.split(ROW)] for order in sorted(set(permutations(some)))]
        for some in (jobs.visit, jobs.operator)
    )
    return [
        {"robot": ("home", *robot, "home"), "operator": ("rest", *operator, "rest")}
        for robot in robots
        for operator in operators
    ]


def planned(asked: argparse.Namespace, scene: str, kind: str, executions: int, seed: int) -> tuple[str, ...]:
    """Return how much slower than the best other order that chosen by `plan` is, and the spread of all orders, %."""
    pairs = every_pair(scene)
    if kind == "list":
        chosen, expected_s = _planned_list(asked, scene, executions, seed)
        mine = [task_plan(COUPLED[scene], order) for order in pairs].index(chosen)
    else:
        cell = logged(asked.work, scene, executions, seed=seed, options=KINDS[kind], kind=kind, rules=True)
        found = plan_order(predictor_of(cell.model), cell.dataset, small_jobs(scene), validate=False)
        mine = pairs.index({"robot": found.places, "operator": ("rest", *(found.operator or ()))})
        expected_s = found.expected_s
    cycles_s = np.array(
        [fresh(asked, scene, order, PLANS + n, KINDS[kind], paired=True)[0] for n, order in enumerate(pairs)]
    )
    ranked, judged = cycles_s[:, ::2].mean(axis=1), cycles_s[:, 1::2]
    other = min((n for n in range(len(pairs)) if n != mine), key=lambda n: float(ranked[n]))
    best_s, chosen_s = judged[other].mean(), judged[mine].mean()
    longer_s = judged[mine] - judged[other]
    slower = 100 * np.array([longer_s.mean(), longer_s.std() / len(longer_s) ** 0.5]) / best_s
    spread = 100 * (judged.mean(axis=1).max() / min(best_s, chosen_s) - 1.0)
    return (f"{scene}, {kind}", f"{executions}, {seed}", str(len(pairs)), f"{best_s:.2f}", f"{chosen_s:.2f}",
            f"{slower[0]:+.2f} +- {slower[1]:.2f}", f"{spread:.1f}", f"{expected_s:.2f}")  # fmt: skip


def _planned_list(
    asked: argparse.Namespace, scene: str, executions: int, seed: int
) -> tuple[list[tuple[str, str]], float]:
    """Return the tasks of both agents as ordered by `plan` from a task list, and the expected cycle time, s."""
    data = dataset_of(asked.work, scene, executions, seed=seed, options=KINDS["list"], kind="list")
    work = Counter(task_plan(COUPLED[scene], every_pair(scene)[0]))
    jobs = TaskJobs(tuple(JobTask(agent, task, times) for (agent, task), times in work.items()))
    found = plan_tasks(learn.learn_task_times(data), jobs, logged_runs(data)[0])
    order = {name: [(name, task.name) for task in found.tasks if task.agent == name] for name in NAMES.values()}
    return [task for tasks in order.values() for task in tasks], found.estimate.expected_s


def _refuse(sequence: TaskSequence, error: Exception) -> None:
    OUT.print(f"{sequence.name} refused: {error}")


def main() -> None:
    """Print one row per cell, kind of logs and number of executions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--scenes", nargs="+", default=list(COUPLED))
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--executions", type=int, nargs="+", default=[60, 200])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--orders", type=int, default=8)
    parser.add_argument("--fresh", type=int, default=1000)
    parser.add_argument("--each", action="store_true", help="also print each order")
    parser.add_argument(
        "--plans", action="store_true", help="instead: compare the order chosen by plan with all others"
    )
    asked = parser.parse_args()
    if asked.plans:
        found = Table(
            "cell", "logged, set", "orders", "best other, s", "chosen, s", "slower, %", "worst, %", "expected, s"
        )
        for scene in asked.scenes:
            for executions in asked.executions:
                for kind, seed in product([kind for kind in asked.kinds if kind in PLANNED], asked.seeds):
                    found.add_row(*planned(asked, scene, kind, executions, seed))
        OUT.print(found)
        return
    table = Table(*HEAD)
    for scene in asked.scenes:
        for kind in asked.kinds:
            for executions in asked.executions:
                sets = [rows_of(asked, scene, kind, executions, seed) for seed in asked.seeds]
                shown = _shown([row for rows, _, _ in sets for row in rows])
                counts = (str(sum(each[i] for each in sets)) for i in (1, 2))
                table.add_row(f"{scene}, {kind}", f"{executions}, {len(asked.seeds)}", *shown, *counts)
    OUT.print(table)


def _shown(rows: list[Row]) -> list[str]:
    if not rows:
        return ["none answered"] + [""] * (len(HEAD) - 5)
    errors = 100 * np.array([row.error for row in rows])
    plain, history = (100 * np.abs([getattr(row, name) for row in rows]).mean() for name in ("plain", "history"))
    inside = [row.inside for row in rows]
    waits = [np.array([getattr(row, name) for row in rows]) for name in ("robot_s", "operator_s")]
    return [
        f"{np.abs(errors).mean():.2f}",
        f"{errors.mean():+.2f}",
        f"{errors[np.abs(errors).argmax()]:+.2f}",
        f"{plain:.2f}",
        f"{history:.2f}",
        f"{np.mean([row.held for row in rows]):.0%}",
        f"{np.mean(inside):.0%} ({min(inside):.0%} to {max(inside):.0%})",
        *(f"{told:.2f} for {true:.2f}, off {np.abs(part[:, 1] - part[:, 0]).mean():.2f}" for part in waits
          for true, told in [part.mean(axis=0)]),
    ]  # fmt: skip


if __name__ == "__main__":
    main()
