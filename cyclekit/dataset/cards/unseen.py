"""Model of an unseen operator as data: hidden states, and the distribution of speed levels in each."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from cyclekit.dataset.cards.model import TrainingCard
from cyclekit.dataset.cards.quantities import (
    LONGEST_DELAY_S,
    Card,
    Count,
    Duration,
    Fraction,
    Point,
    Scaling,
    ascending,
)

Shares = Annotated[tuple[Fraction, ...], Meta(min_length=1, max_length=64)]
"""Probabilities that sum to 1."""
States = Annotated[tuple[Shares, ...], Meta(min_length=1, max_length=64)]
"""Probabilities by state."""
LogLikelihood = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Log-likelihood per minute of log."""


class UnseenOperatorCard(Card, frozen=True, kw_only=True):
    """Hidden Markov model of people from the speed scaling alone: H states, R regions of the robot, P levels.

    Attributes:
        step_s: Time step of the chain.
        regions_m: Centres of the regions of the TCP, base frame; one: levels do not depend on the robot's position.
        start: Probability of each state at the beginning of an execution.
        follows: Transition probabilities per step, by current state.
        shares: Probability of each level, by state and region.
        seen_s: Time in each region, by state.
        with_place, without_place: Log-likelihood of held-out executions per minute, with levels that depend on the
            robot's position, and with levels that do not; None = too few executions to compare.
        executions: Number of training executions.
    """

    step_s: Annotated[float, Meta(ge=1e-3, le=LONGEST_DELAY_S)]
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
            ValueError: They do not fit.
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
"""Format name in the file of such a model."""


class UnseenModelCard(Card, frozen=True, kw_only=True):
    """A model of an unseen operator: levels of the speed scaling, ascending, the chain, and how it was trained."""

    format: Literal["cyclekit-unseen-operator"]
    levels: Annotated[tuple[Scaling, ...], Meta(min_length=2, max_length=64)]
    unseen: UnseenOperatorCard
    card: TrainingCard

    def __post_init__(self) -> None:
        """Refuse levels that are not ascending, or whose number differs from that of the chain.

        Raises:
            ValueError: They are not ascending, or their number differs.
        """
        if len(ascending(self.levels)) != len(self.unseen.shares[0][0]):
            msg = "the chain has another number of levels"
            raise ValueError(msg)
