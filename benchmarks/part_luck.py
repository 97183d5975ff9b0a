"""Luck of the logged gaps between parts: estimates of `fed-line` beside those of somebody who sees every gap.

    python benchmarks/part_luck.py --work DIR --executions 60 200 --seeds 4101 4102 --kinds signals positions

`luck` is the mean of fresh executions of the same order that draw their gaps from those of the logs, also from those
that no log shows; the first gap of an execution and the later ones apart. The simulator knows everything else, so what
such an estimate is off is luck of the gaps that were logged. Truth are more fresh executions with the true gaps. Both
have the same random numbers otherwise, and each part of the distribution of gaps occurs equally often, so their
difference is known to 0.05 %.

All errors are of the mean cycle time, in percent; `bias` of a set is the mean over its orders.
"""

from __future__ import annotations

import argparse
import dataclasses
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cells import JUDGED_SEED, dataset_of
from coupling import KINDS, learned, plan_of, unseen_orders
from rich.console import Console
from rich.table import Table

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.learning.task_times import learn
from cyclekit_sim import COUPLED, SimulationOptions
from cyclekit_sim.choices import FRESH, SOURCE, stream
from cyclekit_sim.coupled_list import task_plan
from cyclekit_sim.coupled_program import plan_all, source_script
from cyclekit_sim.coupled_run import make_cell, run_cells
from cyclekit_sim.coupled_scenes import JOINT_TIMES
from cyclekit_sim.program import DWELL

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit_sim.coupled_program import Order
    from cyclekit_sim.coupled_run import Cell

    Floats = NDArray[np.float64]
    Gaps = Callable[[int, Floats], Floats]
    """Gap before each part, s, by its number and the levels in (0, 1) of each cycle."""

OUT = Console(width=190)
SCENE, CELL = "fed-line", COUPLED["fed-line"]
BLOCK = 500
"""Number of executions in which each part of the distribution of gaps occurs equally often."""


@dataclasses.dataclass
class Row:
    """One order: errors of ours and of luck as shares; CI held; share in the 90 % range; waits true, ours, luck, s."""

    ours: float
    luck: float
    held: bool
    inside: float
    waits_s: tuple[float, float, float]


def logged_gaps(seed: int, executions: int) -> Floats:
    """Return the gap before each part of each logged execution, shape (executions, JOINT_TIMES), s."""
    scripts = (
        source_script(CELL, JOINT_TIMES, index, stream(seed, CELL.scene, SOURCE, index)) for index in range(executions)
    )
    return np.array([[column[1] for column in script.columns if column[0] == DWELL] for script in scripts])


def true_gaps(_: int, levels: Floats) -> Floats:
    """Return gaps of the true distribution."""
    assert CELL.feed is not None
    shortest, mean = CELL.feed.gap_s
    return np.asarray(shortest - (mean - shortest) * np.log1p(-levels))


def gaps_from(logged_s: Floats) -> Gaps:
    """Return draws from logged gaps (E, parts), each equally often; the first of an execution and later ones apart."""
    first, later = np.sort(logged_s[:, 0]), np.sort(logged_s[:, 1:].ravel())

    def drawn(part: int, levels: Floats) -> Floats:
        some = later if part else first
        return np.asarray(some[(levels * len(some)).astype(np.int64)])

    return drawn


@lru_cache(maxsize=16)
def _cells(number: int, order: tuple[tuple[str, tuple[str, ...]], ...], block: int) -> list[Cell]:
    made: Order = dict(order)
    table, seed = plan_all(CELL, [made]), JUDGED_SEED + 50_000 + number
    return [make_cell(CELL, made, table, seed, block * BLOCK + n, 1.0, FRESH, 1.0) for n in range(BLOCK)]


def block_of(number: int, order: Order, block: int, gaps: Gaps) -> Floats:
    """Return duration and robot's wait of BLOCK fresh executions with these gaps, shape (2, BLOCK), s."""
    cells = _cells(number, tuple(order.items()), block)
    rng = np.random.default_rng((number, block))
    for part in range(JOINT_TIMES):
        gap_s = gaps(part, (rng.permutation(BLOCK) + rng.random(BLOCK)) / BLOCK)
        for cell, s in zip(cells, gap_s.tolist(), strict=True):
            columns = cell.scripts["source"].columns
            at = [n for n, column in enumerate(columns) if column[0] == DWELL][part]
            columns[at] = (columns[at][0], s, *columns[at][2:])
    done, _ = run_cells(CELL, cells, plan_all(CELL, [order]), SimulationOptions())
    return np.array([[each.duration_s for each in done], [each.waited_s("robot") for each in done]])


