"""A region of the robot: slow while the TCP is in a rectangle on the floor, alone or combined with the operator."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.rule import RectangleCard, RegionCard
from cyclekit.learning.rules.cuts import best_box
from cyclekit.learning.rules.families.family import Family
from cyclekit.learning.rules.regions import turned

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
    return _without_idle(rows, RegionCard(anywhere=operator and not field, rectangles=rectangles, robot=robot))


def _without_idle(rows: LimitRows, region: RegionCard) -> RegionCard:
    """Return the region without the edges of the TCP's rectangle that explain almost nothing."""
    least = max(_FEW_ROWS, _GAIN * float(rows.weight.sum()))
    for side, number in ((side, number) for side in ("along", "across") for number in (0, 1)):
        if (robot := region.robot) is None:
            break
        edges = list(getattr(robot, side))
        edges[number] = None
        open_there = structs.replace(region, robot=structs.replace(robot, **{side: tuple(edges)}))
        if rows.wrong(open_there) < rows.wrong(region) + least:
            region = open_there
    return region


def _edges(*rectangles: RectangleCard) -> list[Edges]:
    return [edges for rectangle in rectangles for edges in (rectangle.along, rectangle.across)]


_FEW_ROWS, _GAIN = 5.0, 5e-4
"""Minimum gain of an edge of the TCP's rectangle, in rows and as a share: the TCP crosses it in every execution."""
_WHILE = "while the robot is in a rectangle on the floor"
ROBOT = {
    "robot in a rectangle on the floor": Family(partial(_fit, operator=False, field=False), may_lag=False),
    f"presence {_WHILE}": Family(partial(_fit, operator=True, field=False), may_lag=False),
    f"rectangle on the floor {_WHILE}": Family(partial(_fit, operator=True, field=True), may_lag=False),
}
