"""Compares expected cycle times of sequences that were never logged with fresh executions.

Simulates logs, ingests them, trains the `now` classifier and estimates some sequences that are not in the logs; then
simulates each of them with other operators. Also prints two numbers that a plant has without cyclekit: the nominal
time, and the sum of the logged means of the same tasks.

    python benchmarks/new_sequences.py --executions 200 --fresh 200
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import polars as pl
from cells import FRESH_SEED, unseen_sequences
from rich.console import Console
from rich.table import Table

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.rollout import estimate
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit.parallel.engine import Engine
from cyclekit_sim import SimulationOptions, simulate, simulate_sequence


def history_s(dataset: Dataset, sequence: TaskSequence) -> float:
    """Return the sum of the logged mean durations of the sequence's tasks, s."""
    means = dataset.tasks().group_by("task").agg((pl.col("end_s") - pl.col("start_s")).mean().alias("s"))
    by_task = dict(means.iter_rows())
    return sum(by_task[task] for task in sequence.tasks)


def main() -> None:
    """Run the comparison and print it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scene", default="box-picking")
    parser.add_argument("--executions", type=int, default=200)
    parser.add_argument("--fresh", type=int, default=200)
    parser.add_argument("--sequences", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--delta", type=float, default=0.0, help="tracker noise, metres")
    parser.add_argument("--no-override", action="store_true", help="logs without the speed scaling")
    asked = parser.parse_args()
    out = Console(width=140)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        begin = time.perf_counter()
        options = SimulationOptions(delta_m=asked.delta, log_override=not asked.no_override)
        simulate(asked.scene, work / "logs", executions=asked.executions, seed=asked.seed, options=options)
        ingest([work / "logs"], work / "dataset", engine=Engine(jobs=2))
        dataset = Dataset.open(work / "dataset")
        out.print(f"simulated and ingested in {time.perf_counter() - begin:.0f} s")
        begin = time.perf_counter()
        model = train(dataset, ModelSpec.of(problem="now", seed=0))
        mse = model.card.metrics.mse_mean
        out.print(f"trained in {time.perf_counter() - begin:.0f} s; one-step MSE held out {1e4 * mse:.2f}e-4")
        begin = time.perf_counter()
        results = estimate(model, dataset, unseen_sequences(dataset, asked.scene, asked.sequences))
        out.print(f"estimated in {time.perf_counter() - begin:.1f} s")
        table = Table(title=f"{asked.scene}, {asked.executions} executions logged, {asked.fresh} fresh ones each")
        for column in ("sequence", "fresh mean s", "+- 95 %", "expected s", "error %", "history %", "nominal %",
                       "5 % / 95 % fresh", "5 % / 95 % expected", "support"):  # fmt: skip
            table.add_column(column, justify="right")
        for number, result in enumerate(sorted(results, key=lambda r: r.name)):
            fresh = simulate_sequence(asked.scene, result.places, executions=asked.fresh, seed=FRESH_SEED + 1 + number)[
                "duration_s"
            ]
            mean, spread = float(fresh.mean()), float(fresh.std())  # type: ignore[arg-type]
            sequence = TaskSequence(result.name, result.places)
            table.add_row(
                result.name,
                f"{mean:.2f}",
                f"{1.96 * spread / len(fresh) ** 0.5:.2f}",
                f"{result.expected_s:.2f}",
                f"{100 * (result.expected_s / mean - 1):+.2f}",
                f"{100 * (history_s(dataset, sequence) / mean - 1):+.2f}",
                f"{100 * ((result.nominal_s + result.dwell_s) / mean - 1):+.1f}",
                f"{fresh.quantile(0.05):.1f} / {fresh.quantile(0.95):.1f}",
                f"{result.quantiles_s[0.05]:.1f} / {result.quantiles_s[0.95]:.1f}",
                f"{result.support:.3f}",
            )
        out.print(table)


if __name__ == "__main__":
    main()
