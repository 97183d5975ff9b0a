"""`mixed`: feed-forward layers, a softmax layer as wide as the number of levels, then one value."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.learning.networks.kinds.kind import Inputs, Network, Widths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn


def _build(spec: Widths, inputs: Inputs, levels: Sequence[float]) -> nn.Module:
    import torch
    from torch import nn

    from cyclekit.learning.networks.network import feed_forward

    body = feed_forward((inputs.width, *spec.hidden), spec.norm)
    out = nn.Linear(len(levels), 1)
    with torch.no_grad():  # initial value: the level of the most likely class
        out.weight.copy_(torch.tensor(levels)[None, :])
        out.bias.zero_()
    return nn.Sequential(*body, nn.Linear(spec.hidden[-1], len(levels)), nn.Softmax(dim=1), out)


MIXED = Network("mixed", ("average",), (64,) * 5, _build, through_levels=True)
