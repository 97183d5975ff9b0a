"""Fits a convex polygon on the floor to slow samples, side by side.

A side is a cut along its normal. Sides are added greedily by the number of fast samples that they exclude; then each is
shifted and rotated in turn for the best fit given the others. `polygon_sides` keeps those that are needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards.rule import PolygonCard, SideCard
from cyclekit.learning.rules.cuts import Cut, best_cut
from cyclekit.learning.rules.polygons.polygon_fit import (
    MAX_SIDES,
    NEAR_M,
    PolygonSamples,
    PolygonState,
    depths_of,
    normals,
)
from cyclekit.learning.rules.polygons.polygon_sides import needed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.rules.cuts import LimitRows
    from cyclekit.schema import Bools, Vector

_TRIED = 8
"""Maximum number of sides that are added before the least useful ones are removed."""
_GAIN = 3e-4
"""Minimum gain of a side, as a share of the samples."""
_ANGLES = np.deg2rad(np.arange(0.0, 360.0, 6.0))
_COARSE_DEG, _FINE_DEG = (4.0, 2.0), (1.0, 0.4, 0.15)
_ROUNDS = 4
_LEAST = 0.9
"""Share of the samples that a polygon must explain for its sides to be looked at closely: no rule that explains less is
chosen, and most of the search's time would go into these. The sides of a chosen rule are always looked at."""
_SPREAD_M = 0.01
"""Standard deviation of positions in the choice of sides, m; the chosen rule is fitted again with that of the logs."""


class _Side(NamedTuple):
    angle_rad: float
    cut: Cut


class _Floor(NamedTuple):
    """Samples on the floor, (N, 2), m, whether each is slow, and its weight."""

    floor_m: NDArray[np.float64]
    slow: Bools
    weight: Vector

    def along(self, angle_rad: float) -> Vector:
        return np.asarray(self.floor_m @ np.array([np.cos(angle_rad), np.sin(angle_rad)]))

    def within(self, sides: Sequence[_Side]) -> Bools:
        found = np.ones(len(self.slow), np.bool_)
        for side in sides:
            found &= self.along(side.angle_rad) < side.cut.value
        return found

    def explained(self, sides: Sequence[_Side] | None) -> float:
        """Return the share of the weight of rows that a polygon explains; None: no polygon."""
        inside = False if sides is None else self.within(sides)
        return float(self.weight[inside == self.slow].sum() / self.weight.sum())

    def gain(self, sides: Sequence[_Side]) -> float:
        """Return the weight of slow rows inside minus that of fast rows inside."""
        inside = self.within(sides)
        return float(self.weight[inside & self.slow].sum() - self.weight[inside & ~self.slow].sum())

    def cut(self, angle_rad: float, on: Bools) -> tuple[float, _Side]:
        """Return the gain of rows `on` by the best side at an angle, and that side."""
        value = self.along(angle_rad)[on]
        cut = best_cut(value, self.slow[on], self.weight[on])
        below = value < cut.value
        slow, weight = self.slow[on], self.weight[on]
        return float(weight[below & slow].sum() - weight[below & ~slow].sum()), _Side(angle_rad, cut)


def best_polygon(rows: LimitRows, start: PolygonCard | None = None) -> PolygonCard | None:
    """Return the convex polygon of up to six sides that fits best; None if there is none.

    Args:
        rows: Rows to explain.
        start: Polygon to start from; its number of sides is kept.
    """
    rows = rows.where(np.isfinite(rows.positions.floor_m[:, 0]) & (rows.weight > 0))
    floor, about = (_Floor(of.positions.floor_m, of.slow, of.weight) for of in (rows, rows.some()))
    if not about.slow.any():
        return None
    if start is None:
        sides = _fewer(floor, _drawn(about))
        sides = _needed(floor, sides) if floor.explained(sides) > max(_LEAST, floor.explained(None)) else sides
    else:
        sides = [_Side(side.angle_rad, Cut(side.metres.value, side.metres.value)) for side in start.sides]
    sides = _moved(floor, sides, _FINE_DEG if start is None else _FINE_DEG[1:])
    return _card(sides)


