"""`lstm-1`: the regressor with LSTM layers over the history as its first two layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.learning.networks.kinds.kind import Inputs, Network, Widths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn


def _build(spec: Widths, inputs: Inputs, levels: Sequence[float]) -> nn.Module:
    from cyclekit.learning.networks.network import Recurrent, bounded_value

    del levels
    return Recurrent(inputs.width, spec, bounded_value(spec.hidden[-1]))


LSTM_1 = Network("lstm-1", ("ahead",), (64,) * 5, _build, lstm_layers=2, least_hidden=3)
