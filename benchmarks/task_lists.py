"""Plans for robot and operator from task lists: expected cycle times of new orders, and wait conditions.

Simulated: sets of logs with and without waits, rates, turns and drift; orders that were never logged are compared with
fresh executions. Recorded: a task list; each of its orders is left out in turn. Rivals: a simple rate model (rates by
least squares, no spread, no learned waits: a task starts after its agent's previous one and its planned start), the
planned times, and the sum of the mean durations of the agent that takes longer.

    python benchmarks/task_lists.py --work DIR [--executions 60 200] [--seeds 1 2 3]
    python benchmarks/task_lists.py --work DIR --list tasks.json [--parts 11]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards.task_model import TaskModelCard, TaskTimesCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times import learn
from cyclekit.learning.task_times.parts import task_parts
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import Run, logged_runs
from cyclekit_sim.task_lists import ListOptions, fresh_durations, random_order, simulate_task_lists

if TYPE_CHECKING:
    from cyclekit.schema import Vector

OUT = Console(width=160)
CELLS = {
    "waits and rates": ListOptions(),
    "waits": ListOptions(parallel_rates=False),
    "rates": ListOptions(coupled=False),
    "neither": ListOptions(coupled=False, parallel_rates=False),
    "turns": ListOptions(coupled=False, parallel_rates=False, fatigue=0.2),
    "waits, rates and drift": ListOptions(drift=0.25),
}
RIDGE = 3.0
"""Weight of the prior of the simple rate model: repetitions at rate 1 added to each task."""
WAITS = {("mount", "bring", 0), ("weld", "mount", 0)}


def refuse(sequence: TaskSequence, error: Exception) -> None:
    """Print a sequence that could not be estimated, and the reason."""
    OUT.print(f"{sequence.name}: {error}")


def simple_rates(runs: list[Run], agents: dict[str, str]) -> TaskModelCard:
    """Return the simple rate model: sum of rate x time with each task = 1, by least squares with a small ridge."""
    cards = []
    pairs = {(name, done.task) for run in runs for name, some in run.tasks.items() for done in some}
    for agent, task in sorted(pairs):
        parts = task_parts(runs, agent, task)
        simple = [effect.kind in ("rates", "alone") for effect in parts.on_rate]
        names = [effect.name for effect, mine in zip(parts.on_rate, simple, strict=True) if mine]
        during = parts.beside[:, simple]
        beside_s = np.zeros((len(parts.last), len(names)))
        np.add.at(beside_s, parts.of, during * parts.dt_s[:, None])
        usual = float(np.bincount(parts.of, parts.dt_s).mean())
        part = beside_s / usual
        found = np.linalg.solve(part.T @ part + RIDGE * np.eye(len(names)), part.sum(axis=0) + RIDGE)
        by_name = dict(zip(names, np.clip(found, 0.1, 5.0).tolist(), strict=True))
        cards.append(
            TaskTimesCard(
                agent=agent, task=task, usual_s=usual, work_s=(usual,), rates=by_name, after={}, planned=True,
                lags_s=(0.0,),
            )
        )  # fmt: skip
    return TaskModelCard(agents=agents, tasks=tuple(cards), executions=len(runs))  # type: ignore[arg-type]


def chance_of(relative: list[Vector], draws: int = 2000) -> float:
    """Return the mean |error| of a perfect model, which is not zero as the orders have few executions.

    Args:
        relative: Relative errors of the estimates, minus their mean, of each order; several of at least one order.
        draws: Number of random draws per order.
    """
    rng = np.random.default_rng(0)
    pool = [each * np.sqrt(len(each) / (len(each) - 1)) for each in relative if len(each) > 1]
    found = []
    for count in map(len, relative):
        which = rng.integers(len(pool), size=draws)
        found.append(np.mean([abs(rng.choice(pool[one], count).mean()) for one in which]))
    return float(np.mean(found))


def simulated(asked: argparse.Namespace) -> None:
    """Print one row per cell and number of executions."""
    table = Table("cell", "executions", "sets", "mean |error|, %", "worst, %", "simple rates, %", "history, %",
                  "CI coverage", "90 % coverage", "waits missed", "waits invented")  # fmt: skip
    for name, options in CELLS.items():
        for executions in asked.executions:
            rows, missed, invented = [], 0, 0
            for seed in asked.seeds:
                folder = asked.work / f"{name}-{executions}-{seed}"
                if not (folder / "dataset").is_dir():
                    simulate_task_lists(folder / "logs", executions=executions, seed=seed, options=options)
                    ingest([folder / "logs" / "tasks.csv"], folder / "dataset")
                runs, agents = logged_runs(Dataset.open(folder / "dataset"))
                model, simple = learn.learn_runs(runs, agents), simple_rates(runs, agents)
                found = {(task.task, need.task, need.back) for task in model.tasks for need in task.needs}
                there = WAITS if options.coupled else set()
                missed, invented = missed + len(there - found), invented + len(found - there)
                usual = {(task.agent, task.task): task.usual_s for task in model.tasks}
                rng = np.random.default_rng([seed, 99])
                for number in range(asked.orders):
                    order = random_order(rng)
                    true_s = np.array(fresh_durations(order, cycles=asked.fresh, seed=number, options=options))
                    plan = [PlannedTask(agent, task) for agent, tasks in order.items() for task in tasks]
                    sequence = TaskSequence.of_plan(str(number), plan)
                    (answer,) = estimate_plans(model, [sequence], refused=refuse)
                    mean = true_s.mean()
                    sums = [sum(usual[agent, task] for task in order[kind]) for kind, agent in
                            (("robot", "arm"), ("operator", "worker"))]  # fmt: skip
                    low, high = answer.quantiles_s[0.05], answer.quantiles_s[0.95]
                    rows.append(
                        (
                            answer.expected_s / mean - 1,
                            roll_plan(simple, plan, cycles=1).duration_s[0] / mean - 1,
                            max(sums) / mean - 1,
                            answer.expected_low_s <= mean <= answer.expected_high_s,
                            ((true_s >= low) & (true_s <= high)).mean(),
                        )
                    )
            error, rival, history, held, inside = np.array(rows, dtype=float).T
            table.add_row(name, str(executions), str(len(asked.seeds)), f"{100 * np.abs(error).mean():.2f}",
                          f"{100 * error[np.abs(error).argmax()]:+.2f}", f"{100 * np.abs(rival).mean():.2f}",
                          f"{100 * np.abs(history).mean():.2f}",
                          f"{held.mean():.0%}", f"{inside.mean():.0%}", str(missed), str(invented))  # fmt: skip
    OUT.print(table)


def recorded(asked: argparse.Namespace) -> None:
    """Leave out orders of a task list in turn, and compare their estimates with the recorded durations.

    One order at a time, or with `--parts` so many parts of the orders, each left out once.
    """
    folder = asked.work / asked.list.stem
    if not folder.is_dir():
        ingest([asked.list], folder)
    runs, agents = logged_runs(Dataset.open(folder))
    orders: dict[tuple[tuple[str, ...], ...], list[Run]] = {}
    for run in runs:
        orders.setdefault(run.order, []).append(run)
    rows, inside, scatter, in_a_row = [], [], [], []
    parts = asked.parts or len(orders)
    of = dict(zip(sorted(orders), np.random.default_rng(0).permutation(len(orders)) % parts, strict=True))
    learned: dict[int, tuple[TaskModelCard, TaskModelCard]] = {}
    for order, some in sorted(orders.items(), key=lambda each: of[each[0]]):
        part = int(of[order])
        if part not in learned:
            rest = [run for run in runs if of[run.order] != part]
            learned = {part: (learn.learn_runs(rest, agents, folds=asked.folds), simple_rates(rest, agents))}
        model, simple = learned[part]
        usual = {(task.agent, task.task): task.usual_s for task in model.tasks}
        if any((agent, task) not in usual for agent, *tasks in order for task in tasks):
            continue
        plans = [learn.plan_of(run) for run in some]
        each_plan = {tuple(plan): TaskSequence.of_plan(run.name, plan) for run, plan in zip(some, plans, strict=True)}
        by_plan = {plan: estimate_plans(model, [one], refused=refuse)[0] for plan, one in each_plan.items()}
        answers = [by_plan[tuple(plan)] for plan in plans]
        true_s = np.array([run.duration_s for run in some])
        expected_s = np.array([answer.expected_s for answer in answers])
        rival_s = [roll_plan(simple, plan, cycles=1).duration_s[0] for plan in plans]
        planned_s = [_planned_end_s(run, usual) for run in some]
        sums = max(sum(usual[agent, task] for task in tasks) for agent, *tasks in order)
        held = [a.quantiles_s[0.05] <= took <= a.quantiles_s[0.95] for a, took in zip(answers, true_s, strict=True)]
        inside.append(held)
        mean = true_s.mean()
        off = (true_s - expected_s) / mean
        scatter.append(off - off.mean())
        row = np.cumsum(np.diff([run.number for run in some], prepend=some[0].number) > 1)
        each_row = np.bincount(row, off) / np.bincount(row)
        in_a_row.append(each_row - each_row.mean())
        rows.append((*(np.mean(each) / mean - 1 for each in (expected_s, rival_s, planned_s, sums)), len(some)))
    *errors, count = np.array(rows).T
    found, simple_error, plan, history = (100 * np.abs(each).mean() for each in errors)
    OUT.print(
        f"{asked.list.name}: {len(rows)} orders, {int(count.sum())} executions: mean |error| {found:.2f} % (root mean "
        f"square {100 * np.sqrt(np.mean(errors[0] ** 2)):.2f} %, bias {100 * errors[0].mean():+.2f} %), simple rates "
        f"{simple_error:.2f} %, plan {plan:.2f} %, sums {history:.2f} %, chance "
        f"{100 * chance_of(scatter):.2f} % ({100 * chance_of(in_a_row):.2f} % if executions of an order in a row count "
        f"as one), 90 % intervals hold {np.mean(np.concatenate(inside)):.0%}, each order once "
        f"{np.mean([np.mean(held) for held in inside]):.0%}",
        soft_wrap=True,
    )


def _planned_end_s(run: Run, usual: dict[tuple[str, str], float]) -> float:
    """Return the end of the plan: the last planned start plus the usual duration of that task, s."""
    ends = [
        done.planned_s + usual[agent, done.task]
        for agent, some in run.tasks.items()
        for done in some
        if np.isfinite(done.planned_s)
    ]
    return max(ends, default=float("nan"))


def main() -> None:
    """Run the measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--list", type=Path)
    parser.add_argument("--executions", type=int, nargs="+", default=[60, 200])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--orders", type=int, default=5)
    parser.add_argument("--fresh", type=int, default=500)
    parser.add_argument("--folds", type=int, default=5)
    parser.add_argument("--parts", type=int, help="parts of the orders left out at once; default: one order at a time")
    asked = parser.parse_args()
    recorded(asked) if asked.list else simulated(asked)


if __name__ == "__main__":
    main()
