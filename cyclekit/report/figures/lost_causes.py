"""What time was lost to in the logged executions: a bar and a row per cause."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.dataset.lost_time import CAUSE_NAMES, lost_time
from cyclekit.plots import colours
from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure as Drawing

    from cyclekit.report.inputs import PageInputs

_WORDS = {
    "title": "What time was lost to",
    "caption": "Mean time lost per logged execution, by cause. Per hour the robot stood still between places {stops} "
    "times, and its speed scaling changed {changes} times.",
    "picture": "Time lost per execution by cause; most to {cause}, {loss} s.",
    "axis": "lost per execution, s",
    "cause": "Cause",
    "seconds": "Per execution, s",
    "share": "Share, %",
    "stops": "Standstills between places per hour",
}


def _charts(page: PageInputs) -> Iterator[Chart]:
    dataset, texts = page.dataset, page.texts
    executions = dataset.executions
    duration_s = float(executions["duration_s"].sum())
    found = lost_time(page.tasks, page.samples, dataset.levels, dataset.rate_hz, duration_s)
    if found is None or sum(found.seconds.values()) <= 0.0:
        return
    each = {cause: seconds / executions.height for cause, seconds in found.seconds.items() if seconds > 0.0}
    ranked = sorted(each, key=lambda cause: -each[cause])
    bars = [(CAUSE_NAMES[cause], each[cause], colours.CAUSES[cause]) for cause in ranked]
    rows = [
        [
            CAUSE_NAMES[cause],
            fixed(each[cause], 1),
            fixed(100 * found.share(cause), 1),
            fixed(found.stops_per_hour.get(cause, 0.0), 1),
        ]
        for cause in ranked
    ]
    heads = [texts(f"lost_causes.{key}") for key in ("cause", "seconds", "share", "stops")]
    stops = fixed(sum(found.stops_per_hour.values()), 1)
    caption = texts("lost_causes.caption", stops=stops, changes=fixed(found.changes_per_hour, 0))
    alt = texts("lost_causes.picture", cause=bars[0][0], loss=fixed(bars[0][1], 1))
    labels = {"seconds": texts("lost_causes.axis")}

    def drawn(width_in: float) -> Drawing:
        from cyclekit.report import charts

        return charts.causes(width_in, bars, labels)

    numbers = ReportTable(texts("lost_causes.title"), heads, rows, frozenset({1, 2, 3}), silent=True)
    yield Chart(Picture("lost_causes", alt, drawn), caption, title=texts("lost_causes.title"), numbers=numbers)


LOST_CAUSES = Figure("lost_causes", "where", _charts, _WORDS)
