"""Draws the safety function: speed over distance, the floor seen from above, and the rule in words.

If a rule explains the logs, the floor shows its shapes: solid lines where the robot slows down, dashed lines that the
operator must leave before it speeds up again. Colours show the speed.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.rules.law.law import shape_of
from cyclekit.learning.rules.words import FIELD_COLUMNS, field_rows
from cyclekit.learning.safety_function.fit import FLOOR_M, Threshold
from cyclekit.learning.safety_function.path import PATH_M
from cyclekit.plots.style import MUTED, plain_style
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.rule import LawCard, RuleCard
    from cyclekit.learning.safety_function.answer import SafetyFunction
    from cyclekit.plots.drawing import Axes, Drawing

LETTERS, LINE_IN = 150, 0.19
"""Maximum number of letters per line of text, and height of a line, inches."""
ABREAST = 3
"""Maximum number of paths drawn side by side."""
OF_PATH = "The robot's path in the colour of the speed while the signal alone is on; grey where it does not count."
PROOF = "Read back from logs. No safety proof."


def zones_figure(zones: SafetyFunction) -> Drawing:
    """Return the figure: speed over distance with confidence intervals on the left, the floor on the right."""
    from cyclekit.plots.drawing import Drawing
    from cyclekit.plots.zones import draw_floor

    if zones.path_speed:
        return _path_figure(zones)
    said = (*zones.doubts, *(f"- {one}" for one in zones.rule_sentences))
    texts = [line for one in said for line in textwrap.wrap(one, LETTERS)]
    if zones.shapes:
        texts.append("Lines on the floor: the rule; dashed: what the operator leaves before the robot speeds up again.")
    texts.append(PROOF)
    with_floor = bool(len(zones.floor_m) or zones.shapes)
    with plain_style():
        figure = Drawing(11.0, 5.0 + LINE_IN * len(texts))
        figure.supxlabel("\n".join(texts), x=0.01, ha="left", fontsize=9, color=MUTED)
        places = figure.subplots(1, 1 + with_floor, squeeze=False, width_ratios=(2, 3)[: 1 + with_floor])[0]
        _over_distance(places[0], zones)
        if with_floor:
            squares = np.column_stack([np.reshape(zones.floor_m, (-1, 2)) + FLOOR_M / 2, zones.floor_scaling])
            draw_floor(places[1], squares, FLOOR_M, zones.shapes, zones.cell)
    return figure


def _path_figure(zones: SafetyFunction) -> Drawing:
    """Return the robot's path seen from above, once per signal, with the table of the rule below."""
    from cyclekit.plots.drawing import Drawing
    from cyclekit.plots.zones import draw_path, draw_table

    rule, count = zones.commanded.rule, len(zones.path_speed)
    rows = [("no rule explains the logs: speeds by the network",)] if rule is None else field_rows(rule)
    high, wide, table_in = -(-count // ABREAST), min(count, ABREAST), 1.6 * LINE_IN * (len(rows) + 1)
    with plain_style():
        figure = Drawing(11.0, 4.6 * high + table_in + LINE_IN)
        figure.supxlabel(f"{OF_PATH} {PROOF}", x=0.01, ha="left", fontsize=9, color=MUTED)
        grid = figure.add_gridspec(high + 1, wide, height_ratios=(*[4.6] * high, table_in))
        draw_table(figure.add_subplot(grid[-1, :]), FIELD_COLUMNS, rows)
        for number, (name, speed) in enumerate(zones.path_speed.items()):
            axes = figure.add_subplot(grid[divmod(number, wide)])
            squares = np.column_stack([zones.path_m + PATH_M / 2, speed])
            draw_path(axes, squares, PATH_M, zones.levels[-1], name, zones.cell)
    return figure


def _over_distance(axes: Axes, zones: SafetyFunction) -> None:
    from cyclekit.plots.zones import draw_curves

    rule = zones.commanded.rule
    if rule is not None and rule.law is not None:
        draw_curves(axes, {"slows down": _law(rule.law)}, (), rule.law.distance)
        return
    known = [] if rule is None else _of_rule(rule, leaving=False)
    leaving = [] if rule is None else _of_rule(rule, leaving=True)
    name = rule.limits[0].within.nearer[0].distance if known and rule is not None else zones.rule
    if not known and not leaving:
        known = [entry for entry in zones.thresholds if np.isfinite(entry.metres)]
        name = zones.rule if zones.is_distance else "distance (does not explain the speed alone)"
    far = 1.25 * max([entry.metres for entry in (*known, *leaving)], default=1.0)
    curves = {"slows down": _steps(known, zones.levels[-1], far)}
    if leaving:
        curves["speeds up again"] = _steps(leaving, zones.levels[-1], far)
    spans = [(each.low, each.high) for each in known if np.isfinite([each.low, each.high]).all()]
    draw_curves(axes, curves, spans, name)
    if known:
        axes.set_xticks([entry.metres for entry in known], [fixed(entry.metres, 2) for entry in known])
        axes.set_yticks(zones.levels)


def _steps(steps: Sequence[Threshold], fastest: float, far: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = [(0.0, steps[0].slower if steps else fastest)]
    for entry in steps:
        points += [(entry.metres, entry.slower), (entry.metres, entry.faster)]
    points.append((far, points[-1][1]))
    metres, speed = np.array(points).T
    return metres, speed


def _law(law: LawCard) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the continuous law as points of distance, m, and speed."""
    shape = shape_of(law)
    metres = np.linspace(0.0, 1.25 * (shape.stop_m + shape.linear_m + shape.square_m), 200)
    return metres, shape.scaling(metres)


def _of_rule(rule: RuleCard, *, leaving: bool) -> list[Threshold]:
    """Return the thresholds of a rule on its first distance, for slowing down or for speeding up again."""
    regions = [(limit.scaling, limit.until if leaving else limit.within) for limit in rule.limits]
    near = [(level, region.nearer[0].metres) for level, region in regions if region is not None and region.nearer]
    faster = [*(level for level, _ in near[1:]), rule.levels[-1]]
    return [
        Threshold(level, then, at.value, *(np.nan if bound is None else bound for bound in (at.low, at.high)))
        for (level, at), then in zip(near, faster, strict=False)
    ]
