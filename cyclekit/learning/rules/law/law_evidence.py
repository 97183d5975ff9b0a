"""Decides on held-out executions whether a scaling is continuous (the SSM law) or a staircase seen through ramps.

The law is accepted if the scaling outside of ramps takes many values, and if the law has a smaller error on held-out
executions than a staircase of many steps on all distances and positions (with noise, no larger error), and no larger
error than boosted trees on the same inputs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from cyclekit.dataset.cards.rule import RuleCard
from cyclekit.learning.rules.ladder import RuleSearch
from cyclekit.learning.rules.law.law import SAME, FittedLaw, fit_law, law_card

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.learning.rules.law.law_rows import LawRows
    from cyclekit.schema import Bools, Floats, Vector

LAW = "speed and separation monitoring"
"""Name of the rule; the name of the distance follows."""
STEPS = 16
"""Number of steps of the staircase to compare with."""
NEARER = 0.9
"""Maximum error of the law, as a multiple of that of the staircase."""
FARTHER = 1.1
"""Maximum error of the law, as a multiple of that of boosted trees; an error below EXACT always passes."""
EXACT = 0.01
NOISY, AS_NEAR = 0.02, 1.05
"""Error of boosted trees above which noise hides the steps of a staircase (late or noisy positions: a step of one
sixteenth alone is an error of 0.018). Then the law may have AS_NEAR times the error of the staircase: noisy positions
do not smear the scaling's own values, which have shown already that there are no levels."""
MAX_ROWS = 10_000
"""Maximum number of rows from which the compared models learn."""
STAIRCASE, TREES = f"staircase of {STEPS} steps", "boosted trees"


class ScalingNamer(Protocol):
    """Interface of a network to compare a law with."""

    def predict(self, X: NDArray[np.float32], /) -> Vector:
        """Return the scaling, shape (N,), for rows x_r, x_h, shape (N, 6), m."""


class _Rivals(NamedTuple):
    """Scalings, shape (M,), of the held-out rows at rest between the bounds: logged, and predicted by each model."""

    logged: Vector
    named: dict[str, Vector]

    def error(self, name: str) -> float:
        """Return the root mean squared error of a model."""
        return float(np.sqrt(((self.named[name] - self.logged) ** 2).mean()))

    def explained(self, name: str) -> float:
        """Return the share of rows that a model predicts within SAME."""
        return float((np.abs(self.named[name] - self.logged) <= SAME).mean())


def find_law(
    rows: LawRows,
    *,
    held_out: NDArray[np.int64],
    network: ScalingNamer | None = None,
    keep_held_out: bool = False,
    seed: int = 0,
) -> RuleSearch | None:
    """Return the law if it explains a scaling without levels, else None.

    Args:
        rows: Samples of at least two executions, with a scaling without levels.
        held_out: Numbers of the executions for the comparison.
        network: Network that has not seen these, to compare with.
        keep_held_out: Do not fit the law again with the held-out executions.
        seed: Seed of random draws.
    """
    learn, judge = rows.of(held_out, others=True), rows.of(held_out)
    fitted = fit_law(learn)
    if fitted is None:
        return None
    rest, test = (_between(fitted, part) for part in (learn, judge))
    if not rest.any() or not test.any():
        return None
    inputs = [_inputs(part, fitted.latency_s) for part in (learn, judge)]
    named = {LAW: fitted.rest(judge)[0][test], **_rivals(inputs[0][rest], learn.scaling[rest], inputs[1][test])}
    if network is not None:
        named["network"] = np.asarray(network.predict(_places(judge, fitted.latency_s)[test].astype(np.float32)))
    found = _Rivals(judge.scaling[test], named)
    if not _holds(found):
        return None
    whole = (None if keep_held_out else fit_law(rows)) or fitted
    law = law_card(whole, learn if keep_held_out else rows, seed=seed)
    others = {name: found.explained(name) for name in (STAIRCASE, TREES)}
    part = found.explained("network") if network is not None else None
    seen = (len(rows), len(np.unique(rows.execution)))
    name = f"{LAW}, {law.distance}"
    card = RuleCard(
        family=name, levels=(law.lowest, 1.0), law=law, latency_s=law.latency_s, explained=found.explained(LAW),
        network=part, others=others, rows=seen[0], executions=seen[1],
    )  # fmt: skip
    return RuleSearch(card, {name: card.explained, **others}, part, *seen)


def _between(fitted: FittedLaw, rows: LawRows) -> Bools:
    """Return the rows at rest whose scaling, logged or by the law, lies between the bounds, shape (N,)."""
    allowed, rest = fitted.rest(rows)
    low, high = fitted.shape.lowest + SAME, 1.0 - SAME
    inside = [(low < values) & (values < high) for values in (allowed, rows.scaling)]
    return np.asarray(rest & (inside[0] | inside[1]))


def _holds(found: _Rivals) -> bool:
    law, trees = found.error(LAW), found.error(TREES)
    nearer = AS_NEAR if trees > NOISY else NEARER
    return law <= nearer * found.error(STAIRCASE) and law <= max(EXACT, FARTHER * trees)


def _rivals(X: Floats, scaling: Vector, judge: Floats) -> dict[str, Vector]:
    from sklearn.ensemble import HistGradientBoostingRegressor  # slow import
    from sklearn.tree import DecisionTreeRegressor

    some = slice(None, None, max(1, len(X) // MAX_ROWS))
    X, scaling = X[some], scaling[some]
    tree = DecisionTreeRegressor(max_leaf_nodes=STEPS, random_state=0).fit(X, scaling)
    trees = HistGradientBoostingRegressor(random_state=0).fit(X, scaling)
    return {STAIRCASE: tree.predict(judge), TREES: trees.predict(judge)}


def _places(rows: LawRows, by_s: float) -> Floats:
    return np.column_stack([rows.earlier(column, by_s) for column in rows.at_m.T])


def _inputs(rows: LawRows, by_s: float) -> Floats:
    """Return the inputs of the compared models: all distances and positions at the reaction time, shape (N, F)."""
    apart = [rows.earlier(values, by_s) for values in rows.apart_m.values()]
    return np.column_stack([*apart, _places(rows, by_s)])
