"""Converts a trained torch module to plain matrices on raw inputs, without torch."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import nn

from cyclekit.errors import ModelError
from cyclekit.learning.networks.network import Forecasting, Recurrent
from cyclekit.learning.networks.weights import Weights
from cyclekit.learning.windows import GROUPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import torch

    from cyclekit.schema import Vector


_HUMAN = GROUPS["human"]


def fold(
    network: nn.Module,
    mean: Vector,
    scale: Vector,
    known: Sequence[str] = (),
    *,
    temperature: float = 1.0,
    distance: tuple[float, float] | None = None,
) -> Weights:
    """Return the network as matrices on raw inputs.

    Args:
        network: Network of `network.build`, trained on (x - mean) * scale.
        mean: Mean of every input, shape (F,).
        scale: Factor on every input after subtraction, shape (F,); 0 disables an input.
        known: Groups with an additional input that indicates whether they are known.
        temperature: Divisor of a classifier's logits.
        distance: Offset, m, and factor, 1/m, of the distance if it is the last input; None if it is not.
    """
    apart = [] if distance is None else [distance]
    middle = np.concatenate([mean, np.zeros(len(known)), [offset for offset, _ in apart]])
    factor = np.concatenate([scale, np.ones(len(known)), [per_m for _, per_m in apart]])
    unknown = mean.astype(np.float32) if known else np.empty(0, np.float32)
    base = Weights((), known=tuple(known), distance=apart[0][0] if apart else None, middle=unknown)
    if isinstance(network, Recurrent):
        cells = _cells(network.lstm)
        cells[0] = _on_raw(cells[0], middle, factor)
        return replace(base, layers=_rounded(_layers(network.rest)), recurrent=_rounded(cells))
    if isinstance(network, Forecasting):
        cells = _cells(network.lstm)
        cells[0] = _on_raw(cells[0], middle[network.columns], factor[network.columns])
        spread = np.where(scale[_HUMAN] > 0, 1 / np.where(scale[_HUMAN] > 0, scale[_HUMAN], 1.0), 0.0)
        ahead = _numbers(network.ahead.weight).T * spread, _numbers(network.ahead.bias) * spread + mean[_HUMAN]
        layers = _layers(network.rest)
        layers[0] = _on_raw(layers[0], middle, factor)
        (forecast,) = _rounded([ahead])
        return replace(base, layers=_rounded(layers), recurrent=_rounded(cells), forecast=forecast)
    modules = list(network.children())
    layers = _layers(modules)
    layers[0] = _on_raw(layers[0], middle, factor)
    layers[-1] = (layers[-1][0] / temperature, layers[-1][1] / temperature)
    mixed = any(isinstance(module, nn.Softmax) for module in modules)
    after = None if isinstance(modules[-1], nn.Hardtanh) else len(layers) - 1 - mixed
    return replace(base, layers=_rounded(layers), softmax_after=after)


def _layers(modules: Iterable[nn.Module]) -> list[tuple[Vector, ...]]:
    """Return weight (inputs, outputs) and bias of every linear layer, with batch normalisation folded in."""
    layers: list[tuple[Vector, ...]] = []
    for module in modules:
        if isinstance(module, nn.Linear):
            layers.append((_numbers(module.weight).T, _numbers(module.bias)))
        elif isinstance(module, nn.BatchNorm1d):
            weight, bias = layers[-1]
            gain = _numbers(module.weight) / np.sqrt(_numbers(module.running_var) + module.eps)
            layers[-1] = (weight * gain, (bias - _numbers(module.running_mean)) * gain + _numbers(module.bias))
    return layers


def _cells(lstm: nn.LSTM) -> list[tuple[Vector, ...]]:
    """Return the weights of every LSTM layer, with torch's two biases added."""
    found: list[tuple[Vector, ...]] = []
    for k in range(lstm.num_layers):
        of_input, of_state, bias, more = (
            _numbers(getattr(lstm, f"{name}_l{k}")) for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        )
        found.append((of_input.T, of_state.T, bias + more))
    return found


def _on_raw(part: tuple[Vector, ...], middle: Vector, factor: Vector) -> tuple[Vector, ...]:
    """Return a layer (first weight, ..., bias) for raw inputs instead of standardised ones."""
    weight = part[0] * factor[:, None]
    return (weight, *part[1:-1], part[-1] - middle @ weight)


def _rounded(parts: Sequence[tuple[Vector, ...]]) -> Any:  # noqa: ANN401 - pairs or triples, as given
    return tuple(tuple(np.ascontiguousarray(array, np.float32) for array in part) for part in parts)


def _numbers(tensor: torch.Tensor | None) -> Vector:
    if tensor is None:
        raise ModelError("a layer without its running statistics cannot be folded", cure="Train it again.")
    return tensor.detach().cpu().double().numpy()
