"""The training loop: batches of one tensor, fused AdamW, one rise and fall of the learning rate, best epoch kept.

A data loader that returns single rows dominates the training time of small networks, so the rows are one tensor on the
device and a batch is an index into it. Same rows, spec and seed give the same weights on a CPU; torch's global random
state is not changed.
"""

from __future__ import annotations

import copy
import math
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import nn

from cyclekit.dataset.cards import EpochCard
from cyclekit.errors import ConfigError
from cyclekit.learning.networks.fitted import Fitted
from cyclekit.learning.networks.folding import fold
from cyclekit.learning.networks.metrics import best_temperature
from cyclekit.learning.networks.network import Forecasting, build
from cyclekit.learning.networks.optimiser import Steps
from cyclekit.learning.networks.rows import DISTANCE_1_M, DISTANCE_M, TrainingRows, rows_on, standardisation
from cyclekit.text.numbers import given, scientific

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.windows import Samples
    from cyclekit.schema import Floats, Progress


_BLOCK = 16_384
_STEPS, _EPOCHS = 12_000, (8, 100)
"""Default number of epochs: as many as give this many steps, within these bounds."""
_CENTRE_ROWS = 200_000
_DECAY_ROWS, _MAX_DECAY = 3000, 0.1
"""Default weight decay: this number divided by the training rows, with a maximum; few rows need more."""


class CutOff(ConfigError):
    """A network predicts 0, or 1, for every input; the output is clipped there and has no gradient."""


def fit(
    spec: ModelSpec,
    rows: Samples,
    validation: Samples,
    levels: Sequence[float],
    progress: Progress | None = None,
    *,
    known: Sequence[str] = (),
) -> Fitted:
    """Train a network.

    Args:
        spec: What to train.
        rows: Training rows; a classifier drops those on no level.
        validation: Rows that select the best epoch and the temperature of a classifier.
        levels: Levels of the speed scaling, ascending.
        progress: Called after each epoch with the share done and the validation error.
        known: Groups of inputs that may be unknown.

    Raises:
        ConfigError: Training diverged.
        CutOff: All outputs are clipped at the end. If the optimiser was chosen automatically, AdamW is tried first:
            with Muon the other weights take larger steps, and one of these may push all outputs out of range.
    """
    standard = standardisation(rows.X)
    device = torch.device("cuda" if torch.cuda.is_available() and not rows.in_files else "cpu")
    names_steps = spec.kind.is_classifier
    if names_steps and not rows.in_files:  # rows in files were filtered before
        rows = rows.where(rows.step >= 0)
    asked, spec = spec, spec.for_rows(len(rows))
    learn = rows_on(device, rows, spec, standard, known)
    check = rows_on(device, validation, spec, standard, known)
    with torch.random.fork_rng(devices=[]), one_fast_thread():
        steps = torch.tensor(levels, device=device)
        network = _fresh(spec, rows, levels, known, standard[1]).to(device)
        try:
            history = _run(network, spec, learn, check, steps, progress)
        except CutOff:
            if (asked.optimiser, spec.optimiser) != ("auto", "muon"):
                raise
            spec = replace(asked, optimiser="adamw").for_rows(len(rows))
            network = _fresh(spec, rows, levels, known, standard[1]).to(device)
            history = _run(network, spec, learn, check, steps, progress)
        if spec.centre and not names_steps:
            _centre(network, spec, learn)
        on_level = validation.step >= 0
        temperature = 1.0
        if names_steps and on_level.any():
            temperature = best_temperature(_outputs(network, check).cpu().numpy()[on_level], validation.step[on_level])
    distance = (DISTANCE_M, DISTANCE_1_M) if spec.features == "distance" else None
    folded = fold(network, *standard, known, temperature=temperature, distance=distance)
    return Fitted(spec, folded, history, *standard, temperature)


def _fresh(spec: ModelSpec, rows: Samples, levels: Sequence[float], known: Sequence[str], scale: Floats) -> nn.Module:
    torch.manual_seed(spec.seed)
    return build(spec, rows.X.shape[1], levels, known, scale)