def _drawn(floor: _Floor) -> list[_Side]:
    """Return sides added greedily: each excludes the most fast samples and the fewest slow ones.

    Slow samples together weigh as much as all samples; otherwise the best first side would exclude everything.
    """
    sides: list[_Side] = []
    slow, every = (float(floor.weight[part].sum()) for part in (floor.slow, slice(None)))
    floor = floor._replace(weight=floor.weight * np.where(floor.slow, max(1.0, every / slow), 1.0))
    gain = floor.gain(sides)
    for _ in range(_TRIED):
        on = floor.within(sides)
        new = max((floor.cut(angle, on) for angle in _ANGLES.tolist()), key=lambda one: one[0])[1]
        more = _moved(floor, [*sides, new], _COARSE_DEG)
        gained = floor.gain(more)
        if gained <= gain + _GAIN * float(floor.weight.sum()):
            break
        sides, gain = more, gained
    return sides


def _fewer(floor: _Floor, sides: list[_Side]) -> list[_Side]:
    """Return at most six sides, without those whose gain is negligible."""
    while len(sides) > 1:
        others = [[*sides[:at], *sides[at + 1 :]] for at in range(len(sides))]
        best = max(others, key=floor.gain)
        if len(sides) <= MAX_SIDES and floor.gain(best) < floor.gain(sides) - _GAIN * float(floor.weight.sum()):
            break
        sides = _moved(floor, best, _COARSE_DEG)
    return sides


def _needed(floor: _Floor, sides: list[_Side]) -> list[_Side]:
    """Return the sides that samples near the polygon need when all others are fitted again."""
    if not sides:
        return sides
    angle, out = np.array([(side.angle_rad, side.cut.value) for side in sides]).T
    state = PolygonState(angle, normals(angle) * out[:, None])
    state = state.about(floor.floor_m[floor.slow].mean(axis=0))
    count = len(floor.slow)
    samples = PolygonSamples(
        floor.floor_m, np.where(floor.slow, 1.0, -1.0), np.full(count, _SPREAD_M), np.zeros((count, 2))
    )
    near = np.abs(depths_of(state, samples).min(axis=0)) < NEAR_M
    state = needed(state, PolygonSamples(*(each[near] for each in samples)), np.random.default_rng(0))
    ends = zip(state.angle_rad.tolist(), state.out_m.tolist(), strict=True)
    return [_Side(each, Cut(value, value)) for each, value in ends]


def _moved(floor: _Floor, sides: Sequence[_Side], degrees: Sequence[float]) -> list[_Side]:
    """Return the sides, each in turn shifted and rotated for the best fit, with decreasing steps."""
    sides = list(sides)
    for step in np.deg2rad(degrees).tolist():
        for _ in range(_ROUNDS):
            was = list(sides)
            for at, side in enumerate(was):
                on = floor.within([*sides[:at], *sides[at + 1 :]])
                sides[at] = _turned(floor, side, on, step)
            if sides == was:
                break
    return sides


def _turned(floor: _Floor, side: _Side, on: Bools, step: float) -> _Side:
    tried = [floor.cut(side.angle_rad + way * step, on) for way in (0, -2, -1, 1, 2)]
    best = max(tried, key=lambda one: one[0])
    if best[0] > tried[0][0]:
        return best[1]
    as_good = [one.angle_rad for gain, one in tried if gain == best[0]]
    if len(as_good) == 1:
        return tried[0][1]
    return floor.cut(float(np.mean(as_good)), on)[1]  # mean of all equally good angles


def _card(sides: Sequence[_Side]) -> PolygonCard | None:
    cards = [(side.angle_rad % (2 * np.pi), side.cut.card()) for side in sides]
    known = [(angle, metres) for angle, metres in cards if metres is not None]
    known.sort(key=lambda one: one[0])
    made = tuple(SideCard(angle_rad=angle, metres=metres) for angle, metres in known)
    return PolygonCard(sides=made) if made else None
