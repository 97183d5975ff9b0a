"""A region of the robot: slow while the TCP is in a rectangle on the floor, alone or combined with the operator."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import RectangleCard, RegionCard
from cyclekit.learning.rules.cuts import best_box, has_edges, without_idle_edges
from cyclekit.learning.rules.families.family import Family
from cyclekit.learning.rules.samples.regions import turned

if TYPE_CHECKING:
    from cyclekit.learning.rules.cuts import Edges, LimitRows


def _fit(rows: LimitRows, start: RegionCard | None, *, operator: bool, field: bool) -> RegionCard:
    """Return the region whose edges fit best, all optimised together; empty if there is none.

    Args:
        rows: Rows to explain.
        start: Region to start from.
        operator: The operator must be present.
        field: The operator must be in a rectangle.
    """
    weight = rows.weight * np.isfinite(rows.positions.floor_m[:, 0]) if operator else rows.weight
    values = (*turned(rows.positions.tcp_m, 0.0), *(turned(rows.positions.floor_m, 0.0) if field else ()))
    begin = _edges(start.robot, *start.rectangles) if start and start.robot else None
    found = best_box(values, rows.slow, weight, begin)
    if found is None:
        return RegionCard()
    robot = RectangleCard(along=found[0], across=found[1])
    rectangles = (RectangleCard(along=found[2], across=found[3]),) if field else ()
    region = RegionCard(
        anywhere=operator and not field, rectangles=rectangles, robot=robot if has_edges(robot) else None
    )
    region = without_idle_edges(region, rows.wrong, max(_FEW_ROWS, _GAIN * float(rows.weight.sum())))
    return RegionCard() if region.robot is not None and _is_one_place(region.robot) else region


def _is_one_place(robot: RectangleCard) -> bool:
    """Return whether a rectangle is so narrow that it only holds one place where the robot stands: no region."""
    pairs = (robot.along, robot.across)
    return any(low is not None and high is not None and high.value - low.value < MIN_WIDTH_M for low, high in pairs)


def _edges(*rectangles: RectangleCard) -> list[Edges]:
    return [edges for rectangle in rectangles for edges in (rectangle.along, rectangle.across)]


MIN_WIDTH_M = 0.02
"""Minimum width of a rectangle of the TCP, m."""
_FEW_ROWS, _GAIN = 5.0, 5e-4
"""Minimum gain of an edge of the TCP's rectangle, in rows and as a share: the TCP crosses it in every execution."""
_WHILE = "while the robot is in a rectangle on the floor"
ROBOT = {
    "robot in a rectangle on the floor": Family(partial(_fit, operator=False, field=False), may_lag=False),
    f"presence {_WHILE}": Family(partial(_fit, operator=True, field=False), may_lag=False),
    f"rectangle on the floor {_WHILE}": Family(partial(_fit, operator=True, field=True), may_lag=False),
}
