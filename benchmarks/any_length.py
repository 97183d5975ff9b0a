"""Orders shorter, as long and longer than every log, beside an operator who comes and goes: error and coverage.

    python benchmarks/any_length.py --executions 60 200 --seeds 1 2 3 --work FOLDER

The scene is `scanner-visits`: four levels with hysteresis, a scanner's rectangle that caps the speed, ramps, latency, a
tracker that writes nothing while nobody is there, one file an execution, places at whole centimetres. Each set of logs
is asked for orders that were never logged: half as long, as long and twice as long as the logged ones. Truth is the
mean of `--fresh` executions each, from random streams apart from those of the logs. Beside it the bare rollout,
history, the Markov chain, and chance: a mean of as many independent cycles of the logged length as were logged. Whether
an interval of the mean holds allows for what the fresh mean itself may be off.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np
from cells import FRESH_SEED, durations_of, fresh, logged
from order_rivals import markov_s
from rich.console import Console
from rich.table import Table

from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.check import check_rollout
from cyclekit.estimate.history import Combined
from cyclekit.estimate.result import CycleEstimate
from cyclekit.estimate.rollout import estimate
from cyclekit_sim import SimulationOptions, random_sequence

OUT = Console(width=200)
HARD = SimulationOptions(
    latency_s=0.08, hysteresis_m=0.1, ramp_down_per_s=2.0, ramp_up_per_s=0.8, executions_per_session=1,
    silent_when_empty=True, delta_m=0.005,
)  # fmt: skip
TRUE = dataclasses.replace(HARD, delta_m=0.0)
LENGTHS = {"half": 0.5, "same": 1.0, "twice": 2.0}
SCENE = "scanner-visits"
CYCLE = 0.105
"""One cycle of the logged length deviates by so much from the mean, as part of it."""


def orders(known: set[str], count: int) -> dict[str, list[TaskSequence]]:
    """Return `count` orders of each length whose tasks were all logged."""
    found: dict[str, list[TaskSequence]] = {name: [] for name in LENGTHS}
    seed = FRESH_SEED
    while any(len(some) < count for some in found.values()):
        one, two = random_sequence(SCENE, seed), random_sequence(SCENE, seed + 1)
        seed += 2
        middle = (len(one) - 2) // 2
        for name, places in (("half", [*one[: 1 + middle], one[-1]]), ("same", one), ("twice", [*one[:-1], *two[1:]])):
            sequence = TaskSequence(f"{name} {len(found[name]) + 1}", tuple(places))
            if len(found[name]) < count and known.issuperset(sequence.tasks):
                found[name].append(sequence)
    return found


@dataclasses.dataclass(frozen=True)
class Row:
    """One order asked of one set of logs: errors of the expected cycle time as parts of it, and what held."""

    error: float
    rollout: float
    history: float
    markov: float
    share: float
    held: bool
    inside: float
    took_s: float


def row_of(found: CycleEstimate, history: CycleEstimate, markov: float, true_s: np.ndarray, took_s: float) -> Row:
    """Return how far the answers to one order are off its fresh executions, shape (executions,), s."""
    mean = float(true_s.mean())
    both = found.combined or Combined(found.expected_s, history.expected_s, 0.0)
    inside = (true_s >= found.quantiles_s[0.05]) & (true_s <= found.quantiles_s[0.95])
    return Row(
        *(value / mean - 1 for value in (found.expected_s, both.rollout_s, history.expected_s, markov)),
        share=both.history_share,
        held=_holds(found, mean, float(true_s.std(ddof=1)) / len(true_s) ** 0.5),
        inside=float(inside.mean()),
        took_s=took_s,
    )


def _holds(found: CycleEstimate, true_s: float, error_s: float) -> bool:
    """Tell whether the interval of the mean holds the fresh mean, which is known to a standard error itself."""
    expected_s, known_s = found.expected_s, 1.96 * error_s
    low_s = expected_s - np.hypot(expected_s - found.expected_low_s, known_s)
    high_s = expected_s + np.hypot(found.expected_high_s - expected_s, known_s)
    return bool(low_s <= true_s <= high_s)


def of_set(work: Path, executions: int, seed: int, count: int, many: int) -> dict[str, list[Row]]:
    """Return what one set of logs gives, by the length of the order; print a line."""
    cell = logged(work, SCENE, executions, seed=seed, options=HARD, kind="visits")
    check = check_rollout(cell.model, cell.dataset)
    asked = orders(set(cell.dataset.tasks()["task"]), count)
    every = [sequence for some in asked.values() for sequence in some]
    began = time.perf_counter()
    answers = estimate(cell.model, cell.dataset, every, check=check, refused=lambda s, e: OUT.print(f"{s.name}: {e}"))
    took_s = (time.perf_counter() - began) / len(every)
    found = {entry.name: entry for entry in answers}
    history = {entry.name: entry for entry in estimate(cell.model, cell.dataset, every, estimator="history")}
    chain = dict(zip((s.name for s in every), markov_s(cell.dataset, every), strict=True))
    rows = {
        length: [
            row_of(
                found[s.name],
                history[s.name],
                chain[s.name],
                durations_of(fresh(work, SCENE, s.places, many, kind="visits", options=TRUE)),
                took_s,
            )
            for s in some
            if s.name in found
        ]
        for length, some in asked.items()
    }
    shown = ", ".join(f"{n} {100 * np.mean([r.error for r in rs]):+.2f}" for n, rs in rows.items() if rs)
    off = f"backtest {100 * check.own_bias:+.2f} +- {100 * check.own_within:.2f} %"
    OUT.print(f"{executions} executions, seed {seed}: {off}, {shown}", soft_wrap=True)
    return rows


def size(errors: list[float]) -> str:
    """Return the mean absolute error, %."""
    return f"{100 * np.abs(errors).mean():.2f}"


def add_rows(table: Table, executions: int, sets: list[dict[str, list[Row]]]) -> None:
    """Add a row for each length."""
    for name in LENGTHS:
        some = [row for rows in sets for row in rows[name]]
        errors = [row.error for row in some]
        inside = [np.mean([row.inside for row in rows[name]]) for rows in sets if rows[name]]
        spread = f"{100 * np.std(inside, ddof=1):.1f}" if len(inside) > 1 else "-"
        table.add_row(
            str(executions), name, str(len(sets)), size(errors), f"{100 * np.mean(errors):+.2f}",
            f"{100 * max(errors, key=abs):+.2f}", f"{np.mean([row.held for row in some]):.0%}",
            f"{np.mean(inside):.0%}", spread, size([row.rollout for row in some]), size([row.history for row in some]),
            size([row.markov for row in some]), f"{np.mean([row.share for row in some]):.0%}",
            f"{100 * 0.798 * CYCLE / executions**0.5:.2f}", f"{np.mean([row.took_s for row in some]):.1f}",
        )  # fmt: skip


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, nargs="+", default=[20, 60])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--orders", type=int, default=3)
    parser.add_argument("--fresh", type=int, default=1000)
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    table = Table(title=f"{SCENE}: error of the expected cycle time, %")
    for column in ("executions", "length", "sets", "mean |error|", "bias", "worst", "CI of mean holds", "90 % holds",
                   "spread of that", "rollout", "history", "Markov chain", "share", "chance", "s each"):  # fmt: skip
        table.add_column(column, justify="right")
    with tempfile.TemporaryDirectory() as folder:
        work = asked.work or Path(folder)
        for executions in asked.executions:
            sets = [of_set(work, executions, seed, asked.orders, asked.fresh) for seed in asked.seeds]
            add_rows(table, executions, sets)
    OUT.print(table)


if __name__ == "__main__":
    main()
