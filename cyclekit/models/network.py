"""The networks of the paper, put together from a body and a head. The only module here that imports torch.

    body   feed-forward layers: linear, batch normalisation (or none), ReLU
    head   classifier: P logits
           regressor: one value, Hardtanh into [0, 1]
           mixed: softmax over P, then one linear value

Trained, a network is folded into plain matrices (`fold`), and torch is needed no more.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.models.spec import ModelSpec


def build(spec: ModelSpec, inputs: int, levels: Sequence[float]) -> nn.Sequential:
    """Return the untrained network of `spec` for that many inputs; its first weights come from torch's random state.

    A classifier ends in logits (N, P); the others in one value (N, 1).
    """
    return nn.Sequential(*_body(inputs, spec), *_head(spec, levels))


def _body(inputs: int, spec: ModelSpec) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for before, after in pairwise((inputs, *spec.hidden)):
        layers.append(nn.Linear(before, after))
        if spec.norm == "batch":
            layers.append(nn.BatchNorm1d(after))
        layers.append(nn.ReLU())
    return layers


def _head(spec: ModelSpec, levels: Sequence[float]) -> list[nn.Module]:
    width, count = spec.hidden[-1], len(levels)
    if spec.network == "classifier":
        return [nn.Linear(width, count)]
    if spec.network == "mixed":
        out = nn.Linear(count, 1)
        with torch.no_grad():  # start from "membership in a level means its value"
            out.weight.copy_(torch.tensor(levels)[None, :])
            out.bias.zero_()
        return [nn.Linear(width, count), nn.Softmax(dim=1), out]
    out = nn.Linear(width, 1)
    nn.init.constant_(out.bias, 0.5)  # Hardtanh passes no gradient outside [0, 1], so start inside
    return [out, nn.Hardtanh(0.0, 1.0)]


def fold(
    network: nn.Sequential, mean: NDArray[np.float64], scale: NDArray[np.float64]
) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]:
    """Return the network as matrices on raw inputs: batch normalisation and standardisation folded in.

    Args:
        network: As `build` made it, trained on (x - mean) * scale.
        mean: Subtracted from every input, shape (F,).
        scale: Multiplied after that, shape (F,); 0 switches an input off.

    Returns:
        Weight (inputs, outputs) and bias (outputs,) of each layer, float32.
    """
    layers: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for module in network:
        if isinstance(module, nn.Linear):
            layers.append((_numbers(module.weight).T, _numbers(module.bias)))
        elif isinstance(module, nn.BatchNorm1d):
            weight, bias = layers[-1]
            deviation = np.sqrt(_numbers(module.running_var) + module.eps)
            gain = _numbers(module.weight) / deviation
            layers[-1] = (weight * gain, (bias - _numbers(module.running_mean)) * gain + _numbers(module.bias))
    weight, bias = layers[0]
    weight = weight * scale[:, None]
    layers[0] = (weight, bias - mean @ weight)
    return tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in layers)


def _numbers(tensor: torch.Tensor | None) -> NDArray[np.float64]:
    assert tensor is not None  # batch normalisation is built with its running statistics
    return tensor.detach().cpu().double().numpy()
