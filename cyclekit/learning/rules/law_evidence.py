"""Whether a scaling is truly continuous, by the law, or a staircase seen through ramps: held-out executions decide.

The law is taken where the scaling, ramps left out, lies on many values, and where the law is nearer to it on held-out
executions than a staircase of many steps on any of the distances and places, and no farther from it than what boosted
trees learn of the same inputs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from cyclekit.dataset.cards.rule import RuleCard
from cyclekit.learning.rules.ladder import RuleSearch
from cyclekit.learning.rules.law import SAME, FittedLaw, fit_law, law_card

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.learning.rules.law_rows import LawRows
    from cyclekit.schema import Bools, Floats, Vector

LAW = "speed and separation monitoring"
"""Its name; the distance follows."""
STEPS = 16
"""Of the staircase that is the law's rival."""
NEARER = 0.9
"""So many times the error of the staircase is the most that the law may have."""
FARTHER = 1.1
"""So many times the error of boosted trees is the most that the law may have, if it is not below EXACT."""
EXACT = 0.01
MOST = 10_000
"""Rivals learn from so many rows at most."""
STAIRCASE, TREES = f"staircase of {STEPS} steps", "boosted trees"


class ScalingNamer(Protocol):
    """What a law is compared with: a network."""

    def predict(self, X: NDArray[np.float32], /) -> Vector:
        """Return the scaling (N,) for rows x_r, x_h (N, 6), m."""


class _Rivals(NamedTuple):
    """Scalings (M,) of the held-out rows at rest between the bounds: logged, and by each that names one."""

    logged: Vector
    named: dict[str, Vector]

    def error(self, name: str) -> float:
        """Return the root of its mean squared error."""
        return float(np.sqrt(((self.named[name] - self.logged) ** 2).mean()))

    def explained(self, name: str) -> float:
        """Return the part that it names within SAME."""
        return float((np.abs(self.named[name] - self.logged) <= SAME).mean())


def find_law(
    rows: LawRows,
    *,
    held_out: NDArray[np.int64],
    network: ScalingNamer | None = None,
    judged_apart: bool = False,
    seed: int = 0,
) -> RuleSearch | None:
    """Return the law if it explains a scaling without levels, else None.

    Args:
        rows: Of at least two executions, with a scaling that has no levels.
        held_out: Numbers of the executions to judge by.
        network: Which has not seen these, to compare with.
        judged_apart: The law is not fitted again to the executions by which it was judged.
        seed: Of what is drawn.
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
    whole = (None if judged_apart else fit_law(rows)) or fitted
    law = law_card(whole, learn if judged_apart else rows, seed=seed)
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
    """Return the rows at rest whose scaling lies between the bounds, or should by the law, shape (N,)."""
    allowed, rest = fitted.rest(rows)
    low, high = fitted.shape.lowest + SAME, 1.0 - SAME
    inside = [(low < values) & (values < high) for values in (allowed, rows.scaling)]
    return np.asarray(rest & (inside[0] | inside[1]))


def _holds(found: _Rivals) -> bool:
    law = found.error(LAW)
    return law <= NEARER * found.error(STAIRCASE) and law <= max(EXACT, FARTHER * found.error(TREES))


def _rivals(X: Floats, scaling: Vector, judge: Floats) -> dict[str, Vector]:
    from sklearn.ensemble import HistGradientBoostingRegressor  # here, so that nobody else waits for the import
    from sklearn.tree import DecisionTreeRegressor

    some = slice(None, None, max(1, len(X) // MOST))
    X, scaling = X[some], scaling[some]
    tree = DecisionTreeRegressor(max_leaf_nodes=STEPS, random_state=0).fit(X, scaling)
    trees = HistGradientBoostingRegressor(random_state=0).fit(X, scaling)
    return {STAIRCASE: tree.predict(judge), TREES: trees.predict(judge)}


def _places(rows: LawRows, by_s: float) -> Floats:
    return np.column_stack([rows.earlier(column, by_s) for column in rows.at_m.T])


def _inputs(rows: LawRows, by_s: float) -> Floats:
    """Return what rivals see: all distances and places at the reaction time, shape (N, F)."""
    apart = [rows.earlier(values, by_s) for values in rows.apart_m.values()]
    return np.column_stack([*apart, _places(rows, by_s)])
