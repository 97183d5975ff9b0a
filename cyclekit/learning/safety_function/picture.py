"""The safety function as a picture: the staircase over the distance, and the floor seen from above; plain SVG.

Where a rule explains the logs its shapes lie on the floor: solid where the robot slows down, dashed what the operator
must leave for it to speed up again. Colours are those of the speed everywhere.
"""

from __future__ import annotations

import textwrap
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.rules.law import shape_of
from cyclekit.learning.safety_function.fit import FLOOR_M, Threshold
from cyclekit.plots.colours import ROBOT, scaling_hex

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cyclekit.dataset.cards.rule import LawCard, RuleCard
    from cyclekit.learning.rules.shapes import RuleShape
    from cyclekit.learning.safety_function.answer import SafetyFunction

WIDTH, HEIGHT, EDGE = 480, 480, 44
LINE, LETTERS = 16, 130
"""Height of a line of text, and how many letters it has at most."""
_HALO = 'paint-order="stroke" stroke="white" stroke-width="3"'


def zones_svg(zones: SafetyFunction) -> str:
    """Return an SVG document: left the staircase with the intervals of its thresholds, right the floor."""
    rule = zones.commanded.rule
    law = None if rule is None else rule.law
    texts = [line for one in zones.rule_sentences for line in textwrap.wrap(f"- {one}", LETTERS)]
    texts.append("Read back from logs. No safety proof.")
    height = HEIGHT + LINE * (len(texts) + 1)
    size = f'width="{2 * WIDTH}" height="{height}" viewBox="0 0 {2 * WIDTH} {height}"'
    notes = [f'<text x="{EDGE}" y="{HEIGHT + LINE * (n + 1)}">{escape(text)}</text>' for n, text in enumerate(texts)]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        "<!-- written by cyclekit -->",
        f"<title>{escape(zones.rule)}</title>",
        "<style>text{font:12px sans-serif;fill:#222}</style>",
        *(_staircase(zones) if law is None else _curve(law)),
        *_floor(zones),
        *notes,
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _staircase(zones: SafetyFunction) -> Iterator[str]:
    rule, title = zones.commanded.rule, "speed scaling over the distance, m"
    known = [] if rule is None else _of_rule(rule, leaving=False)
    leaving = [] if rule is None else _of_rule(rule, leaving=True)
    if leaving:
        title += "; dashed: to speed up again"
    elif not known:
        known = [entry for entry in zones.thresholds if np.isfinite(entry.metres)]
        title = title if zones.is_distance else "distance, m: does not explain it alone"
    far = 1.25 * max([entry.metres for entry in (*known, *leaving)], default=1.0)

    def x(metres: float) -> float:
        return EDGE + metres / far * (WIDTH - 2 * EDGE)

    def y(scaling: float) -> float:
        return HEIGHT - EDGE - scaling * (HEIGHT - 2 * EDGE)

    for entry in known:
        low, high = (bound if np.isfinite(bound) else entry.metres for bound in (entry.low, entry.high))
        wide = max(x(high) - x(low), 1.0)
        yield f'<rect x="{x(low):.1f}" y="{EDGE}" width="{wide:.1f}" height="{HEIGHT - 2 * EDGE}" fill="#cde"/>'
        yield f'<text x="{x(entry.metres):.1f}" y="{HEIGHT - EDGE + 16}" text-anchor="middle">{entry.metres:.2f}</text>'
    for steps, drawn in ((leaving, 'stroke-width="1.2" stroke-dasharray="5 4"'), (known, 'stroke-width="2"')):
        points = [(0.0, steps[0].slower if steps else zones.levels[-1])]
        for entry in steps:
            points += [(entry.metres, entry.slower), (entry.metres, entry.faster)]
        points.append((far, points[-1][1]))
        line = " ".join(f"{x(m):.1f},{y(s):.1f}" for m, s in points)
        if steps or steps is known:
            yield f'<polyline points="{line}" fill="none" stroke="{ROBOT}" {drawn}/>'
    for level in zones.levels:
        box = f'x="{EDGE - 44}" y="{y(level) - 4:.1f}" width="8" height="8"'
        yield f'<rect {box} fill="{scaling_hex(level)}"/>'
        yield f'<text x="{EDGE - 6}" y="{y(level) + 4:.1f}" text-anchor="end">{level:.2f}</text>'
    yield f'<text x="{EDGE}" y="{EDGE - 16}">{escape(title)}</text>'


