"""Parts of the paper's networks: a body and a head (`kinds` has each network).

    body   feed-forward   linear, batch normalisation (or none), ReLU
           lstm-1         two LSTM layers over the history, then feed-forward layers
           lstm-2         one LSTM layer over the operator's history forecasts his position, which replaces the present
                          one as input of the feed-forward layers
    head   classifier     P logits
           regressor      one value, Hardtanh into [0, 1] (`Bounded`)
           mixed          softmax over P, then one linear value

Inputs are standardised. Each group of inputs that may be unknown (`windows.GROUPS`) has an additional input, 1 = known,
0 = unknown; the unknown values themselves are then 0. A trained network is folded into plain matrices on raw inputs
(`folding`), which need no torch.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import nn

from cyclekit.learning.networks.kinds import NETWORKS, Inputs
from cyclekit.learning.windows import GROUPS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.networks.kinds.kind import Widths
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.schema import Floats

_HUMAN = GROUPS["human"]
_LEAK = 0.01


def build(
    spec: ModelSpec, inputs: int, levels: Sequence[float], known: Sequence[str] = (), scale: Floats | None = None
) -> nn.Module:
    """Return the untrained network of `spec`; its initial weights come from torch's random state.

    Args:
        spec: The training run.
        inputs: Number of inputs F, without the flags of `known`.
        levels: Levels of the speed scaling, ascending.
        known: Groups with an additional input that indicates whether they are known.
        scale: 1/standard deviation of every input, shape (F,); constant ones (0) are not forecast. None: all vary.

    Returns:
        A module from (B, F + groups), with a history from (B, K, F + groups), to logits (B, P) of a classifier or
        values (B, 1).
    """
    width = inputs + len(known) + (spec.features == "distance")
    varies = [True] * 3 if scale is None else (scale[_HUMAN] > 0).tolist()
    return NETWORKS[spec.network].build(spec, Inputs(width, ("human" in known) * inputs, tuple(varies)), levels)


class Recurrent(nn.Module):
    """LSTM-1: the regression network with LSTM layers as its first two layers; the last state is passed on."""

    def __init__(self, inputs: int, spec: Widths, head: list[nn.Module]) -> None:
        """Build it for a number of inputs."""
        super().__init__()
        width = spec.hidden[0]
        self.lstm = nn.LSTM(inputs, width, num_layers=2, batch_first=True)
        self.rest = nn.Sequential(*feed_forward((width, *spec.hidden[2:]), spec.norm), *head)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return values (B, 1) for histories (B, K, inputs)."""
        states, _ = self.lstm(x)
        out: torch.Tensor = self.rest(states[:, -1])
        return out


class Forecasting(nn.Module):
    """LSTM-2: forecast of the operator's position from past ones, followed by the regression network.

    `forecast` of the last call, shape (B, 3), standardised, is kept for the loss. A coordinate that never varies is
    forecast as its constant value; a free output would not be a position but an additional channel between the
    networks.
    """

    varies: torch.Tensor

    def __init__(self, inputs: int, spec: Widths, head: list[nn.Module], presence: int, varies: torch.Tensor) -> None:
        """Build it for a number of inputs.

        Args:
            inputs: Number of inputs of the regressor.
            spec: Widths and normalisation.
            head: Last layers.
            presence: Column that indicates the operator's presence; 0 if there is none.
            varies: 1 for each of his coordinates that varies, 0 for the others, shape (3,).
        """
        super().__init__()
        self.register_buffer("varies", varies, persistent=False)
        width = spec.hidden[0]
        self.columns = [*range(_HUMAN.start, _HUMAN.stop), *([presence] if presence else [])]
        self.lstm = nn.LSTM(len(self.columns), width, batch_first=True)
        self.ahead = nn.Linear(width, _HUMAN.stop - _HUMAN.start)
        self.rest = nn.Sequential(*feed_forward((inputs, *spec.hidden), spec.norm), *head)
        self.forecast: torch.Tensor | None = None

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return values (B, 1) for histories (B, K, inputs)."""
        states, _ = self.lstm(x[:, :, self.columns])
        self.forecast = self.ahead(states[:, -1]) * self.varies
        now = x[:, -1]
        out: torch.Tensor = self.rest(torch.cat([now[:, : _HUMAN.start], self.forecast, now[:, _HUMAN.stop :]], dim=1))
        return out


class Bounded(nn.Hardtanh):
    """Hardtanh into [0, 1] with a leak of 1 % beyond its bounds in training.

    Outside of its bounds a Hardtanh has no gradient. A network with batch normalisation can be pushed there for all
    rows at once, and would never return.
    """

    def __init__(self) -> None:
        """Set the bounds to [0, 1]."""
        super().__init__(0.0, 1.0)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return values (B, 1) in [0, 1]; in training slightly beyond."""
        inside = super().forward(x)
        return inside + _LEAK * (x - inside) if self.training else inside


def feed_forward(widths: Sequence[int], norm: str) -> list[nn.Module]:
    """Return the hidden layers between these widths; the first width is that of the input."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers.append(nn.Linear(before, after))
        if norm == "batch":
            layers.append(nn.BatchNorm1d(after))
        layers.append(nn.ReLU())
    return layers


def bounded_value(width: int) -> list[nn.Module]:
    """Return the last layers of a network that predicts one value in [0, 1]."""
    out = nn.Linear(width, 1)
    nn.init.constant_(out.bias, 0.5)  # start inside of [0, 1], where the gradient is
    return [out, Bounded()]
