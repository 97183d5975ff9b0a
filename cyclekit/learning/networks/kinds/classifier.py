"""`classifier`: feed-forward layers, then one logit per level."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.learning.networks.kinds.kind import Inputs, Network, Widths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn


def _build(spec: Widths, inputs: Inputs, levels: Sequence[float]) -> nn.Module:
    from torch import nn

    from cyclekit.learning.networks.network import feed_forward

    return nn.Sequential(
        *feed_forward((inputs.width, *spec.hidden), spec.norm), nn.Linear(spec.hidden[-1], len(levels))
    )


CLASSIFIER = Network("classifier", ("now", "ahead"), (64,) * 4, _build, is_classifier=True)
