"""Why would an LSTM fail at the scaling 2 s ahead? The literature's networks, fed in the ways in which it can be done.

as it should be        a second of history for each row, rows in random order
in order of time       the same, but batches of rows that follow each other: what `shuffle=False` does
rows as a sequence     no history: torch takes a batch (rows, inputs) for one sequence, and the rows are shuffled

python benchmarks/recurrent.py --executions 100 --steps 600
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from rich.console import Console
from rich.table import Table

from cyclekit.dataset import Dataset
from cyclekit.ingest import ingest
from cyclekit.models.fitting import one_fast_thread
from cyclekit.models.network import Recurrent, build
from cyclekit.models.optimiser import Steps
from cyclekit.models.rows import Rows, rows_on, standardisation
from cyclekit.models.spec import ModelSpec
from cyclekit.samples import Samples, build_samples, split_executions
from cyclekit_sim import simulate

if TYPE_CHECKING:
    from collections.abc import Iterator

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
BATCH, DECAY = 256, 0.01
RIGHT, IN_ORDER, AS_SEQUENCE = "as it should be", "in order of time", "rows as a sequence"
WAYS = [
    ("regressor", "batch", RIGHT),
    ("lstm-1", "batch", RIGHT),
    ("lstm-1", "none", RIGHT),
    ("lstm-2", "batch", RIGHT),
]
WAYS += [("lstm-2", "none", RIGHT), ("regressor", "batch", IN_ORDER), ("lstm-1", "batch", IN_ORDER)]
WAYS += [("lstm-1", "none", IN_ORDER), ("lstm-1", "batch", AS_SEQUENCE)]


@dataclass(frozen=True)
class Way:
    """One network and how it is fed."""

    spec: ModelSpec
    feed: str

    def run(self, network: torch.nn.Module, rows: Rows, part: torch.Tensor) -> torch.Tensor:
        """Return what the network says about some rows, shape (B, 1)."""
        x = rows.inputs(part, 0.0)
        if self.feed == AS_SEQUENCE and isinstance(network, Recurrent):
            states, _ = network.lstm(x[:, -1])  # two dimensions: one sequence of B rows
            out: torch.Tensor = network.rest(states)
            return out
        return network(x)

    def batches(self, rows: Rows, steps: int) -> Iterator[torch.Tensor]:
        """Yield as many batches as there are steps."""
        done = 0
        while done < steps:
            order = torch.arange(len(rows)) if self.feed == IN_ORDER else torch.randperm(len(rows))
            for part in order.split(BATCH)[: min(steps - done, len(rows) // BATCH)]:
                done += 1
                yield part

    def error(self, learn: Samples, test: Samples, steps: int) -> float:
        """Train and return the MSE on held-out rows, in order of time."""
        standard, device = standardisation(learn.X), torch.device("cpu")
        rows, judge = (rows_on(device, part, self.spec, standard, ()) for part in (learn, test))
        torch.manual_seed(self.spec.seed)
        network = build(self.spec, learn.X.shape[1], LEVELS, scale=standard[1])
        moved = Steps(network, self.spec, DECAY, steps)
        for part in self.batches(rows, steps):
            moved.take(((self.run(network, rows, part) - rows.scaling[part]) ** 2).mean())
        network.eval()
        with torch.inference_mode():
            out = torch.cat([self.run(network, judge, part) for part in torch.arange(len(judge)).split(BATCH)])
        return float(((out - judge.scaling) ** 2).mean())


def main() -> None:
    """Simulate, ingest, train every way, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, default=100)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        logs, place = Path(folder) / "logs", Path(folder) / "dataset"
        simulate("box-picking", logs, executions=options.executions, seed=options.seed)
        ingest([logs], place)
        dataset = Dataset.open(place)
        split = split_executions(dataset.executions["execution"].to_list(), seed=options.seed)
        frames = [dataset.samples(list(names)) for names in split]
    shown = Table("network", "normalisation", "fed", "MSE x1e3", "cpu s", title="the scaling 2 s ahead, held out")
    for network, norm, feed in WAYS:
        way = Way(ModelSpec.of("ahead", network, 2.0, norm=norm, seed=options.seed), feed)  # type: ignore[arg-type]
        learn, test = (build_samples(frame, "ahead", 2.0, LEVELS, history=way.spec.history) for frame in frames)
        begin = time.process_time()
        with one_fast_thread():
            mse = way.error(learn, test, options.steps)
        shown.add_row(network, norm, feed, f"{mse * 1e3:.2f}", f"{time.process_time() - begin:.0f}")
    shown.add_row("constant mean", "", "", f"{test.scaling.var() * 1e3:.2f}")
    Console(width=100).print(shown)


if __name__ == "__main__":
    main()
