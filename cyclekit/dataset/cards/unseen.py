"""An unseen operator as data: states that no log names, and the speed that each of them leaves the robot."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from cyclekit.dataset.cards.model import TrainingCard
from cyclekit.dataset.cards.quantities import Card, Count, Duration, Fraction, Point, Scaling, ascending

Shares = Annotated[tuple[Fraction, ...], Meta(min_length=1, max_length=64)]
"""Probabilities that sum to 1."""
States = Annotated[tuple[Shares, ...], Meta(min_length=1, max_length=64)]
"""Probabilities by state."""
LogLikelihood = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Logarithm of a probability, per minute of log."""


class UnseenOperatorCard(Card, frozen=True, kw_only=True):
    """What the speed scaling alone says of people: a hidden chain of H states, R regions of the robot, P levels.

    Attributes:
        step_s: Time between two steps of the chain.
        regions_m: Centres of the regions of the TCP, base frame; one: levels do not depend on where the robot is.
        start: Probability of each state at the beginning of an execution.
        follows: Probability of each state a step after another, by that other state.
        shares: Probability of each level, by state and region.
        seen_s: How long each state was met in each region, by state.
        with_place, without_place: Log-likelihood of held-out executions per minute, with levels that depend on where
            the robot is, and with levels that do not; None = there were too few executions to compare.
        executions: Executions it was learned from.
    """

    step_s: Duration
    regions_m: Annotated[tuple[Point, ...], Meta(min_length=1, max_length=64)]
    start: Shares
    follows: States
    shares: Annotated[tuple[States, ...], Meta(min_length=1, max_length=64)]
    seen_s: Annotated[tuple[tuple[Duration, ...], ...], Meta(min_length=1, max_length=64)]
    with_place: LogLikelihood | None = None
    without_place: LogLikelihood | None = None
    executions: Count = 0

    def __post_init__(self) -> None:
        """Refuse tables whose sizes do not fit each other.

        Raises:
            ValueError: They do not.
        """
        states, regions = len(self.start), len(self.regions_m)
        tables = (self.follows, self.shares, self.seen_s)
        fits = all(len(table) == states for table in tables)
        fits = fits and all(len(row) == states for row in self.follows)
        fits = fits and all(len(row) == regions for row in (*self.shares, *self.seen_s))
        levels = {len(cell) for row in self.shares for cell in row}
        if not fits or len(levels) != 1:
            msg = "tables of states, regions and levels must have the same sizes"
            raise ValueError(msg)


FORMAT: Literal["cyclekit-unseen-operator"] = "cyclekit-unseen-operator"
"""How the file of such a model says that it is one."""


class UnseenModelCard(Card, frozen=True, kw_only=True):
    """A model of an unseen operator: levels of the speed scaling, ascending, the chain, and how it came about."""

    format: Literal["cyclekit-unseen-operator"]
    levels: Annotated[tuple[Scaling, ...], Meta(min_length=2, max_length=64)]
    unseen: UnseenOperatorCard
    card: TrainingCard

    def __post_init__(self) -> None:
        """Refuse levels that are not ascending, or are not those of the chain.

        Raises:
            ValueError: They are not.
        """
        if len(ascending(self.levels)) != len(self.unseen.shares[0][0]):
            msg = "the chain has another number of levels"
            raise ValueError(msg)
