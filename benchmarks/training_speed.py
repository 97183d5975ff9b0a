"""Time to the same validation error: cyclekit's loop, a plain PyTorch DataLoader loop, scikit-learn's MLPClassifier.

Each is trained with the same seeds on the same rows of an artificial cell (a staircase of the distance, 600 000 rows)
and stopped when its error on 60 000 noise-free rows falls below the goal; this is checked sixteen times per epoch (the
DataLoader loop: eight) and not timed. cyclekit's learning rate rises and falls once over a fixed number of epochs: one
is enough for this goal, five reach a lower error; time and final error of the whole run are also printed. The others
have a constant rate and thus no fixed end. Runs alternate, and CPU time is printed with wall time, for a machine with
other load.

    python benchmarks/training_speed.py --repeats 3 --goal 2e-3
    python benchmarks/training_speed.py --repeats 11 --near
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections import defaultdict
from functools import partial
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from sklearn.neural_network import MLPClassifier
from threadpoolctl import threadpool_limits
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from cyclekit.learning.networks.fitting import freeze_norm, one_fast_thread
from cyclekit.learning.networks.network import build
from cyclekit.learning.networks.optimiser import Steps
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.networks.weights import Weights

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

GIVE_UP_S = 120.0
ADAMW = {"optimiser": "adamw"}
LEVELS, THRESHOLDS_M = np.array([0, 0.25, 0.5, 0.75, 1.0]), (0.5, 0.9, 1.4, 2.0)


def rows(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return standardised inputs (N, 6) and the level index of each row (N,)."""
    rng = np.random.default_rng(seed)
    human = rng.uniform([-2, -2, 0], [2, 2, 2], (count, 3))
    robot = rng.uniform([-0.8, -0.8, 0.1], [0.8, 0.8, 1.2], (count, 3))
    step = np.searchsorted(THRESHOLDS_M, np.linalg.norm(human - robot, axis=1))
    X = np.concatenate([robot, human], axis=1)
    return ((X - X.mean(axis=0)) / X.std(axis=0)).astype(np.float32), step.astype(np.int64)


def mse(probabilities: np.ndarray, step: np.ndarray) -> float:
    """Return the mean squared error of the softmax mean of the levels."""
    return float(np.mean((probabilities @ LEVELS - LEVELS[step]) ** 2))


