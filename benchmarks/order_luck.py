"""Loss of a plan from few logged operators: orders chosen on some executions and evaluated on the others.

    python benchmarks/order_luck.py --executions 200

The durations of every order of the jobs with each logged operator are those of the table of arrivals. The order that is
fastest on a random subset of executions is evaluated on the others, and compared with the order that is fastest on
those. The latter is chosen on its own test data, so the printed loss is somewhat larger than the true one.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from cells import logged
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from cyclekit.estimate.cycle.transit import transit_table
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.plan import Jobs
from cyclekit.estimate.plan.search import every_order, tasks_of
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit_sim.scenes import BUILT_IN

OUT = Console(width=120)
JOBS = {
    "box-picking, every other slot": ("box-picking", slice(0, None, 2)),
    "box-picking, the other five": ("box-picking", slice(1, None, 2)),
    "box-picking, the left side": ("box-picking", slice(0, 5)),
    "pick-and-package": ("pick-and-package", slice(None)),
    "laser-zones": ("laser-zones", slice(None)),
}


def durations(work: Path, scene: str, slots: slice, executions: int) -> np.ndarray:
    """Return the duration of each order with each logged operator, shape (orders, executions), s."""
    cell = logged(work, scene, executions, seed=101)
    jobs = Jobs(tuple(BUILT_IN[scene].slots[slots]), "home", "home", "conveyor")
    orders = [tasks_of(jobs.places(order)) for order in every_order(jobs)]
    nominal = nominal_tasks(cell.dataset)
    tasks = {task: nominal[task] for order in orders for task in order}
    length = max(sum(tasks[task].nominal_s + tasks[task].dwell_s for task in order) for order in orders)
    with threadpool_limits(limits=1, user_api="blas"):
        tracks = operator_tracks(cell.dataset, horizon_s=2.5 * length)
        found = transit_table(cell.model, tasks, tracks).durations(orders)
    _, owner = np.unique(tracks.executions, return_inverse=True)
    return np.array([np.bincount(owner, takes) for takes in found]) / np.bincount(owner)


def lost(durations_s: np.ndarray, drawn: int, draws: int) -> dict[str, np.ndarray]:
    """Return by criterion the loss of the chosen order compared with the best on the other executions, %, (draws,)."""
    rng = np.random.default_rng(1)
    found: dict[str, list[float]] = {"mean": [], "mean + standard error": []}
    for _ in range(draws):
        order = rng.permutation(durations_s.shape[1])
        mine, rest = durations_s[:, order[:drawn]], durations_s[:, order[drawn:]].mean(axis=1)
        mean, error = mine.mean(axis=1), mine.std(axis=1) / drawn**0.5
        for name, score in (("mean", mean), ("mean + standard error", mean + error)):
            found[name].append(100 * (rest[score.argmin()] / rest.min() - 1))
    return {name: np.array(values) for name, values in found.items()}


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description="What few logged operators cost a plan.")
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--work", type=Path, help="folder for cells; default: a temporary one")
    asked = parser.parse_args()
    title = f"{asked.executions} logged, {asked.draws} draws: mean loss % (one in ten loses more than)"
    table = Table("jobs", "orders", "chosen by", "mean", "mean + standard error", title=title)
    with tempfile.TemporaryDirectory() as folder:
        for name, (scene, slots) in JOBS.items():
            takes = durations(asked.work or Path(folder), scene, slots, asked.executions)
            for drawn in (30, 60) if asked.executions > 60 else (asked.executions // 2,):
                cells = [
                    f"{x.mean():.2f} ({np.quantile(x, 0.9):.2f})" for x in lost(takes, drawn, asked.draws).values()
                ]
                table.add_row(name, str(len(takes)), str(drawn), *cells)
    OUT.print(table)


if __name__ == "__main__":
    main()
