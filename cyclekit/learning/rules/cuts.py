"""The fits that every kind of rule is put together from: one cut of one value, and a rectangle of four cuts.

Samples that are slow lie on one side of a cut, the others on the other. Where no sample contradicts that, every cut
between the last slow and the first fast sample is as good: the middle is taken, and both are the bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards.rule import MetresCard, RectangleCard
from cyclekit.learning.rules.regions import NOWHERE, turned, within_rectangle

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Vector


_ROUNDS = 8
_FEW = 3000
_ABOUT_M = 0.5
_COARSE_DEG, _FINE_DEG = 5.0, (2.0, 0.7, 0.25, 0.1)
EDGE_PART = 0.005
"""An edge is drawn first where this part of the slow samples lies beyond it."""


@dataclass(frozen=True)
class LimitRows:
    """N samples that tell of one limit: slow by it, or not.

    Attributes:
        apart_m, floor_m: As of `RuleRows`.
        slow: Whether the limit holds, shape (N,).
        weight: How often each counts, shape (N,).
    """

    apart_m: Mapping[str, Vector]
    floor_m: NDArray[np.float64]
    slow: Bools
    weight: Vector

    def where(self, keep: Bools) -> LimitRows:
        """Return some rows."""
        apart = {name: values[keep] for name, values in self.apart_m.items()}
        return LimitRows(apart, self.floor_m[keep], self.slow[keep], self.weight[keep])

    def wrong(self, found: Bools) -> float:
        """Return how many rows are not as `found` says, shape (N,)."""
        return float(self.weight[found != self.slow].sum())


class Cut(NamedTuple):
    """A cut between the last value below and the first above; infinite where there is none."""

    below: float
    above: float

    @property
    def value(self) -> float:
        """The middle, infinite where one side has no sample."""
        return (self.below + self.above) / 2

    def card(self, sign: float = 1.0) -> MetresCard | None:
        """Return it as a quantity with its bounds; None where it was never crossed. `sign` -1: of minus the value."""
        if not np.isfinite(self.value):
            return None
        low, high = sorted((sign * self.below, sign * self.above))
        return MetresCard(value=sign * self.value, low=low, high=high)


def best_cut(value: Vector, slow: Bools, weight: Vector) -> Cut:
    """Return the cut with the fewest rows on the wrong side, slow ones lying below it.

    Of several that are as good, the one in the widest gap.

    Args:
        value: Shape (N,), N may be 0; infinite allowed.
        slow: Shape (N,).
        weight: How often each row counts, shape (N,), not negative.
    """
    counted = weight > 0
    value, gain = value[counted], np.where(slow, weight, -weight)[counted]
    order = np.argsort(value, kind="stable")
    value = np.concatenate([[-np.inf], value[order], [np.inf]])
    right = np.concatenate([[0.0], np.cumsum(gain[order])])
    right[value[:-1] >= value[1:]] = -np.inf  # no cut between equal values
    if value[-2] == np.inf:  # nobody there: the last cut would take them in
        right[-1] = -np.inf
    best = np.flatnonzero(right >= right.max() - 1e-9)
    with np.errstate(invalid="ignore"):
        gap = np.where(np.isfinite(value[best + 1] - value[best]), value[best + 1] - value[best], 0.0)
    at = int(best[gap.argmax()])
    return Cut(float(value[at]), float(value[at + 1]))


def best_rectangle(rows: LimitRows, angle_rad: float = 0.0, start: RectangleCard | None = None) -> RectangleCard | None:
    """Return the rectangle, turned by `angle_rad`, that fits best in steps of one edge; None where there is none.

    Args:
        rows: What it is to explain.
        angle_rad: By which it is turned.
        start: Where to begin; None: around the slow samples, and around most of them.
    """
    if not (rows.slow & (rows.weight > 0) & np.isfinite(rows.floor_m[:, 0])).any():
        return None
    along, across = turned(rows.floor_m, angle_rad)
    boxes = _first_boxes(along, across, rows) if start is None else [_box(start)]
    found = [_improved(along, across, rows, angle_rad, box) for box in boxes]
    return min(
        (one for one in found if one is not None),
        key=lambda one: rows.wrong(within_rectangle(one, rows.floor_m)),
        default=None,
    )


def best_turned(rows: LimitRows, start: RectangleCard | None = None) -> RectangleCard | None:
    """Return the rectangle that fits best at any angle; `start`: one nearby."""

    def wrong(angle: float, of: LimitRows, begin: RectangleCard | None) -> tuple[float, RectangleCard | None]:
        one = best_rectangle(of, angle, begin)
        missed = of.slow.sum() if one is None else of.wrong(within_rectangle(one, of.floor_m))
        return float(missed), one

    if start is None:
        some = np.zeros(len(rows.slow), np.bool_)
        some[np.linspace(0, len(some) - 1, min(_FEW, len(some))).astype(np.int64)] = True
        few = rows.where(some)
        degrees = np.arange(-45.0, 45.0, _COARSE_DEG)
        angle = float(min(np.deg2rad(degrees), key=lambda at: wrong(at, few, None)[0]))
        begin = wrong(angle, rows, None)[1]
        rows = rows if begin is None else rows.where(_about(begin, rows.floor_m))
    else:
        angle, begin = start.angle_rad, start
    best = wrong(angle, rows, begin)
    for step in _FINE_DEG if start is None else _FINE_DEG[2:]:
        tried = [(angle + way * float(np.deg2rad(step))) for way in (-2, -1, 1, 2)]
        others = [(at, wrong(at, rows, best[1])) for at in tried]
        as_good = [at for at, (missed, _) in others if missed == best[0]]
        at, other = min(others, key=lambda each: each[1][0])
        if other[0] < best[0]:
            angle, best = at, other
        elif as_good:  # the middle of all angles that are as good
            angle = (angle + sum(as_good)) / (1 + len(as_good))
            best = wrong(angle, rows, best[1])
    return best[1]


def _about(rectangle: RectangleCard, floor_m: NDArray[np.float64]) -> Bools:
    """Return which points lie so near to an edge that a small turn decides whether they are inside."""
    large, small = (_grown(rectangle, by_m) for by_m in (_ABOUT_M, -_ABOUT_M))
    return within_rectangle(large, floor_m) & ~within_rectangle(small, floor_m)


def _grown(rectangle: RectangleCard, by_m: float) -> RectangleCard:
    left, right, near, far = (
        None if edge is None else MetresCard(value=edge.value + sign * by_m)
        for edge, sign in zip((*rectangle.along, *rectangle.across), (-1, 1, -1, 1), strict=True)
    )
    return RectangleCard(angle_rad=rectangle.angle_rad, along=(left, right), across=(near, far))


_Box = tuple[float, float, float, float]


def _first_boxes(along: Vector, across: Vector, rows: LimitRows) -> list[_Box]:
    mine = rows.slow & (rows.weight > 0) & np.isfinite(along)
    boxes = []
    for part in (0.0, EDGE_PART):
        (left, right), (near, far) = (np.quantile(at[mine], (part, 1.0 - part)).tolist() for at in (along, across))
        boxes.append((left, right, near, far))
    return boxes


def _box(start: RectangleCard) -> _Box:
    edges = [(edge, bound) for pair in (start.along, start.across) for edge, bound in zip(pair, NOWHERE, strict=True)]
    left, right, near, far = (bound if edge is None else edge.value for edge, bound in edges)
    return left, right, near, far


def _improved(along: Vector, across: Vector, rows: LimitRows, angle_rad: float, box: _Box) -> RectangleCard | None:
    """Return the rectangle with each edge in turn where it fits best, until none moves."""
    left, right, near, far = box
    cuts: dict[str, Cut] = {}
    for _ in range(_ROUNDS):
        was = (left, right, near, far)
        on = (across >= near) & (across <= far)
        cuts["right"] = _edge(along, on & (along >= left), rows)
        right = cuts["right"].value
        cuts["left"] = _edge(-along, on & (along <= right), rows)
        left = -cuts["left"].value
        on = (along >= left) & (along <= right)
        cuts["far"] = _edge(across, on & (across >= near), rows)
        far = cuts["far"].value
        cuts["near"] = _edge(-across, on & (across <= far), rows)
        near = -cuts["near"].value
        if (left, right, near, far) == was:
            break
    if not (left < right and near < far):
        return None
    edges = {name: cut.card(-1.0 if name in ("left", "near") else 1.0) for name, cut in cuts.items()}
    return RectangleCard(
        angle_rad=angle_rad, along=(edges["left"], edges["right"]), across=(edges["near"], edges["far"])
    )


def _edge(value: Vector, on: Bools, rows: LimitRows) -> Cut:
    return best_cut(value[on], rows.slow[on], rows.weight[on])
