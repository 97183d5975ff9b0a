"""The training loop: slices of one tensor, a fused AdamW, one rise and fall of the learning rate, the best epoch kept.

A loader that hands out rows one by one is what makes small networks slow; here the shuffled rows are one tensor on the
device and a batch is a slice of it. Same rows, spec and seed give the same weights on a CPU, and torch's global random
state is left as it was.
"""

from __future__ import annotations

import copy
import math
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from cyclekit.errors import ConfigError
from cyclekit.models.network import build, fold

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.models.layout import Layers
    from cyclekit.models.spec import ModelSpec
    from cyclekit.samples import Samples

    Progress = Callable[[float, str], None]

_BLOCK = 16_384
_STEPS, _EPOCHS = 6000, (8, 100)
"""Where no number of epochs is asked for: as many as make this many steps, within these bounds."""
_DECAY_ROWS, _MOST_DECAY = 3000, 0.1
"""Where no weight decay is asked for: this many divided by the training rows. Few rows need it, many hardly any."""


@dataclass(frozen=True)
class Epoch:
    """One pass over the training rows: mean training loss, and MSE of the best estimate on the validation part."""

    epoch: int
    loss: float
    validation_mse: float


@dataclass(frozen=True)
class Fitted:
    """What fitting gives.

    Attributes:
        layers: The best epoch's network as matrices on raw inputs.
        history: One entry per epoch.
        mean: Mean of every input, shape (F,), m.
        scale: 1/deviation of every input, shape (F,), 1/m; 0 for an input that does not vary.
    """

    layers: Layers
    history: tuple[Epoch, ...]
    mean: NDArray[np.float64]
    scale: NDArray[np.float64]


@dataclass(frozen=True)
class _Rows:
    """Rows as tensors on the device: inputs standardised, `target` (N,) int64 of a classifier, else (N, 1) float32."""

    x: torch.Tensor
    target: torch.Tensor
    scaling: torch.Tensor


def fit(
    spec: ModelSpec,
    rows: Samples,
    validation: Samples,
    levels: Sequence[float],
    progress: Progress | None = None,
) -> Fitted:
    """Train a network.

    Args:
        spec: What to train.
        rows: Rows to learn from; a classifier leaves out those on no level.
        validation: Rows that decide which epoch is kept.
        levels: Staircase levels, ascending.
        progress: Told the fraction done and the validation error after each epoch.
    """
    mean, scale = standardisation(rows.X)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    learn = _tensors(rows.where(rows.step >= 0) if spec.network == "classifier" else rows, spec, (mean, scale), device)
    check = _tensors(validation, spec, (mean, scale), device)
    with torch.random.fork_rng(devices=[]), _one_thread():
        torch.manual_seed(spec.seed)
        network = build(spec, rows.X.shape[1], levels).to(device)
        history = _run(network, spec, learn, check, torch.tensor(levels, device=device), progress)
    return Fitted(fold(network, mean, scale), history, mean, scale)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep torch to one core: layers this small gain little from a second, and lose everything if that one is busy.

    Threads wait for each other after every layer; with another program on one of the cores, training took 40 times as
    long. On one core the result does not depend on the machine's number of cores either.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def standardisation(X: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and 1/deviation of every input, shape (F,) each; 0 for an input that does not vary."""
    mean, deviation = X.mean(axis=0, dtype=np.float64), X.std(axis=0, dtype=np.float64)
    varies = deviation > 1e-6  # a micrometre: less carries nothing, and dividing by it would magnify noise
    return mean, np.where(varies, 1 / np.where(varies, deviation, 1.0), 0.0)


def _tensors(
    rows: Samples, spec: ModelSpec, standard: tuple[NDArray[np.float64], NDArray[np.float64]], device: torch.device
) -> _Rows:
    mean, scale = standard
    scaling = torch.from_numpy(rows.scaling.astype(np.float32))[:, None].to(device)
    target = torch.from_numpy(rows.step.astype(np.int64)).to(device) if spec.network == "classifier" else scaling
    return _Rows(torch.from_numpy(((rows.X - mean) * scale).astype(np.float32)).to(device), target, scaling)


def _run(
    network: nn.Sequential,
    spec: ModelSpec,
    learn: _Rows,
    check: _Rows,
    levels: torch.Tensor,
    progress: Progress | None,
) -> tuple[Epoch, ...]:
    """Train in place and leave the weights of the best epoch in `network`."""
    batches = max(len(learn.x) // spec.batch, 1)
    epochs = spec.epochs or min(max(round(_STEPS / batches), _EPOCHS[0]), _EPOCHS[1])
    decay = min(_DECAY_ROWS / len(learn.x), _MOST_DECAY) if spec.weight_decay is None else spec.weight_decay
    optimiser = torch.optim.AdamW(network.parameters(), lr=spec.learning_rate, weight_decay=decay, fused=True)
    total_steps = max(batches * epochs, 10)  # fewer cannot rise and fall
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, spec.learning_rate, total_steps, pct_start=0.2)
    loss_of: nn.Module = nn.CrossEntropyLoss() if spec.network == "classifier" else nn.MSELoss()
    history: list[Epoch] = []
    best, best_state = float("inf"), copy.deepcopy(network.state_dict())
    for number in range(1, epochs + 1):
        network.train()
        if number > spec.freeze_norm_after * epochs:
            _freeze_norm(network)
        total = torch.zeros((), device=learn.x.device)
        order = torch.randperm(len(learn.x)).to(learn.x.device)
        for part in order.tensor_split(batches):
            optimiser.zero_grad(set_to_none=True)
            loss = loss_of(network(learn.x[part]), learn.target[part])
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.detach()
        mse = _validation_mse(network, check, levels if spec.network == "classifier" else None)
        history.append(Epoch(number, float(total) / batches, mse))
        if mse < best:
            best, best_state = mse, copy.deepcopy(network.state_dict())
        if progress:
            progress(number / epochs, f"epoch {number} of {epochs}, validation MSE {mse:.2e}")
    if not math.isfinite(best):
        msg = f"training diverged: the validation error is {mse} after {epochs} epochs"
        raise ConfigError(msg, cure="Choose a lower learning rate.")
    network.load_state_dict(best_state)
    return tuple(history)


def _freeze_norm(network: nn.Sequential) -> None:
    """Let batch normalisation keep the statistics that it has, instead of measuring every batch anew."""
    for module in network:
        if isinstance(module, nn.BatchNorm1d):
            module.eval()


def _validation_mse(network: nn.Sequential, check: _Rows, levels: torch.Tensor | None) -> float:
    network.eval()
    with torch.inference_mode():
        out = torch.cat([network(block) for block in torch.split(check.x, _BLOCK)])
        values = torch.softmax(out, dim=1) @ levels[:, None] if levels is not None else out.clamp(0.0, 1.0)
        return float(torch.mean((values - check.scaling) ** 2))