def _curve(law: LawCard) -> Iterator[str]:
    """The continuous law over its distance."""
    shape = shape_of(law)
    ends = [(s, shape.stop_m + shape.linear_m * s + shape.square_m * s**2) for s in (shape.lowest, 1.0)]
    far = 1.25 * ends[1][1]
    metres = np.linspace(0.0, far, 200)

    def at(apart_m: float, scaling: float) -> tuple[float, float]:
        wide, high = WIDTH - 2 * EDGE, HEIGHT - 2 * EDGE
        return EDGE + apart_m / far * wide, HEIGHT - EDGE - scaling * high

    points = [at(*each) for each in zip(metres.tolist(), shape.scaling(metres).tolist(), strict=True)]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    yield f'<polyline points="{line}" fill="none" stroke="{ROBOT}" stroke-width="2"/>'
    for scaling, apart_m in ends:
        x, y = at(apart_m, scaling)
        yield f'<text x="{x:.1f}" y="{HEIGHT - EDGE + 16}" text-anchor="middle">{apart_m:.2f}</text>'
        yield f'<rect x="{EDGE - 44}" y="{y - 4:.1f}" width="8" height="8" fill="{scaling_hex(scaling)}"/>'
        yield f'<text x="{EDGE - 6}" y="{y + 4:.1f}" text-anchor="end">{scaling:.2f}</text>'
    title = f"speed scaling over the {law.distance}, m"
    yield f'<text x="{EDGE}" y="{EDGE - 16}">{escape(title)}</text>'


def _of_rule(rule: RuleCard, *, leaving: bool) -> list[Threshold]:
    """Return the thresholds of a rule on its first distance: those to slow down at, or to speed up again."""
    regions = [(limit.scaling, limit.until if leaving else limit.within) for limit in rule.limits]
    near = [(level, region.nearer[0].metres) for level, region in regions if region is not None and region.nearer]
    faster = [*(level for level, _ in near[1:]), rule.levels[-1]]
    return [
        Threshold(level, then, at.value, *(np.nan if bound is None else bound for bound in (at.low, at.high)))
        for (level, at), then in zip(near, faster, strict=False)
    ]


def _floor(zones: SafetyFunction) -> Iterator[str]:
    corner = zones.floor_m
    if not len(corner):
        return
    low, high = corner.min(axis=0), corner.max(axis=0) + FLOOR_M
    wide = (min(WIDTH, HEIGHT) - 2 * EDGE) / float(max((high - low).max(), 1e-9))
    side = FLOOR_M * wide

    def at(x_m: float, y_m: float) -> tuple[float, float]:  # x to the right, y upwards
        return WIDTH + EDGE + (x_m - low[0]) * wide, HEIGHT - EDGE - (y_m - low[1]) * wide

    for (x_m, y_m), scaling in zip(corner.tolist(), zones.floor_scaling.tolist(), strict=True):
        x, y = at(x_m, y_m + FLOOR_M)
        box = f'x="{x:.1f}" y="{y:.1f}" width="{side:.1f}" height="{side:.1f}"'
        colour = f'fill="{scaling_hex(scaling)}" fill-opacity="0.55"'
        yield f"<rect {box} {colour}><title>{scaling:.2f}</title></rect>"
    box = f'x="{WIDTH + EDGE / 2}" y="{EDGE - 6}" width="{WIDTH - EDGE}" height="{HEIGHT - 1.5 * EDGE}"'
    yield f'<clipPath id="floor"><rect {box}/></clipPath><g clip-path="url(#floor)">'
    for shape in zones.shapes:
        yield from _shape(shape, at)
    x, y = at(0.0, 0.0)
    yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{ROBOT}"><title>robot base</title></circle></g>'
    lines = "; lines: the rule" if zones.shapes else ""
    title = f"median scaling where the operator is; dot: base{lines}"
    yield f'<text x="{WIDTH + EDGE / 2}" y="{EDGE - 16}">{title}</text>'
    yield from _scale()


def _shape(shape: RuleShape, at: Callable[[float, float], tuple[float, float]]) -> Iterator[str]:
    corners = [at(*corner) for corner in shape.outline_m]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    dashes = ' stroke-dasharray="5 4" stroke-width="1.2"' if shape.leaving else ' stroke-width="2.5"'
    speed = f"{100 * shape.level:.4g} %"
    title = f"<title>{speed}: {escape(shape.name)}</title>"
    yield f'<polygon points="{line}" fill="none" stroke="{scaling_hex(shape.level)}"{dashes}>{title}</polygon>'
    if not shape.leaving:
        x, y = corners[0]
        yield f'<text x="{x + 4:.1f}" y="{y - 4:.1f}" {_HALO}>{speed}</text>'


def _scale() -> Iterator[str]:
    """The colour scale of the speed."""
    left, wide = WIDTH + EDGE, 8.0
    for number in range(21):
        box = f'x="{left + wide * number:.0f}" y="{HEIGHT - 26}" width="{wide:.0f}" height="8"'
        yield f'<rect {box} fill="{scaling_hex(number / 20)}"/>'
    for number, text in ((0, "0"), (10, "50"), (20, "100 %")):
        yield f'<text x="{left + wide * number:.0f}" y="{HEIGHT - 6}">{text}</text>'
