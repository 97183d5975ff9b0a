"""`lstm-2`: an LSTM layer forecasts the operator's position, which replaces the present one in the regressor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.learning.networks.kinds.kind import Inputs, Network, Widths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn


def _build(spec: Widths, inputs: Inputs, levels: Sequence[float]) -> nn.Module:
    import torch

    from cyclekit.learning.networks.network import Forecasting, bounded_value

    del levels
    varies = torch.tensor(inputs.varies).float()
    return Forecasting(inputs.width, spec, bounded_value(spec.hidden[-1]), inputs.presence, varies)


LSTM_2 = Network("lstm-2", ("ahead",), (64,) * 5, _build, lstm_layers=1, forecasts=True)
