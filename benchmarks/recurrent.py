"""Possible reasons for large errors of LSTMs at the scaling 2 s ahead: the paper's networks with several ways of input.

as it should be        one second of history per row, rows in random order
in order of time       the same, but with batches of consecutive rows, as with `shuffle=False`
rows as a sequence     no history: torch takes a batch (rows, inputs) of shuffled rows as one sequence
executions, N steps    each execution is one sequence, eight per step, Adam at 1e-3; after N steps
forecast apart         LSTM-2 in two stages: the LSTM learns the operator's future position, the regressor the present
                       scaling; its inputs are then the robot's present and the operator's forecast position

python benchmarks/recurrent.py --executions 100 --steps 600
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import nn

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.fitting import one_fast_thread
from cyclekit.learning.networks.network import Forecasting, Recurrent, build
from cyclekit.learning.networks.optimiser import Steps
from cyclekit.learning.networks.rows import TrainingRows, rows_on, standardisation
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.windows import Samples, build_samples, split_executions
from cyclekit_sim import simulate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import polars as pl

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
BATCH, DECAY, CPU = 256, 0.01, torch.device("cpu")
WHOLE = (10, 50, 200)
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
    """One network with one way of input."""

    spec: ModelSpec
    feed: str

    def run(self, network: nn.Module, rows: TrainingRows, part: torch.Tensor) -> torch.Tensor:
        """Return the network's output for some rows, shape (B, 1)."""
        x = rows.inputs(part, 0.0)
        if self.feed == AS_SEQUENCE and isinstance(network, Recurrent):
            states, _ = network.lstm(x[:, -1])  # two dimensions = one sequence of B rows
            out: torch.Tensor = network.rest(states)
            return out
        return network(x)

    def batches(self, rows: TrainingRows, steps: int) -> Iterator[torch.Tensor]:
        """Yield one batch per step."""
        done = 0
        while done < steps:
            order = torch.arange(len(rows)) if self.feed == IN_ORDER else torch.randperm(len(rows))
            for part in order.split(BATCH)[: min(steps - done, len(rows) // BATCH)]:
                done += 1
                yield part

    def fitted(
        self, rows: TrainingRows, inputs: int, steps: int, scale: np.ndarray, *, forecast: bool = False
    ) -> nn.Module:
        """Train on the scaling, or only on the forecast."""
        torch.manual_seed(self.spec.seed)
        network = build(self.spec, inputs, LEVELS, scale=scale)
        moved = Steps(network, self.spec.for_rows(len(rows)), DECAY, steps)
        for part in self.batches(rows, steps):
            out, wanted = self.run(network, rows, part), rows.scaling[part]
            if forecast and isinstance(network, Forecasting) and rows.ahead is not None:
                out, wanted = network.forecast, rows.ahead[part]
            moved.take(((out - wanted) ** 2).mean())
        return network.eval()

    def error(self, learn: Samples, test: Samples, steps: int) -> float:
        """Train and return the MSE on held-out rows, in order of time."""
        standard = standardisation(learn.X)
        rows, judge = (rows_on(CPU, part, self.spec, standard, ()) for part in (learn, test))
        network = self.fitted(rows, learn.X.shape[1], steps, standard[1])
        return mse(lambda part: self.run(network, judge, part), judge)


def mse(predict: Callable[[torch.Tensor], torch.Tensor], judge: TrainingRows) -> float:
    """Return the mean squared error of predictions for blocks of the rows."""
    with torch.inference_mode():
        out = torch.cat([predict(part) for part in torch.arange(len(judge)).split(BATCH)])
    return float(((out - judge.scaling) ** 2).mean())


def forecast_apart(frames: Sequence[pl.DataFrame], steps: int, seed: int) -> tuple[float, float]:
    """Return the MSE of LSTM-2 in two stages, and that of its second stage with the true future position."""
    lstm = Way(ModelSpec.of("ahead", "lstm-2", 2.0, seed=seed).at_rate(10.0), RIGHT)
    now = Way(ModelSpec.of("now", "regressor", seed=seed), RIGHT)
    learn, test = (
        build_samples(frame, "ahead", 2.0, LEVELS, history=lstm.spec.history, rate_hz=10.0) for frame in frames
    )
    standard = standardisation(learn.X)
    rows, judge = (rows_on(CPU, part, lstm.spec, standard, ()) for part in (learn, test))
    first = lstm.fitted(rows, learn.X.shape[1], steps, standard[1], forecast=True)
    of_now = (standard[0][:6], standard[1][:6])
    present = rows_on(CPU, build_samples(frames[0], "now", 0.0, LEVELS, rate_hz=10.0), now.spec, of_now, ())
    second = now.fitted(present, 6, steps, of_now[1])
    assert isinstance(first, Forecasting)
    assert judge.ahead is not None
    future = judge.ahead

    def asked(part: torch.Tensor, *, told: bool) -> torch.Tensor:
        x = judge.inputs(part, 0.0)
        first(x)
        assert first.forecast is not None
        place = future[part] if told else first.forecast
        out: torch.Tensor = second(torch.cat([x[:, -1, :3], place], dim=1))
        return out

    return mse(partial(asked, told=False), judge), mse(partial(asked, told=True), judge)


def whole_executions(learn: Samples, test: Samples, seed: int) -> Iterator[tuple[int, float]]:
    """Train LSTM-1 on executions as sequences; yield the number of steps and the MSE on held-out executions."""
    mean, scale = standardisation(learn.X)
    torch.manual_seed(seed)
    network = build(ModelSpec.of("ahead", "lstm-1", 2.0), learn.X.shape[1], LEVELS)
    assert isinstance(network, Recurrent)
    moved = torch.optim.Adam(network.parameters(), 1e-3)
    sequences, judge = ([_sequence(rows, k, mean, scale) for k in np.unique(rows.execution)] for rows in (learn, test))

    def error(some: Sequence[tuple[torch.Tensor, torch.Tensor]]) -> torch.Tensor:
        states, _ = network.lstm(nn.utils.rnn.pad_sequence([x for x, _ in some], batch_first=True))
        flat = torch.cat([state[: len(x)] for state, (x, _) in zip(states, some, strict=True)])
        out: torch.Tensor = ((network.rest(flat)[:, 0] - torch.cat([y for _, y in some])) ** 2).mean()
        return out

    for done in range(1, WHOLE[-1] + 1):
        network.train()
        moved.zero_grad()
        error([sequences[k] for k in torch.randperm(len(sequences))[:8]]).backward()  # type: ignore[no-untyped-call]
        moved.step()
        if done in WHOLE:
            network.eval()
            with torch.inference_mode():
                yield done, float(error(judge))


def _sequence(rows: Samples, k: int, mean: np.ndarray, scale: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """Return one execution: standardised inputs (N, F) and targets (N,)."""
    mine = rows.execution == k
    inputs, target = (rows.X[mine] - mean) * scale, rows.scaling[mine]
    return torch.from_numpy(inputs.astype(np.float32)), torch.from_numpy(target.astype(np.float32))


def main() -> None:
    """Simulate, ingest, train in every way, print."""
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
    shown = Table("network", "normalisation", "input", "MSE x1e3", "CPU s", title="the scaling 2 s ahead, held out")
    for network, norm, feed in WAYS:
        spec = ModelSpec.of("ahead", network, 2.0, norm=norm, seed=options.seed)  # type: ignore[arg-type]
        way = Way(spec.at_rate(10.0), feed)
        learn, test = (
            build_samples(frame, "ahead", 2.0, LEVELS, history=way.spec.history, rate_hz=10.0) for frame in frames
        )
        begin = time.process_time()
        with one_fast_thread():
            mse = way.error(learn, test, options.steps)
        shown.add_row(network, norm, feed, f"{mse * 1e3:.2f}", f"{time.process_time() - begin:.0f}")
    history = ModelSpec.of("ahead", "lstm-1").at_rate(10.0).history
    learn, test = (build_samples(frame, "ahead", 2.0, LEVELS, history=history, rate_hz=10.0) for frame in frames)
    with one_fast_thread():
        begin = time.process_time()
        for done, found in whole_executions(learn, test, options.seed):
            took = f"{time.process_time() - begin:.0f}"
            shown.add_row("lstm-1", "batch", f"executions, {done} steps", f"{found * 1e3:.2f}", took)
        begin = time.process_time()
        apart, told = forecast_apart(frames, options.steps, options.seed)
    shown.add_row("lstm-2", "batch", "forecast apart", f"{apart * 1e3:.2f}", f"{time.process_time() - begin:.0f}")
    shown.add_row("", "", "the same, told the operator's place ahead", f"{told * 1e3:.2f}", "")
    shown.add_row("constant mean", "", "", f"{test.scaling.var() * 1e3:.2f}")
    Console(width=100).print(shown)


if __name__ == "__main__":
    main()
