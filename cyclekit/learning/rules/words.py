"""Writes a rule in words, as for a safety controller."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.rules.law.law import SAME, shape_of
from cyclekit.learning.rules.samples.distances import TO_BASE, TO_LINK, TO_TCP, TO_TCP_FLAT
from cyclekit.learning.rules.samples.regions import asks_operator, corners, polygon_corners
from cyclekit.text.numbers import compact, exact_percent, fixed, percent, signed, span, with_interval

if TYPE_CHECKING:
    from cyclekit.dataset.cards.rule import (
        LawCard,
        LimitCard,
        MetresCard,
        PolygonCard,
        RectangleCard,
        RegionCard,
        RuleCard,
        SignalCard,
    )
    from cyclekit.learning.rules.ladder import RuleSearch

    _Edges = tuple[MetresCard | None, MetresCard | None]

_TO = {
    TO_TCP: "to the TCP",
    TO_TCP_FLAT: "to the TCP, measured on the floor",
    TO_BASE: "to the robot's base, measured on the floor",
    TO_LINK: "to the nearest link of the arm",
}


def kind_of(rule: RuleCard) -> str:
    """Return the kind of a rule as text."""
    return f"{rule.family}, with hysteresis" if rule.hysteresis else rule.family


def sentences(rule: RuleCard) -> list[str]:
    """Return the sentences of a rule: one per limit, slowest first, and one for the rest; or those of the law."""
    if rule.law is not None:
        return _law(rule.law)
    return [*(_limit(limit) for limit in rule.limits), f"{_speed(rule.levels[-1])} otherwise"]


def verdict(found: RuleSearch) -> str:
    """Return one line on which rule explains the commanded level, or that none does."""
    rival = "" if found.network is None else f"; the network {percent(found.network, 2)}"
    if found.rule is not None and found.rule.law is not None:
        others = "".join(f"; {name} {percent(part, 2)}" for name, part in found.rule.others.items())
        said = f"the scaling is continuous: {found.rule.family} gives {percent(found.rule.explained, 2)}"
        return f"{said} of held-out samples between its bounds within {percent(SAME)} speed ({others[2:]}{rival})"
    if found.rule is not None:
        said = f"{kind_of(found.rule)} explains {percent(found.rule.explained, 2)} of held-out samples"
        return f"{said} (commanded level{rival})"
    if not found.explained:
        return "no rule was searched: too few executions"
    best = max(found.explained, key=lambda name: found.explained[name])
    return f"no simple rule explains the commanded level; best: {best} ({percent(found.explained[best], 1)}{rival})"


def _law(law: LawCard) -> list[str]:
    """Return the law as a formula, in metres, and by the terms of the standard, which the logs do not separate."""
    shape = shape_of(law)
    full_m = sum(shape[:3])
    slowest_m = shape.stop_m + shape.linear_m * law.lowest + shape.square_m * law.lowest**2
    lengths = f"{_metres(law.stop)} + {_metres(law.linear)} * s + {_metres(law.square)} * s^2"
    rates = (("down", law.ramp_down_per_s), ("up", law.ramp_up_per_s))
    limited = [f"{name} {compact(100 * rate, 3)} %/s" for name, rate in rates if rate]
    return [
        f"speed = the highest s from {compact(100 * law.lowest, 3)} % to 100 % at which {lengths} "
        f"does not exceed the distance of the operator {_TO[law.distance]}",
        f"{_speed(law.lowest)} nearer than {fixed(slowest_m, 3)} m, full speed from {fixed(full_m, 3)} m on",
        f"by ISO/TS 15066: C + v_h T_r = {fixed(law.stop.value, 3)} m, "
        f"v_p (T_r + v_h / a) = {fixed(law.linear.value, 3)} m, "
        f"v_p^2 / (2 a) = {fixed(law.square.value, 3)} m with v_p the programmed speed; the log determines no more",
        f"reaction time {fixed(law.latency_s, 3)} s; rate of change {', '.join(limited) or 'no limit seen'}",
    ]


def _limit(limit: LimitCard) -> str:
    said = f"{_speed(limit.scaling)} when {_region(limit.within, 'is')}"
    if limit.until is None or limit.within.anywhere:
        return said
    return f"{said}; faster again when {_region(limit.until, 'left')}"


def _speed(level: float) -> str:
    return "stop (speed 0 %)" if level == 0.0 else f"speed {exact_percent(level)}"


def _region(region: RegionCard, verb: str) -> str:
    robot = "" if region.robot is None else f"the TCP is in the {_rectangle(region.robot)}"
    if not asks_operator(region):
        return robot
    return _asked(region, away=verb == "left") + (f" while {robot}" if robot else "")


def _asked(region: RegionCard, *, away: bool) -> str:
    """Return the conditions of a region other than the place of the TCP."""
    if region.anywhere:
        return "the operator is in the cell"
    if region.signals:
        return " or ".join(_signal(signal) for signal in region.signals)
    parts = [
        f"{'farther' if away else 'nearer'} than {_metres(near.metres)} {_TO[near.distance]}" for near in region.nearer
    ]
    parts += [f"{'outside of' if away else 'in'} the {_rectangle(rectangle)}" for rectangle in region.rectangles]
    parts += [f"{'outside of' if away else 'in'} the {_polygon(polygon)}" for polygon in region.polygons]
    return f"the operator is {(' and ' if away else ' or ').join(parts)}"


def _signal(signal: SignalCard) -> str:
    after = f" (delay {fixed(signal.delay_s, 2)} s)" if signal.delay_s else ""
    where = f" while the TCP is {place_of(signal)}" if signal.robot else ""
    return f"signal {signal.signal} is {signal.value}{where}{after}"


FIELD_COLUMNS = "signal ", "occupied at", "while the TCP is", "speed at most"


def field_rows(rule: RuleCard) -> list[tuple[str, ...]]:
    """Return the table of fields, places on the robot's path and speeds; columns FIELD_COLUMNS."""
    limits = ((limit, one) for limit in rule.limits for one in limit.within.signals)
    return [(one.signal, one.value, place_of(one), f"{compact(100 * limit.scaling, 4)} %") for limit, one in limits]


