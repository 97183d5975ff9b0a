"""Basic fits of all kinds of rules: one cut of a value, and a box of two cuts per value.

A cut separates slow samples from the others. If no sample contradicts it, every cut between the last slow and the first
fast sample fits equally well: the middle is used, with both as bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.rule import MetresCard, RectangleCard, RegionCard, SignalCard
from cyclekit.learning.rules.samples.positions import Positions
from cyclekit.learning.rules.samples.regions import NOWHERE, inside, turned

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Ints, Vector

    Edges = tuple[MetresCard | None, MetresCard | None]

Condition = TypeVar("Condition", RegionCard, SignalCard)

_ROUNDS, _ABOUT_ROWS = 8, 1500
_COARSE_DEG, _FINE_DEG = 5.0, (2.0, 0.7, 0.25, 0.1)
CELLS = 12
"""Number of cells per axis of the coarse grid."""
EDGE_PART = 0.005
"""Share of the slow samples left outside each edge of a first box."""


@dataclass(frozen=True)
class LimitRows:
    """N samples by which one limit is fitted.

    Attributes:
        positions: Positions of robot and operator.
        slow: Whether the limit holds, shape (N,).
        weight: Weight of each sample, shape (N,).
    """

    positions: Positions
    slow: Bools
    weight: Vector

    def where(self, keep: Bools | Ints) -> LimitRows:
        """Return a subset of the rows."""
        return LimitRows(self.positions.where(keep), self.slow[keep], self.weight[keep])

    def some(self) -> LimitRows:
        """Return a regular subset of the rows, enough for a coarse search."""
        return self.where(np.arange(0, len(self.slow), max(1, len(self.slow) // _ABOUT_ROWS)))

    def wrong(self, region: RegionCard) -> float:
        """Return the total weight of the rows that a region explains wrongly."""
        return float(self.weight[inside(region, self.positions) != self.slow].sum())


class Cut(NamedTuple):
    """A cut between the last value below and the first above; infinite if there is none."""

    below: float
    above: float

    @property
    def value(self) -> float:
        """The middle; infinite if one side has no sample."""
        return (self.below + self.above) / 2

    def card(self, sign: float = 1.0) -> MetresCard | None:
        """Return the cut with its bounds; None if it was never crossed. `sign` -1: of the negated value."""
        if not np.isfinite(self.value):
            return None
        low, high = sorted((sign * self.below, sign * self.above))
        return MetresCard(value=sign * self.value, low=low, high=high)


def best_cut(value: Vector, slow: Bools, weight: Vector) -> Cut:
    """Return the cut with the fewest rows on the wrong side; slow rows are below it.

    Of equally good cuts, the one in the widest gap is returned.

    Args:
        value: Shape (N,), N may be 0; infinite allowed.
        slow: Shape (N,).
        weight: Weight of each row, shape (N,), not negative.
    """
    axis = _Axis.of(value, slow, weight)
    return _cut(axis.value, axis.gain)


class _Axis(NamedTuple):
    """Values in ascending order, and the gain of each if it is below a cut."""

    order: Ints
    value: Vector
    gain: Vector

    @classmethod
    def of(cls, value: Vector, slow: Bools, weight: Vector) -> _Axis:
        counted = np.flatnonzero(weight > 0)
        order = counted[np.argsort(value[counted], kind="stable")]
        return cls(order, value[order], np.where(slow[order], weight[order], -weight[order]))


def _cut(value: Vector, gain: Vector) -> Cut:
    """Return the best cut of ascending values."""
    right = np.zeros(len(value) + 1)
    np.cumsum(gain, out=right[1:])
    right[1:-1][value[1:] <= value[:-1]] = -np.inf  # no cut between equal values
    if len(value) and value[-1] == np.inf:  # no operator: the last cut would include them
        right[-1] = -np.inf
    best = np.flatnonzero(right >= right.max() - 1e-9)
    value = np.concatenate([[-np.inf], value, [np.inf]])
    with np.errstate(invalid="ignore"):
        gap = value[best + 1] - value[best]
    at = int(best[np.where(np.isfinite(gap), gap, 0.0).argmax()])
    return Cut(float(value[at]), float(value[at + 1]))


def best_box(
    values: Sequence[Vector], slow: Bools, weight: Vector, start: Sequence[Edges] | None = None
) -> tuple[Edges, ...] | None:
    """Return the interval of each value that best contains the slow rows and only these; None if there is no such box.

    Args:
        values: Shape (N,) each; rows with NaN are outside of any box.
        slow: Shape (N,).
        weight: Weight of each row, shape (N,), not negative.
        start: Box to start from; None: around all slow rows, around most of them, and in a plane the best of a coarse
            grid.
    """
    known = (weight > 0) & np.isfinite(values[0])
    if not (slow & known).any():
        return None
    values, slow, weight = [value[known] for value in values], slow[known], weight[known]
    axes = [_Axis.of(value, slow, weight) for value in values]
    gain = np.where(slow, weight, -weight)
    if start is None:
        boxes = _first_boxes(axes) + ([_coarse_box(values, gain, slow)] if len(values) == 2 else [])
    else:
        boxes = [np.array([_bounds(edges) for edges in start])]
    found = [_improved(values, axes, gain, box) for box in boxes]
    return max(found, key=lambda one: one[0])[1]


def has_edges(rectangle: RectangleCard) -> bool:
    """Return whether any edge of a rectangle is known."""
    return any(edge is not None for edge in (*rectangle.along, *rectangle.across))


def without_idle_edges(condition: Condition, wrong: Callable[[Condition], float], least: float) -> Condition:
    """Return a condition without the edges of the TCP's rectangle that explain almost nothing.

    Args:
        condition: Region or signal; its rectangle is removed with the last edge.
        wrong: Returns the total weight of the rows that a condition explains wrongly.
        least: Minimum weight that an edge must explain.
    """
    for side, number in ((side, number) for side in ("along", "across") for number in (0, 1)):
        if (robot := condition.robot) is None:
            break
        edges = list(getattr(robot, side))
        edges[number] = None
        wider = structs.replace(robot, **{side: tuple(edges)})
        tried = structs.replace(condition, robot=wider if has_edges(wider) else None)
        if wrong(tried) < wrong(condition) + least:
            condition = tried
    return condition


def best_rectangle(angle_rad: float, rows: LimitRows, start: RectangleCard | None = None) -> RectangleCard | None:
    """Return the rectangle turned by `angle_rad` that fits best, optimised edge by edge; None if there is none.

    Args:
        angle_rad: Angle of the rectangle.
        rows: Rows to explain.
        start: Rectangle to start from.
    """
    begin = None if start is None else (start.along, start.across)
    found = best_box(turned(rows.positions.floor_m, angle_rad), rows.slow, rows.weight, begin)
    return None if found is None else RectangleCard(angle_rad=angle_rad, along=found[0], across=found[1])


def best_turned(rows: LimitRows, start: RectangleCard | None = None) -> RectangleCard | None:
    """Return the rectangle at any angle that fits best, starting from `start` if given; None if there is none."""

    def tried(angle: float, begin: RectangleCard | None, of: LimitRows = rows) -> tuple[float, RectangleCard | None]:
        one = best_rectangle(angle, of, begin)
        return of.wrong(RegionCard() if one is None else RegionCard(rectangles=(one,))), one

    if start is None:
        degrees = np.deg2rad(np.arange(-45.0, 45.0, _COARSE_DEG)).tolist()
        about = rows.some()
        angle = min(degrees, key=lambda at: tried(at, None, about)[0])
    else:
        angle = start.angle_rad
    best = tried(angle, start)
    for step in _FINE_DEG if start is None else _FINE_DEG[2:]:
        others = [(at, tried(at, best[1])) for at in (angle + way * float(np.deg2rad(step)) for way in (-2, -1, 1, 2))]
        as_good = [at for at, (missed, _) in others if missed == best[0]]
        at, other = min(others, key=lambda each: each[1][0])
        if other[0] < best[0]:
            angle, best = at, other
        elif as_good:  # mean of all equally good angles
            angle = (angle + sum(as_good)) / (1 + len(as_good))
            best = tried(angle, best[1])
    return best[1]


def _first_boxes(axes: Sequence[_Axis]) -> list[NDArray[np.float64]]:
    mine = [axis.value[axis.gain > 0] for axis in axes]
    return [np.array([np.quantile(value, (part, 1.0 - part)) for value in mine]) for part in (0.0, EDGE_PART)]


def _coarse_box(values: Sequence[Vector], gain: Vector, slow: Bools) -> NDArray[np.float64]:
    """Return the box of cells of a coarse grid with the largest gain; grid lines are quantiles of the slow rows.

    A box that shrinks from all slow rows misses this one if other slow rows, of another cause, cover the whole floor.
    """
    edges = [np.unique(np.quantile(value[slow], np.linspace(0.0, 1.0, CELLS + 1))) for value in values]
    if min(map(len, edges)) < 2:
        return np.array([[edge[0], edge[-1]] for edge in edges])
    cells = np.histogram2d(values[0], values[1], bins=edges, weights=gain)[0]
    until = np.pad(cells.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    first, last = np.triu_indices(len(until), 1)
    strips = until[last] - until[first]  # sums over the first value, between each pair of edges
    rise = strips - np.minimum.accumulate(strips, axis=1)
    strip, end = np.unravel_index(int(rise.argmax()), rise.shape)
    begin = int(strips[strip, : end + 1].argmin())
    return np.array([[edges[0][first[strip]], edges[0][last[strip]]], [edges[1][begin], edges[1][end]]])


def _bounds(edges: Edges) -> list[float]:
    return [bound if edge is None else edge.value for edge, bound in zip(edges, NOWHERE, strict=True)]


def _improved(
    values: Sequence[Vector], axes: Sequence[_Axis], gain: Vector, box: NDArray[np.float64]
) -> tuple[float, tuple[Edges, ...] | None]:
    """Return the gain and the box after optimising each edge in turn until none moves."""
    cuts: dict[int, tuple[Cut, Cut]] = {}
    for _ in range(_ROUNDS):
        was = box.copy()
        for number, axis in enumerate(axes):
            others = np.ones(len(gain), np.bool_)
            for other, (low, high) in enumerate(box):
                others &= (other == number) | ((values[other] >= low) & (values[other] <= high))
            on = others[axis.order]
            value, each = axis.value[on], axis.gain[on]
            first = int(np.searchsorted(value, box[number, 0], side="left"))
            upper = _cut(value[first:], each[first:])
            last = int(np.searchsorted(value, upper.value, side="right"))
            lower = _cut(-value[:last][::-1], each[:last][::-1])
            cuts[number] = (lower, upper)
            box[number] = (-lower.value, upper.value)
        if (box == was).all():
            break
    if not (box[:, 0] < box[:, 1]).all():
        return 0.0, None
    within = np.ones(len(gain), np.bool_)
    for value, (low, high) in zip(values, box, strict=True):
        within &= (value > low) & (value < high)
    edges = tuple((lower.card(-1.0), upper.card()) for lower, upper in cuts.values())
    return float(gain[within].sum()), edges
