"""One-step error of the learned speed scaling on held-out executions, compared with rivals and the paper's numbers.

Simulates box picking, ingests the logs, trains the networks of problem `now` with and without batch normalisation, and
prints their mean squared errors. The paper's numbers are from another simulation of such a cell, so they show the
magnitude, not which is better; the rivals have the same training and test rows as the networks. Gradient boosting also
has the distance of robot and operator as input, the networks have not.

    python benchmarks/one_step_mse.py --executions 200 --delta 0
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.evaluation.evaluate import Evaluation, evaluate
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit_sim import SimulationOptions, simulate

PAPER = {0.0: {"classifier": 3.32, "regressor": 2.59}, 0.02: {"classifier": 8.23, "regressor": 7.01}}
PAPER[0.05] = {"classifier": 21.7, "regressor": 15.2}
"""Table I of the paper: one-step MSE x 1e4 by tracker noise, m."""
GOAL = 8.0
"""MSE x 1e4 that the default network must not exceed at noise 0 with 200 executions."""


def judged(dataset: Dataset, network: str, norm: str, seed: int, *, boosting: bool) -> tuple[Evaluation, float]:
    """Return the evaluation of a newly trained network, and its training time, s."""
    begin = time.perf_counter()
    model = train(
        dataset,
        ModelSpec.of("now", network, features="positions", norm="none" if norm == "none" else "batch", seed=seed),
    )
    took_s = time.perf_counter() - begin
    return evaluate(model, dataset, boosting=boosting), took_s


def table(dataset: Dataset, delta_m: float, seed: int) -> Table:
    """Train all networks and return the table."""
    shown = Table("network", "norm", "MSE x1e4: best estimate", "most probable level", "paper x1e4", "training, s")
    rivals: list[tuple[str, float, str]] = []
    for network, norm in (
        ("classifier", "batch"),
        ("classifier", "none"),
        ("regressor", "batch"),
        ("regressor", "none"),
    ):
        found, took_s = judged(dataset, network, norm, seed, boosting=not rivals)
        metrics = found.metrics
        paper = PAPER.get(delta_m, {}).get(network)
        named = "" if metrics.mse_argmax is None else f"{metrics.mse_argmax * 1e4:.2f}"
        shown.add_row(network, norm, f"{metrics.mse_mean * 1e4:.2f}", named, str(paper or ""), f"{took_s:.1f}")
        rivals = rivals or [(row.name, row.mse, row.note) for row in found.mse if not row.name.startswith("model")]
    for name, mse, _note in rivals:
        shown.add_row(name, "", f"{mse * 1e4:.2f}")
    held_out = f"{len(found.executions)} held-out executions, {found.metrics.rows} rows"
    shown.title = f"one-step MSE, noise {delta_m:g} m, {held_out} (goal at noise 0: classifier <= {GOAL:g})"
    return shown


def main() -> None:
    """Simulate, ingest, train, evaluate, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, default=200)
    parser.add_argument("--delta", type=float, default=0.0, help="tracker noise, m: 0, 0.02 or 0.05 as in the paper")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        logs, out = Path(folder) / "logs", Path(folder) / "dataset"
        noise = SimulationOptions(delta_m=options.delta)
        simulate("box-picking", logs, executions=options.executions, seed=options.seed, options=noise)
        ingest([logs], out)
        Console(width=120).print(table(Dataset.open(out), options.delta, options.seed))


if __name__ == "__main__":
    main()
