"""The parts that the networks of the paper are put together from: a body and a head (`networks` has each).

    body   feed-forward   linear, batch normalisation (or none), ReLU
           lstm-1         two LSTM layers over the history, then feed-forward layers
           lstm-2         one LSTM layer over the operator's history forecasts where he will be; the feed-forward layers
                          see that in place of where he is
    head   classifier     P logits
           regressor      one value, Hardtanh into [0, 1] (`Bounded`)
           mixed          softmax over P, then one linear value

Inputs are standardised. For each group of inputs that may be unknown (`samples.GROUPS`) there is one more, which says
1 = known or 0 = unknown; the unknown values themselves are then 0. Trained, a network is folded into plain matrices on
raw inputs (`folding`), and torch is needed no more.
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
    """Return the untrained network of `spec`; its first weights come from torch's random state.

    Args:
        spec: Which one.
        inputs: Number of inputs F, without those that say "known".
        levels: Staircase levels, ascending.
        known: Groups that have an input which says whether they are known.
        scale: 1/deviation of every input, shape (F,): what does not vary (0) is not forecast either. None: all varies.

    Returns:
        A module from (B, F + groups), with a history from (B, K, F + groups), to logits (B, P) of a classifier or
        values (B, 1).
    """
    width = inputs + len(known) + (spec.features == "distance")
    varies = [True] * 3 if scale is None else (scale[_HUMAN] > 0).tolist()
    return NETWORKS[spec.network].build(spec, Inputs(width, ("human" in known) * inputs, tuple(varies)), levels)


class Recurrent(nn.Module):
    """LSTM-1: the first two layers of the regression network are LSTM layers; the last state goes on."""

    def __init__(self, inputs: int, spec: Widths, head: list[nn.Module]) -> None:
        """Build it for that many inputs."""
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
    """LSTM-2: forecast of the operator's position from the past ones; then the regression network.

    `forecast` of the last call, shape (B, 3), standardised, is kept for the loss. A coordinate that never varies is
    forecast as what it always is: left free, it would be no position but one more channel between the two networks.
    """

    varies: torch.Tensor

    def __init__(self, inputs: int, spec: Widths, head: list[nn.Module], presence: int, varies: torch.Tensor) -> None:
        """Build it for that many inputs.

        Args:
            inputs: Of the regressor.
            spec: Widths and normalisation.
            head: Last layers.
            presence: Column that says whether the operator is there, 0 for none.
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
    """Hardtanh into [0, 1] that lets a network back in: in training a hundredth of what lies beyond comes through.

    Outside of its bounds a Hardtanh has no slope. The networks of the paper, with batch normalisation, can be thrown
    there with every row at once, and would stay for good.
    """

    def __init__(self) -> None:
        """Take no setting."""
        super().__init__(0.0, 1.0)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return values (B, 1) in [0, 1], in training about so."""
        inside = super().forward(x)
        return inside + _LEAK * (x - inside) if self.training else inside


def feed_forward(widths: Sequence[int], norm: str) -> list[nn.Module]:
    """Return the hidden layers between these widths, the first of which is that of the input."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers.append(nn.Linear(before, after))
        if norm == "batch":
            layers.append(nn.BatchNorm1d(after))
        layers.append(nn.ReLU())
    return layers


def bounded_value(width: int) -> list[nn.Module]:
    """Return the last layers of a network that answers with one value in [0, 1]."""
    out = nn.Linear(width, 1)
    nn.init.constant_(out.bias, 0.5)  # start inside of [0, 1], where the slope is
    return [out, Bounded()]
