"""The scaling two seconds ahead: predictors with the same inputs, compared with the lower bound of the error.

    python benchmarks/two_seconds_ahead.py --scene box-picking --executions 200 --seed 2

All have the same training executions and held-out samples. `now`: present positions and goals. `1 s`: positions and
goals of the last second. `1 s, past`: also the time since each goal was set, and the scaling of the last second. For
the lower bound, the simulator continues many times from each held-out state; the mean variance of the scaling after two
seconds is the error of a predictor that knows the state and the whole simulator.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.boosting import grow
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit.learning.windows import Samples, build_samples, split_executions
from cyclekit_sim import simulate
from cyclekit_sim.futures import FUTURES, spread_ahead

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

HORIZON_S, ROWS_TO_LEARN = 2.0, 0.72
NETWORKS = {
    "boosting (model)": ("1 s, past", {"network": "boosting"}),
    "lstm-2, past": ("1 s, past", {"network": "lstm-2", "norm": "none", "features": "past"}),
    "lstm-2": ("1 s", {"network": "lstm-2", "norm": "none"}),
    "lstm-1": ("1 s", {"network": "lstm-1", "norm": "none"}),
    "regressor": ("now", {"network": "regressor", "norm": "none"}),
    "classifier": ("now", {"network": "classifier", "norm": "none"}),
}


class Cell:
    """A simulated cell: its dataset, with training and test rows."""

    def __init__(self, scene: str, executions: int, seed: int, steps: int, work: Path) -> None:
        """Simulate and ingest the cell, unless that was done before."""
        place = work / f"{scene}-{executions}-{seed}"
        if not (place / "dataset").is_dir():
            simulate(scene, place / "logs", executions=executions, seed=seed)
            ingest([place / "logs"], place / "dataset")
        self.scene, self.count, self.seed, self.steps = scene, executions, seed, steps
        self.dataset = Dataset.open(place / "dataset")
        self.names = self.dataset.executions["execution"].to_list()
        self.learn, self.test = split_executions(self.names, seed=seed)

    def rows(self, *, past: bool) -> tuple[Samples, Samples]:
        """Return training and test rows with a history of one second."""
        history = ModelSpec.of("ahead", "boosting").at_rate(self.dataset.rate_hz).history or (1, 1)
        frames = (self.dataset.samples(list(names)) for names in (self.learn, self.test))
        rate_hz = self.dataset.rate_hz
        learn, judge = (
            build_samples(frame, "ahead", HORIZON_S, (), rate_hz=rate_hz, history=history, past=past)
            for frame in frames
        )
        return learn, judge

    def network(self, settings: dict[str, str]) -> float:
        """Train a model and return its MSE on the held-out executions."""
        rows = self.dataset.samples().height * ROWS_TO_LEARN
        settings = dict(settings)
        network = settings.pop("network")
        epochs = max(round(self.steps / (rows / 1024)), 1)
        spec = ModelSpec.of("ahead", network, HORIZON_S, seed=self.seed, epochs=epochs, **settings)  # type: ignore[arg-type]
        metrics = train(self.dataset, spec).card.metrics
        assert metrics is not None
        return metrics.mse_mean

    def boosted(self, inputs: str) -> float:
        """Train gradient boosting on some inputs and return its MSE."""
        learn, judge = self.rows(past=inputs == "1 s, past")
        if inputs == "now":
            learn, judge = (_only_now(rows) for rows in (learn, judge))
        return _mse(grow(learn, seed=self.seed).predict(judge), judge)

    def persistence(self) -> float:
        """Return the MSE of predicting the present scaling."""
        _, judge = self.rows(past=True)
        return _mse(judge.X[:, judge.inputs.index("scaling")].astype(np.float64), judge)

    def constant(self) -> float:
        """Return the MSE of predicting the mean."""
        learn, judge = self.rows(past=False)
        return _mse(np.full(len(judge), learn.scaling.mean()), judge)

    def floor(self) -> float:
        """Return the mean variance over simulated continuations of held-out states."""
        numbers = [self.names.index(name) for name in self.test]
        return float(spread_ahead(self.scene, self.seed, self.count, numbers, HORIZON_S).mean())

    def entries(self) -> dict[str, tuple[str, Callable[[], float]]]:
        """Return the predictors by name: inputs, and the function that returns the MSE."""
        found: dict[str, tuple[str, Callable[[], float]]] = {}
        for name, (inputs, settings) in NETWORKS.items():
            found[name] = inputs, partial(self.network, settings)
        for inputs in ("1 s", "now"):
            found[f"gradient boosting, {inputs}"] = inputs, partial(self.boosted, inputs)
        found["persistence"] = "scaling now", self.persistence
        found["constant mean"] = "none", self.constant
        found[f"floor: {FUTURES} futures of each state"] = "the state", self.floor
        return found


def _only_now(rows: Samples) -> Samples:
    return replace(rows, table=None, before=None, ahead=None)


def _mse(predicted: NDArray[np.float64], judge: Samples) -> float:
    return float(np.mean((np.clip(predicted, 0.0, 1.0) - judge.scaling) ** 2))


def main() -> None:
    """Compute every error that is not yet in the work folder, and print all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scene", default="box-picking")
    parser.add_argument("--executions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--steps", type=int, default=3000, help="steps of the training of each network")
    parser.add_argument("--only", default="", help="only predictors whose name contains this")
    parser.add_argument("--work", type=Path, default=Path("out/two_seconds_ahead"), help="folder for results")
    options = parser.parse_args()
    cell = Cell(options.scene, options.executions, options.seed, options.steps, options.work)
    shown = Table("predicted by", "inputs", "MSE x1e3", "cpu s", title=f"{options.scene}, {len(cell.test)} held out")
    for name, (inputs, error) in cell.entries().items():
        words = f"{options.scene}-{options.executions}-{options.seed}-{options.steps}-{name}".replace(" ", "-")
        file = options.work / f"{words.replace(',', '').replace(':', '')}.json"
        if options.only in name and not file.is_file():
            begin = time.process_time()
            found = {"mse": error(), "cpu_s": time.process_time() - begin}
            file.write_text(json.dumps(found), encoding="utf-8")
        if file.is_file():
            found = json.loads(file.read_text(encoding="utf-8"))
            shown.add_row(name, inputs, f"{found['mse'] * 1e3:.2f}", f"{found['cpu_s']:.0f}")
    Console(width=100).print(shown)


if __name__ == "__main__":
    main()
