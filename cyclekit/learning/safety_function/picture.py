"""The safety function as a picture: the staircase over the distance, and the floor seen from above; plain SVG."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.safety_function.fit import FLOOR_M

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.learning.safety_function.answer import Zones

WIDTH, HEIGHT, EDGE = 420, 320, 44
_SLOW, _FAST = (178, 24, 43), (247, 247, 247)


def zones_svg(zones: Zones) -> str:
    """Return an SVG document: left the staircase with the intervals of its thresholds, right the floor."""
    body = [*_staircase(zones), *_floor(zones)]
    size = f'width="{2 * WIDTH}" height="{HEIGHT + 40}" viewBox="0 0 {2 * WIDTH} {HEIGHT + 40}"'
    style = "<style>text{font:12px sans-serif;fill:#222}</style>"
    title = f"<title>{escape(zones.rule)}</title>"
    note = f'<text x="{EDGE}" y="{HEIGHT + 30}">Read back from logs. No safety proof.</text>'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        "<!-- written by cyclekit -->",
        title,
        style,
        *body,
        note,
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _staircase(zones: Zones) -> Iterator[str]:
    known = [entry for entry in zones.thresholds if np.isfinite(entry.metres)]
    far = 1.25 * max([entry.metres for entry in known], default=1.0)

    def x(metres: float) -> float:
        return EDGE + metres / far * (WIDTH - 2 * EDGE)

    def y(scaling: float) -> float:
        return HEIGHT - EDGE - scaling * (HEIGHT - 2 * EDGE)

    for entry in known:
        low, high = (bound if np.isfinite(bound) else entry.metres for bound in (entry.low, entry.high))
        wide = max(x(high) - x(low), 1.0)
        yield f'<rect x="{x(low):.1f}" y="{EDGE}" width="{wide:.1f}" height="{HEIGHT - 2 * EDGE}" fill="#cde"/>'
        yield f'<text x="{x(entry.metres):.1f}" y="{HEIGHT - EDGE + 16}" text-anchor="middle">{entry.metres:.2f}</text>'
    points = [(0.0, known[0].slower if known else zones.levels[-1])]
    for entry in known:
        points += [(entry.metres, entry.slower), (entry.metres, entry.faster)]
    points.append((far, points[-1][1]))
    line = " ".join(f"{x(m):.1f},{y(s):.1f}" for m, s in points)
    yield f'<polyline points="{line}" fill="none" stroke="#036" stroke-width="2"/>'
    for level in zones.levels:
        yield f'<text x="{EDGE - 6}" y="{y(level) + 4:.1f}" text-anchor="end">{level:.2f}</text>'
    title = "speed scaling over the distance, m" if zones.is_distance else "distance, m: does not explain it alone"
    yield f'<text x="{EDGE}" y="{EDGE - 16}">{escape(title)}</text>'


def _floor(zones: Zones) -> Iterator[str]:
    corner = zones.floor_m
    if not len(corner):
        return
    low = corner.min(axis=0)
    scale = (min(WIDTH, HEIGHT) - 2 * EDGE) / float(max((corner.max(axis=0) - low).max() + FLOOR_M, 1e-9))
    side = FLOOR_M * scale

    def at(x_m: float, y_m: float) -> tuple[float, float]:  # x to the right, y upwards
        return WIDTH + EDGE + (x_m - low[0]) * scale, HEIGHT - EDGE - (y_m - low[1]) * scale

    for (x_m, y_m), scaling in zip(corner.tolist(), zones.floor_scaling.tolist(), strict=True):
        x, y = at(x_m, y_m + FLOOR_M)
        colour = ",".join(str(round(a + (b - a) * scaling)) for a, b in zip(_SLOW, _FAST, strict=True))
        box = f'x="{x:.1f}" y="{y:.1f}" width="{side:.1f}" height="{side:.1f}"'
        yield f'<rect {box} fill="rgb({colour})" stroke="#ccc" stroke-width="0.5"><title>{scaling:.2f}</title></rect>'
    x, y = at(0.0, 0.0)
    yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#036"><title>robot base</title></circle>'
    yield f'<text x="{WIDTH + EDGE}" y="{EDGE - 16}">median scaling by the operator\'s place; dot: robot base</text>'