def place_of(signal: SignalCard) -> str:
    """Return where the TCP must be for a signal to count."""
    if signal.robot is None:
        return "anywhere"
    return "at " + ", ".join(
        _between(name, *edges) for name, edges in zip("xy", _sides(signal.robot), strict=True) if edges != (None, None)
    )


def _between(name: str, low: MetresCard | None, high: MetresCard | None) -> str:
    if low is not None and high is not None:
        return f"{name} {span(low.value, high.value, 3)} m"
    return (
        f"{name} above {fixed(low.value, 3)} m"
        if low is not None
        else f"{name} below {fixed(high.value if high else 0, 3)} m"
    )


def _polygon(polygon: PolygonCard) -> str:
    known = [side.metres for side in polygon.sides if side.metres.low is not None and side.metres.high is not None]
    off = max((max(m.value - (m.low or 0.0), (m.high or 0.0) - m.value) for m in known), default=None)
    sure = "" if off is None else f", edges known to {fixed(off, 3)} m (95 % CI)"
    if (found := polygon_corners(polygon)) is not None:
        return f"polygon with corners {', '.join(f'({fixed(x, 2)}, {fixed(y, 2)})' for x, y in found)} m{sure}"
    lines = [
        f"{fixed(np.cos(side.angle_rad), 3)} x {signed(np.sin(side.angle_rad), 3)} y "
        f"below {fixed(side.metres.value, 3)} m"
        for side in polygon.sides
    ]
    return f"area {', '.join(lines)}{sure} (its other edges were never crossed)"


def _rectangle(rectangle: RectangleCard) -> str:
    turned, degrees = rectangle.angle_rad != 0.0, np.rad2deg(rectangle.angle_rad)
    sides = [_side(name, edges) for name, edges in zip("uv" if turned else "xy", _sides(rectangle), strict=True)]
    said = "rectangle " + ", ".join(side for side in sides if side)
    said += f", u and v being x and y turned by {fixed(degrees, 1)} degrees" if turned else ""
    found = corners(rectangle)
    if found is None:
        return f"{said} (its other edges were never crossed)"
    return f"{said} (corners {', '.join(f'({fixed(x, 2)}, {fixed(y, 2)})' for x, y in found)} m)"


def _sides(rectangle: RectangleCard) -> tuple[_Edges, _Edges]:
    return rectangle.along, rectangle.across


def _side(name: str, edges: _Edges) -> str:
    """Return the extent of a rectangle along one axis; empty if neither edge is known."""
    low, high = edges
    if low is None:
        return "" if high is None else f"{name} up to {_metres(high)}"
    return f"{name} from {_metres(low)}" + ("" if high is None else f" to {_metres(high)}")


def _metres(metres: MetresCard) -> str:
    if metres.low is None or metres.high is None:
        return f"{fixed(metres.value, 3)} m"
    return with_interval(metres.value, metres.low, metres.high, 3, "m")
