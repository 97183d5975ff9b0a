"""The result of training a network or trees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.dataset.cards import EpochCard
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.networks.trees import Trees
    from cyclekit.learning.networks.weights import Weights
    from cyclekit.schema import Floats


@dataclass(frozen=True)
class Fitted:
    """The result of training.

    Attributes:
        spec: The training run, with the settings chosen by the number of rows.
        weights: Weights of the best epoch as matrices on raw inputs, or the trees.
        history: One entry per epoch, or per number of trees.
        mean: Mean of every input, shape (F,), m; empty for trees.
        scale: 1/standard deviation of every input, shape (F,), 1/m; 0 for a constant input; empty for trees.
        temperature: Divisor of a classifier's logits that calibrates its probabilities on the validation part (Guo et
            al. 2017); 1 for the others.
    """

    spec: ModelSpec
    weights: Weights | Trees
    history: tuple[EpochCard, ...]
    mean: Floats
    scale: Floats
    temperature: float = 1.0