@contextmanager
def one_fast_thread() -> Iterator[None]:
    """Limit torch to one thread: layers this small gain little from a second one.

    Threads synchronise after every layer; with another program on one of the cores, training took 40 times as long.
    With one thread, the result does not depend on the number of cores either. Numbers below 1e-38, frequent in the
    gradients of confident rows, are flushed to zero, because processors handle them many times more slowly.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
        torch.set_num_threads(threads)


def _run(
    network: nn.Module,
    spec: ModelSpec,
    learn: TrainingRows,
    check: TrainingRows,
    levels: torch.Tensor,
    progress: Progress | None,
) -> tuple[EpochCard, ...]:
    """Train in place; `network` ends with the weights of the best epoch."""
    batches = max(len(learn) // spec.batch, 1)
    epochs = spec.epochs or min(max(round(_STEPS / batches), _EPOCHS[0]), _EPOCHS[1])
    decay = min(_DECAY_ROWS / len(learn), _MAX_DECAY) if spec.weight_decay is None else spec.weight_decay
    steps = Steps(network, spec, decay, max(batches * epochs, 20))  # a shorter schedule cannot rise and fall
    balance = _balance(learn, len(levels)) if spec.balance == "classes" and spec.kind.is_classifier else None
    history: list[EpochCard] = []
    spread = _spread(check)
    best, best_state, since = float("inf"), copy.deepcopy(network.state_dict()), 0
    for number in range(1, epochs + 1):
        network.train()
        total = torch.zeros((), device=learn.scaling.device)
        for count, part in enumerate(learn.batches(batches), (number - 1) * batches):
            if count >= (spec.freeze_norm_after or 0.0) * epochs * batches:
                freeze_norm(network)
            loss = _loss(network, spec, learn, part, balance)
            steps.take(loss)
            total += loss.detach()
        mse = _validation_mse(network, check, levels if spec.kind.is_classifier else None)
        history.append(EpochCard(epoch=number, loss=float(total) / batches, validation_mse=mse))
        since += 1
        if mse < best:
            best, best_state, since = mse, copy.deepcopy(network.state_dict()), 0
        if progress:
            progress(number / epochs, f"epoch {number} of {epochs}, validation MSE {scientific(mse)}")
        if spec.patience is not None and since >= spec.patience:
            break
    if mse > spread and not spec.kind.is_classifier and (value := _cut_off(network, check)) is not None:
        msg = f"training collapsed: after {number} epochs the output is {given(value)} for every input"
        raise CutOff(msg, cure="Choose another --seed, --optimiser adamw or --norm none.")
    if not math.isfinite(best):
        msg = f"training diverged: the validation error is {mse} after {epochs} epochs"
        raise ConfigError(msg, cure="Choose a lower learning rate.")
    network.load_state_dict(best_state)
    return tuple(history)


def _loss(
    network: nn.Module, spec: ModelSpec, learn: TrainingRows, part: torch.Tensor, balance: torch.Tensor | None
) -> torch.Tensor:
    """Return the weighted mean loss of a batch."""
    x = learn.inputs(part, spec.noise_m)
    out, weight = network(x), learn.weight[part]
    if spec.kind.is_classifier:
        step = learn.step[part]
        each = nn.functional.cross_entropy(out, step, reduction="none")
        weight = weight if balance is None else weight * balance[step]
    else:
        each = ((out - learn.scaling[part]) ** 2)[:, 0]
    if isinstance(network, Forecasting) and learn.ahead is not None and network.forecast is not None:
        seen = learn.ahead_known[part]
        off = ((network.forecast - learn.ahead[part]) ** 2).mean(dim=1)
        each = each + spec.forecast_weight * torch.where(seen, off, torch.zeros_like(off))
    return (each * weight).sum() / weight.sum()


def _balance(learn: TrainingRows, count: int) -> torch.Tensor:
    """Return the weights that give every level the same total weight, shape (P,); mean 1 over the rows."""
    rows = torch.bincount(learn.step, minlength=count).clamp(min=1).to(torch.float32)
    return float(len(learn)) / (count * rows)


def freeze_norm(network: nn.Module) -> None:
    """Make batch normalisation keep its present statistics instead of those of each batch."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm1d):
            module.eval()


def _centre(network: nn.Module, spec: ModelSpec, learn: TrainingRows) -> None:
    """Shift the output so that its mean error over (a subset of) the training rows is zero.

    One Newton step: rows clipped to 0 or 1 do not move.
    """
    network.eval()
    last = [module for module in network.modules() if isinstance(module, nn.Linear)][-1]
    every = torch.arange(0, len(learn), math.ceil(len(learn) / _CENTRE_ROWS), device=learn.scaling.device)
    off, moved = torch.zeros(2, device=learn.scaling.device).unbind()
    with torch.inference_mode():
        for part in torch.split(every, _BLOCK):
            out = network(learn.inputs(part, spec.noise_m))[:, 0]
            off = off + ((out - learn.scaling[part, 0]) * learn.weight[part]).sum()
            moved = moved + (((out > 0) & (out < 1)) * learn.weight[part]).sum()
    if moved > 0:
        with torch.no_grad():
            last.bias.sub_(off / moved)


def _cut_off(network: nn.Module, check: TrainingRows) -> float | None:
    """Return the bound that all outputs on the validation part reach or exceed; None if they do not."""
    out = _outputs(network, check)
    return 1.0 if bool((out >= 1.0).all()) else 0.0 if bool((out <= 0.0).all()) else None


def _spread(check: TrainingRows) -> float:
    """Return the weighted variance of the scaling in the validation part: the MSE of its mean."""
    weight = check.weight / check.weight.sum()
    off = check.scaling[:, 0] - (check.scaling[:, 0] * weight).sum()
    return float((off**2 * weight).sum())


def _outputs(network: nn.Module, rows: TrainingRows) -> torch.Tensor:
    network.eval()
    with torch.inference_mode():
        every = torch.arange(len(rows), device=rows.scaling.device)
        return torch.cat([network(rows.inputs(part, 0.0)) for part in torch.split(every, _BLOCK)])


def _validation_mse(network: nn.Module, check: TrainingRows, levels: torch.Tensor | None) -> float:
    out = _outputs(network, check)
    values = torch.softmax(out, dim=1) @ levels[:, None] if levels is not None else out.clamp(0.0, 1.0)
    return float(((values - check.scaling)[:, 0] ** 2 * check.weight).sum() / check.weight.sum())
