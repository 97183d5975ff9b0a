"""What a training gives, whatever was trained."""

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
    """What fitting gives.

    Attributes:
        spec: What was trained, with what was left to the number of rows.
        weights: The best epoch's network as matrices on raw inputs, or the trees.
        history: One entry per epoch, or per number of trees.
        mean: Mean of every input, shape (F,), m; empty for trees.
        scale: 1/deviation of every input, shape (F,), 1/m; 0 for an input that does not vary; empty for trees.
        temperature: By what the logits of a classifier were divided so that its probabilities hold on the validation
            part (Guo et al. 2017); 1 for the others.
    """

    spec: ModelSpec
    weights: Weights | Trees
    history: tuple[EpochCard, ...]
    mean: Floats
    scale: Floats
    temperature: float = 1.0
