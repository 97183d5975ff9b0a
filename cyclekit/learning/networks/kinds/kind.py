"""What a network is known by everywhere: one `Network` says all that training, files and estimates ask of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from torch import nn


class Widths(Protocol):
    """What a network is built by, of all that a `ModelSpec` says: its hidden layers and their normalisation."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""

    @property
    def norm(self) -> str:
        """`batch` or `none`."""


@dataclass(frozen=True)
class Inputs:
    """What goes into a network.

    Attributes:
        width: Number of inputs.
        presence: Column that says whether the operator is there, 0 for none.
        varies: Whether each coordinate of the operator varies.
    """

    width: int
    presence: int
    varies: tuple[bool, bool, bool]


@dataclass(frozen=True)
class Network:
    """One network.

    Attributes:
        name: As `--network` and a model's card name it.
        problems: Which problems it can be trained for.
        hidden: Widths of its hidden layers.
        build: Makes the untrained torch module of layers that `folding` knows; imports torch when it is called.
        names_levels: It answers with the probability of each level, not with a value.
        through_levels: A softmax over the levels stands before its value.
        lstm_layers: So many LSTM layers see a history; 0 = it sees one sample.
        forecasts: Its LSTM forecasts where the operator will be.
        least_hidden: It needs so many hidden layers.
        trees: It is made of trees on windows and `last_second.PAST`, and has no layers.
    """

    name: str
    problems: tuple[str, ...]
    hidden: tuple[int, ...]
    build: Callable[[Widths, Inputs, Sequence[float]], nn.Module]
    names_levels: bool = False
    through_levels: bool = False
    lstm_layers: int = 0
    forecasts: bool = False
    least_hidden: int = 1
    trees: bool = False

    @property
    def sees_history(self) -> bool:
        """Whether it sees several samples."""
        return self.trees or self.lstm_layers > 0

    @property
    def needs_levels(self) -> bool:
        """Whether there must be two levels or more."""
        return self.names_levels or self.through_levels

    def outputs(self, levels: int) -> list[int]:
        """Return the widths of its last layers for `levels` levels."""
        return [levels] if self.names_levels else [levels, 1] if self.through_levels else [1]
