"""`regressor`: feed-forward layers, then one value in [0, 1]."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.learning.networks.kinds.kind import Inputs, Network, Widths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn


def _build(spec: Widths, inputs: Inputs, levels: Sequence[float]) -> nn.Module:
    from torch import nn

    from cyclekit.learning.networks.network import bounded_value, feed_forward

    del levels
    return nn.Sequential(*feed_forward((inputs.width, *spec.hidden), spec.norm), *bounded_value(spec.hidden[-1]))


REGRESSOR = Network("regressor", ("now", "ahead", "average"), (64,) * 5, _build)
