"""Orders shorter, as long and longer than every log, beside an operator who comes and goes: error and coverage.

    python benchmarks/any_length.py --executions 60 200 --seeds 1 2 3 --work FOLDER

The scene is `scanner-visits`: four levels with hysteresis, a scanner's rectangle that caps the speed, ramps, latency, a
tracker that writes nothing while nobody is there, one file an execution, places at whole centimetres. Each set of logs
is asked for orders that were never logged: half as long, as long and twice as long as the logged ones. Truth is the
mean of `--fresh` executions each, from random streams apart from those of the logs.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np
from cells import FRESH_SEED, durations_of, fresh, logged
from rich.console import Console
from rich.table import Table

from cyclekit.config.sequences import TaskSequence
from cyclekit.errors import CyclekitError
from cyclekit.estimate.check import check_rollout
from cyclekit.estimate.rollout import estimate
from cyclekit_sim import SimulationOptions, random_sequence

OUT = Console(width=150)
HARD = SimulationOptions(
    latency_s=0.08, hysteresis_m=0.1, ramp_down_per_s=2.0, ramp_up_per_s=0.8, executions_per_session=1,
    silent_when_empty=True, delta_m=0.005,
)  # fmt: skip
TRUE = dataclasses.replace(HARD, delta_m=0.0)
LENGTHS = {"half": 0.5, "same": 1.0, "twice": 2.0}
SCENE = "scanner-visits"


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


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, nargs="+", default=[20, 60])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--orders", type=int, default=3)
    parser.add_argument("--fresh", type=int, default=1000)
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        asked.work = asked.work or Path(folder)
        table = Table(title=f"{SCENE}: error of the expected cycle time, %")
        for column in ("executions", "length", "sets", "mean |error|", "bias", "worst", "CI of mean holds",
                       "90 % holds", "history |error|", "refused", "s each"):  # fmt: skip
            table.add_column(column, justify="right")
        for executions in asked.executions:
            rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in LENGTHS}
            refused = 0
            for seed in asked.seeds:
                cell = logged(asked.work, SCENE, executions, seed=seed, options=HARD, kind="visits")
                check = check_rollout(cell.model, cell.dataset)
                for name, some in orders(set(cell.dataset.tasks()["task"]), asked.orders).items():
                    for sequence in some:
                        true_s = durations_of(
                            fresh(asked.work, SCENE, sequence.places, asked.fresh, kind="visits", options=TRUE)
                        )
                        begin = time.perf_counter()
                        try:
                            found = estimate(cell.model, cell.dataset, [sequence], check=check)[0]
                        except CyclekitError as error:
                            refused += 1
                            OUT.print(f"seed {seed} {sequence.name}: {error}")
                            continue
                        took = time.perf_counter() - begin
                        history = estimate(cell.model, cell.dataset, [sequence], estimator="history")[0]
                        mean = true_s.mean()
                        inside = (true_s >= found.quantiles_s[0.05]) & (true_s <= found.quantiles_s[0.95])
                        held = found.expected_low_s <= mean <= found.expected_high_s
                        rows[name].append((100 * (found.expected_s / mean - 1), held, inside.mean(),
                                           100 * (history.expected_s / mean - 1), took))  # fmt: skip
                OUT.print(
                    f"{executions} executions, seed {seed}: backtest {100 * check.own_bias:+.2f} "
                    f"+- {196 * check.own_error:.2f} %, "
                    + ", ".join(f"{n} {np.mean([r[0] for r in rs]):+.2f}" for n, rs in rows.items())
                )
            for name, found_rows in rows.items():
                values = np.array(found_rows)
                table.add_row(
                    str(executions), name, str(len(asked.seeds)), f"{np.abs(values[:, 0]).mean():.2f}",
                    f"{values[:, 0].mean():+.2f}", f"{values[np.abs(values[:, 0]).argmax(), 0]:+.2f}",
                    f"{values[:, 1].mean():.0%}", f"{values[:, 2].mean():.0%}", f"{np.abs(values[:, 3]).mean():.2f}",
                    str(refused), f"{values[:, 4].mean():.1f}",
                )  # fmt: skip
        OUT.print(table)


if __name__ == "__main__":
    main()
