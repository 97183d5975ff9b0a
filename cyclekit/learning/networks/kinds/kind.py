"""Description of a network: all that training, files and estimates need to know of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from torch import nn


class Widths(Protocol):
    """The part of a `ModelSpec` from which a network is built: hidden layers and their normalisation."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""

    @property
    def norm(self) -> str:
        """`batch` or `none`."""


@dataclass(frozen=True)
class Inputs:
    """Inputs of a network.

    Attributes:
        width: Number of inputs.
        presence: Column that indicates the operator's presence; 0 if there is none.
        varies: Whether each coordinate of the operator varies.
    """

    width: int
    presence: int
    varies: tuple[bool, bool, bool]


@dataclass(frozen=True)
class Network:
    """One kind of network.

    Attributes:
        name: Name for `--network` and in a model's card.
        problems: Problems that it can be trained for.
        hidden: Widths of its hidden layers.
        build: Returns the untrained torch module, of layers that `folding` supports; imports torch when called.
        is_classifier: Whether it predicts the probability of each level instead of a value.
        through_levels: Whether a softmax over the levels precedes its value.
        lstm_layers: Number of LSTM layers over a history; 0 = it sees one sample.
        forecasts: Whether its LSTM forecasts the operator's position.
        least_hidden: Minimum number of hidden layers.
        trees: Whether it consists of trees on windows and `last_second.PAST`, without layers.
    """

    name: str
    problems: tuple[str, ...]
    hidden: tuple[int, ...]
    build: Callable[[Widths, Inputs, Sequence[float]], nn.Module]
    is_classifier: bool = False
    through_levels: bool = False
    lstm_layers: int = 0
    forecasts: bool = False
    least_hidden: int = 1
    trees: bool = False

    @property
    def sees_history(self) -> bool:
        """Whether it sees more than one sample."""
        return self.trees or self.lstm_layers > 0

    @property
    def needs_levels(self) -> bool:
        """Whether it needs at least two levels."""
        return self.is_classifier or self.through_levels

    def outputs(self, levels: int) -> list[int]:
        """Return the widths of its last layers for a number of levels."""
        return [levels] if self.is_classifier else [levels, 1] if self.through_levels else [1]