def cyclekit_loop(
    X: np.ndarray, step: np.ndarray, seed: int, epochs: int, **settings: str
) -> Iterator[Callable[..., np.ndarray]]:
    """Train as `fitting` does: random rows of one tensor, one rise and fall of the learning rate over all epochs."""
    torch.manual_seed(seed)
    spec = ModelSpec.of("now", "classifier", **settings).for_rows(len(X))  # type: ignore[arg-type]
    net = build(spec, 6, LEVELS.tolist())
    x, target = torch.from_numpy(X), torch.from_numpy(step)
    batches = len(x) // spec.batch
    steps = Steps(net, spec, 0.005, epochs * batches)
    for epoch in range(epochs):
        parts = torch.randperm(len(x)).tensor_split(batches)
        for first in range(0, batches, batches // 16):
            net.train()
            if epoch * batches + first >= (spec.freeze_norm_after or 0) * epochs * batches:
                freeze_norm(net)
            with one_fast_thread():
                for part in parts[first : first + batches // 16]:
                    steps.take(nn.functional.cross_entropy(net(x[part]), target[part]))
            yield lambda V: _of_torch(net, V)


def loader_loop(X: np.ndarray, step: np.ndarray, seed: int) -> Iterator[Callable[..., np.ndarray]]:
    """Train as tutorials do: a DataLoader of batches of 256, Adam, batch normalisation."""
    torch.manual_seed(seed)
    net = build(ModelSpec.of("now", "classifier"), 6, LEVELS.tolist())
    optimiser = torch.optim.Adam(net.parameters(), lr=1e-3)
    data = DataLoader(TensorDataset(torch.from_numpy(X), torch.from_numpy(step)), batch_size=256, shuffle=True)
    for _ in range(30):
        net.train()
        for number, (x, target) in enumerate(data):
            optimiser.zero_grad()
            nn.functional.cross_entropy(net(x), target).backward()
            optimiser.step()
            if number % 300 == 299:
                yield lambda V: _of_torch(net, V)
                net.train()


def scikit_learn(X: np.ndarray, step: np.ndarray, seed: int) -> Iterator[Callable[..., np.ndarray]]:
    """Train scikit-learn's MLPClassifier in sixteenths of an epoch."""
    net = MLPClassifier((64,) * 4, batch_size=256, random_state=seed)
    for _ in range(30):
        for part in np.array_split(np.random.default_rng(seed).permutation(len(X)), 16):
            net.partial_fit(X[part], step[part], classes=np.arange(5))
            yield net.predict_proba


def _of_torch(net: nn.Module, V: np.ndarray) -> np.ndarray:
    net.eval()
    with torch.inference_mode():
        out = [torch.softmax(net(block), 1) for block in torch.from_numpy(V).split(16_384)]
    return np.asarray(torch.cat(out).numpy())


def timed(
    loop: Iterator[Callable[..., np.ndarray]], V: np.ndarray, truth: np.ndarray, goal: float, *, to_the_end: bool
) -> tuple[float, ...]:
    """Return wall and CPU time until the goal, s, and (if wanted) CPU time, s, and final error of the whole run.

    The times are infinite if the goal is not reached within GIVE_UP_S seconds of CPU time.
    """
    wall = cpu = 0.0
    reached, error = (float("inf"), float("inf")), float("nan")
    while cpu < GIVE_UP_S:
        begin = time.perf_counter(), time.process_time()
        predict = next(loop, None)
        wall, cpu = wall + time.perf_counter() - begin[0], cpu + time.process_time() - begin[1]
        if predict is None:
            return *reached, cpu, error
        error = mse(predict(V), truth)
        if error <= goal and cpu < reached[1]:
            reached = wall, cpu
            if not to_the_end:
                break
    return *reached, float("nan"), float("nan")


def prediction_rate() -> tuple[float, float]:
    """Return million rows per second and per CPU second that the folded network predicts in numpy, best of 5."""
    rng = np.random.default_rng(0)
    sizes = [6, 64, 64, 64, 64, 5]
    layers = tuple(
        (rng.normal(0, 0.2, (a, b)).astype(np.float32), np.zeros(b, np.float32)) for a, b in itertools.pairwise(sizes)
    )
    weights, X = Weights(layers, 4), rng.normal(size=(1_000_000, 6)).astype(np.float32)
    took = []
    for _ in range(5):
        begin = time.perf_counter(), time.process_time()
        weights.run(X)
        took.append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
    return 1 / min(wall for wall, _ in took), 1 / min(cpu for _, cpu in took)


def main() -> None:
    """Run everything and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--goal", type=float, default=2e-3)
    parser.add_argument("--rows", type=int, default=600_000)
    parser.add_argument("--near", action="store_true", help="compare only one epoch of cyclekit with scikit-learn")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    X, step = rows(options.rows, 0)
    V, truth = rows(60_000, 1)
    ways: dict[str, Callable[[int], Iterator[Callable[..., np.ndarray]]]] = {
        f"cyclekit, {what}, {epochs} epochs".replace("1 epochs", "1 epoch"): partial(
            cyclekit_loop, X, step, epochs=epochs, **settings
        )
        for epochs in (1, 5)
        for what, settings in (("the default", {}), ("no normalisation", {"norm": "none"}), ("AdamW", ADAMW))
    }
    ways |= {
        "scikit-learn MLPClassifier": lambda seed: scikit_learn(X, step, seed),
        "DataLoader, batch 256, Adam": lambda seed: loader_loop(X, step, seed),
    }
    if options.near:
        ways = {name: way for name, way in ways.items() if "1 epoch" in name or name.startswith("scikit")}
    found = defaultdict(list)
    with threadpool_limits(options.threads):
        for way in ways.values():
            next(way(0))  # imports and first calls are not timed
        for seed, (name, way) in itertools.product(range(options.repeats), ways.items()):
            ends = name.startswith("cyclekit") and not options.near
            found[name].append(timed(way(seed), V, truth, options.goal, to_the_end=ends))
    columns = ("way", "wall s", "CPU s", "factor to the first", "whole run, CPU s", "its MSE x 1e4")
    shown = Table(*columns, title=f"to a validation MSE of {options.goal:g}")
    first = median(each[1] for each in next(iter(found.values())))
    for name, times in found.items():
        wall, cpu, whole, error = (median(each) for each in zip(*times, strict=True))
        shown.add_row(name, f"{wall:.2f}", f"{cpu:.2f}", f"{cpu / first:.1f}", f"{whole:.1f}", f"{error * 1e4:.2f}")
    Console(width=120).print(shown)
    Console().print("prediction: {:.2f} M rows/s, {:.2f} M rows/cpu s".format(*prediction_rate()))


if __name__ == "__main__":
    main()