def truth(asked: argparse.Namespace, number: int, order: Order) -> Floats:
    """Return duration and robot's wait of fresh executions, shape (2, fresh), s; simulated once."""
    file = asked.work / "part-luck" / f"true-{number}-{asked.fresh}.npy"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, np.hstack([block_of(number, order, n, true_gaps) for n in range(asked.fresh // BLOCK)]))
    return np.load(file)


def by_luck(asked: argparse.Namespace, number: int, order: Order, seed: int, executions: int) -> Floats:
    """Return mean duration and robot's wait with the gaps of one set of logs, shape (2,), s; simulated once."""
    file = asked.work / "part-luck" / f"luck-{number}-{executions}-{seed}.npy"
    if not file.is_file():
        np.save(file, block_of(number, order, 0, gaps_from(logged_gaps(seed, executions))).mean(axis=1))
    return np.load(file)


def estimates(
    asked: argparse.Namespace, orders: Sequence[tuple[int, Order]], kind: str, executions: int, seed: int
) -> dict[int, CycleEstimate]:
    """Return the estimate of each order, by its number, as `estimate` gives it."""
    if kind == "list":
        data = dataset_of(asked.work, SCENE, executions, seed=seed, options=KINDS[kind], kind=kind)
        model = learn.learn_task_times(data)
        plans = {number: [PlannedTask(*each) for each in task_plan(CELL, order)] for number, order in orders}
        asked_for = [TaskSequence.of_plan(str(number), plan) for number, plan in plans.items()]
        return {int(each.name): each for each in estimate_plans(model, asked_for, refused=_refuse)}
    cell = learned(asked, SCENE, kind, executions, seed)
    plans_of_both = [plan_of(str(number), order) for number, order in orders]
    found = estimate(predictor_of(cell.model), cell.dataset, plans_of_both, refused=_refuse)
    return {int(each.name): each for each in found}


def rows_of(asked: argparse.Namespace, kind: str, executions: int, seed: int) -> list[Row]:
    """Return the orders of one set of logs."""
    found, orders = [], unseen_orders(asked, SCENE)
    ours = estimates(asked, orders, kind, executions, seed)
    for number, order in orders:
        true, entry = truth(asked, number, order), ours[number]
        mean_s, luck = float(true[0].mean()), by_luck(asked, number, order, seed, executions)
        paired = true[:, :BLOCK].mean(axis=1)  # the same random numbers as `luck`
        wait_s = sum(share.wait_s for share in entry.plan if share.kind == "robot")
        inside = (true[0] >= entry.quantiles_s[0.05]) & (true[0] <= entry.quantiles_s[0.95])
        found.append(
            Row(
                entry.expected_s / mean_s - 1,
                float(luck[0] - paired[0]) / mean_s,
                entry.expected_low_s <= mean_s <= entry.expected_high_s,
                float(inside.mean()),
                (float(true[1].mean()), wait_s, float(true[1].mean() + luck[1] - paired[1])),
            )
        )
    return found


def _refuse(sequence: TaskSequence, error: Exception) -> None:
    OUT.print(f"{sequence.name} refused: {error}")


def main() -> None:
    """Print one row per set of logs, and one per kind of logs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--kinds", nargs="+", choices=["signals", "positions", "list"], default=["signals"])
    parser.add_argument("--executions", type=int, nargs="+", default=[60, 200])
    parser.add_argument("--seeds", type=int, nargs="+", default=[4101, 4102])
    parser.add_argument("--orders", type=int, default=5)
    parser.add_argument("--fresh", type=int, default=4000, help=f"executions per order, a multiple of {BLOCK}")
    asked = parser.parse_args()
    each = Table("logs, executions", "set", "mean |error|, %", "by luck, %", "bias, %", "by luck, %", "CI held",
                 "90 % coverage", "robot waits, s (true, ours, luck)")  # fmt: skip
    total = Table("logs, executions", "sets", "mean |error|, %", "by luck, %", "bias over sets, %", "by luck, %",
                  "rms of set biases, %", "by luck, %", "rms of ours - luck, %", "mean of ours - luck, %", "CI held",
                  "90 % coverage")  # fmt: skip
    for kind, executions in product(asked.kinds, asked.executions):
        sets = []
        for seed in asked.seeds:
            rows = rows_of(asked, kind, executions, seed)
            off = 100 * np.array([[row.ours, row.luck] for row in rows])
            sets.append(rows)
            means, sizes = off.mean(axis=0), np.abs(off).mean(axis=0)
            waits = np.mean([row.waits_s for row in rows], axis=0)
            shown = (str(seed), *(f"{value:.2f}" for value in sizes), *(f"{value:+.2f}" for value in means),
                     *_intervals(rows), ", ".join(f"{value:.2f}" for value in waits))  # fmt: skip
            each.add_row(f"{kind}, {executions}", *shown)
            OUT.print(f"{kind}, {executions}: {'; '.join(shown)}")
        total.add_row(f"{kind}, {executions}", str(len(sets)), *_over(sets))
    OUT.print(each)
    OUT.print(total)


def _intervals(rows: Sequence[Row]) -> tuple[str, str]:
    inside = [row.inside for row in rows]
    return f"{sum(row.held for row in rows)} of {len(rows)}", f"{np.mean(inside):.0%}"


def _over(sets: Sequence[Sequence[Row]]) -> list[str]:
    """Return the columns of all sets of one kind of logs."""
    off = 100 * np.array([[[row.ours, row.luck] for row in rows] for rows in sets])
    sizes, biases = np.abs(off).mean(axis=(0, 1)), off.mean(axis=1)
    error = biases.std(axis=0, ddof=1) / len(sets) ** 0.5 if len(sets) > 1 else np.full(2, np.nan)
    apart = biases[:, 0] - biases[:, 1]
    apart_error = apart.std(ddof=1) / len(sets) ** 0.5 if len(sets) > 1 else np.nan
    return [
        *(f"{value:.2f}" for value in sizes),
        *(f"{value:+.2f} +- {its:.2f}" for value, its in zip(biases.mean(axis=0), error, strict=True)),
        *(f"{value:.2f}" for value in np.sqrt(np.square(biases).mean(axis=0))),
        f"{np.sqrt(np.square(apart).mean()):.2f}",
        f"{apart.mean():+.2f} +- {apart_error:.2f}",
        *_intervals([row for rows in sets for row in rows]),
    ]


if __name__ == "__main__":
    main()
