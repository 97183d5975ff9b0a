"""The cells of a fleet over the months: cycle time and part of it lost to safety, one line per cell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from cyclekit.plots import colours
from cyclekit.plots.style import tip
from cyclekit.report.pictures import WIDE_IN, Picture
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import MonthCard
    from cyclekit.report.texts import ReportTexts

MIN_MONTHS, MAX_CELLS = 2, 8
_HUES = (
    colours.NOMINAL,
    colours.SAFETY,
    colours.OPERATOR,
    colours.PREDICTED,
    "#b8860b",
    colours.ROBOT,
    "#a3123a",
    "#62a9d6",
)


def months_picture(texts: ReportTexts, cells: Mapping[str, Sequence[MonthCard]]) -> Picture | None:
    """Return the picture of the cells whose logs reach over several months; None without any."""
    shown = {name: months for name, months in cells.items() if len(months) >= MIN_MONTHS}
    shown = dict(list(shown.items())[:MAX_CELLS])
    if not shown:
        return None
    alt = texts("fleet.months_picture", cells=len(shown))
    return Picture("months", alt, lambda width_in: _drawn(texts, shown, width_in))


def _drawn(texts: ReportTexts, cells: Mapping[str, Sequence[MonthCard]], width_in: float) -> Figure:
    figure = Figure(figsize=(width_in, 2.6 if width_in == WIDE_IN else 4.6), layout="constrained")
    wide = width_in == WIDE_IN
    cycle, lost = figure.subplots(1, 2) if wide else figure.subplots(2, 1)
    months = sorted({each.month for every in cells.values() for each in every})
    for (name, every), hue in zip(cells.items(), _HUES, strict=False):
        at = [months.index(each.month) for each in every]
        share = [np.nan if each.lost_share is None else each.lost_share for each in every]
        cycle.plot(at, [each.cycle_s for each in every], "-", color=hue, linewidth=1.4, label=name)
        lost.plot(at, share, "-", color=hue, linewidth=1.4)
        for x, each in zip(at, every, strict=True):
            (dot,) = cycle.plot([x], [each.cycle_s], "o", color=hue, markersize=5)
            values = {"name": name, "month": f"{each.month:%Y-%m}", "cycle": fixed(each.cycle_s, 1)}
            tip(figure, dot, texts("fleet.months_tip", executions=each.executions, **values), name)
        lost.plot(at, share, "o", color=hue, markersize=5)
    for axes, key in ((cycle, "fleet.months_cycle"), (lost, "fleet.months_lost")):
        axes.set(ylim=(0, None), ylabel=texts(key))
        every_nth = max(1, -(-len(months) // 4))
        axes.set_xticks(range(0, len(months), every_nth), [f"{month:%Y-%m}" for month in months[::every_nth]])
        axes.grid(axis="y")
    lost.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    figure.legend(loc="outside upper left", ncols=4 if wide else 2)
    return figure
