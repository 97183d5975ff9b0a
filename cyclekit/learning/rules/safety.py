"""Predicts the speed scaling by a rule in place of the network of its model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from msgspec import structs

from cyclekit.learning.rules.law.law import shape_of
from cyclekit.learning.rules.samples.distances import DISTANCES, TO_LINK, to_links
from cyclekit.learning.rules.samples.links import ArmPoses
from cyclekit.learning.rules.samples.positions import Positions
from cyclekit.learning.rules.samples.quantities import grown, quantities
from cyclekit.learning.rules.samples.regions import allowed, asks_operator
from cyclekit.learning.signal_inputs import from_inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards import OperatorSignalCard, TrainingCard
    from cyclekit.dataset.cards.rule import LimitCard, RegionCard, RuleCard
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.schema import Vector


@dataclass(frozen=True)
class RuleSafety:
    """Safety function given by a rule.

    Attributes:
        rule: The rule.
        card: Training card of the model with this rule.
        side: With hysteresis: the regions by which s falls (`entering`), those by which it may rise (`leaving`), or, if
            the past is unknown, the mean of both.
        problem: `now`: it predicts the present scaling.
    """

    rule: RuleCard
    card: TrainingCard
    side: Literal["entering", "leaving", "mean"] = "mean"
    problem: str = "now"

    @property
    def levels(self) -> tuple[float, ...]:
        """Levels of the speed scaling, ascending."""
        return self.rule.levels

    @property
    def network(self) -> str:
        """Name in place of that of a network."""
        return "rule"

    @property
    def fast(self) -> bool:
        """Whether it is fast enough for every step of a rollout."""
        return True

    @property
    def lags(self) -> bool:
        """Whether it has hysteresis."""
        return any(limit.until is not None for limit in self.rule.limits)

    @property
    def slows_alone(self) -> bool:
        """Whether a limit depends on the TCP alone, with or without an operator."""
        return any(region.robot is not None and not asks_operator(region) for region in _regions(self.rule))

    def of_side(self, side: Literal["entering", "leaving"]) -> RuleSafety:
        """Return it with the regions by which s falls, or those by which it may rise."""
        return replace(self, side=side)

    def with_hysteresis(self, margin_m: float) -> RuleSafety:
        """Return it with regions to leave that are larger by `margin_m` than those to enter, m; 0 = no hysteresis."""
        limits = tuple(_widened(limit, margin_m) for limit in self.rule.limits)
        return replace(self, rule=structs.replace(self.rule, limits=limits, hysteresis=margin_m > 0.0))

    def with_limits(self, limits: tuple[LimitCard, ...]) -> RuleSafety:
        """Return it with other limits, slowest first."""
        return replace(self, rule=structs.replace(self.rule, limits=limits))

    def predict(self, X: NDArray[np.floating[Any]]) -> Vector:
        """Return the scaling for rows x_r, x_h, shape (N, 6), m; shape (N,).

        If signals detect people, columns 3 to 5 hold the signals in place of x_h (`signal_inputs`).
        """
        if asks_signals(self.rule):
            return self.predict_signals(X[:, :3], from_inputs(X[:, 3:6], len(self.card.operator_signals)))
        robot_m, human_m = X[:, :3].astype(np.float64), X[:, 3:6].astype(np.float64)
        apart = {name: self._apart(name, robot_m, human_m) for name in distances_of(self.rule)}
        if self.rule.law is not None:
            return shape_of(self.rule.law).scaling(apart[self.rule.law.distance])
        rows = Positions(apart, human_m[:, :2], robot_m[:, :2])
        sides = (False, True) if self.side == "mean" and self.lags else (self.side == "leaving",)
        found = [allowed(self.rule.limits, self.rule.levels, rows, until=until) for until in sides]
        return np.asarray(np.mean(found, axis=0))

    def predict_signals(self, robot_m: NDArray[np.floating[Any]], signals: NDArray[np.int64]) -> Vector:
        """Return the commanded scaling of a rule on signals, shape (N,), without the response.

        Args:
            robot_m: The TCP, shape (N, 3), m.
            signals: Bits of the active signals, shape (N,), as in column `human_signals` of the model's dataset.
        """
        robot, nobody = np.asarray(robot_m, np.float64), np.full((len(signals), 2), np.nan)
        rows = Positions({}, nobody, robot[:, :2], values_of_bits(self.card.operator_signals, signals))
        return allowed(self.rule.limits, self.rule.levels, rows, until=False)

    def _apart(self, name: str, robot_m: NDArray[np.float64], human_m: NDArray[np.float64]) -> Vector:
        if name == TO_LINK:
            return to_links(self._arm.points(robot_m), human_m)
        return DISTANCES[name](robot_m, human_m)

    @cached_property
    def _arm(self) -> ArmPoses:
        return ArmPoses(self.rule.poses)


def predictor_of(model: TrainedModel) -> TrainedModel | RuleSafety:
    """Return the predictor of a model: its rule if there is one that can be evaluated, else its network.

    A rule on signals needs those of the model's dataset (`predict_signals`); one on the nearest link needs the arm's
    poses.
    """
    rule = model.card.rule
    if rule is None or (asks_signals(rule) and not model.card.operator_signals):
        return model
    if TO_LINK in distances_of(rule) and not rule.poses:
        return model
    return RuleSafety(rule, model.card)


def asks_signals(rule: RuleCard) -> bool:
    """Return whether a rule depends on signals in place of the operator's position."""
    return any(region.signals for region in _regions(rule))


def values_of_bits(
    named: Sequence[OperatorSignalCard], signals: NDArray[np.int64]
) -> dict[tuple[str, float], NDArray[np.str_]]:
    """Return signal values, as in `Positions`, from bit fields (N,); empty text while a signal is off."""
    return {(one.name, 0.0): np.where((signals >> k) & 1, one.occupied, "") for k, one in enumerate(named)}


def distances_of(rule: RuleCard) -> set[str]:
    """Return the names of the distances that a rule uses."""
    law = set() if rule.law is None else {rule.law.distance}
    return law | {near.distance for region in _regions(rule) for near in region.nearer}


def _regions(rule: RuleCard) -> list[RegionCard]:
    return [region for limit in rule.limits for region in (limit.within, limit.until) if region is not None]


def _widened(limit: LimitCard, margin_m: float) -> LimitCard:
    if margin_m <= 0.0 or not quantities((limit,)):
        return structs.replace(limit, until=None)
    (outer,) = grown((structs.replace(limit, until=None),), margin_m)
    return structs.replace(limit, until=structs.replace(outer.within, robot=limit.within.robot))
