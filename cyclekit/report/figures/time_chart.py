"""When robot and operator do what: a time chart of each sequence in which one waits for the other, or of plans."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from cyclekit.estimate.gantt import SHOWN_S, chart_of, legend_of
from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.figures.time_shares import MOST_SEQUENCES
from cyclekit.report.numbers import fixed
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure as Drawn

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts

_WORDS = {
    "caption": "{name}: mean times of each task from the start of the cycle. Hatched: wait; the arrow comes from what "
    "ended it.",
    "picture": "Time chart of {name}, one bar per task of each agent; {waits} tasks begin with a wait.",
    "agent": "Agent",
    "task": "Task",
    "start": "Start, s",
    "end": "End, s",
    "wait": "Wait before it, s",
    "ended": "Wait ended by",
}


def _charts(page: PageInputs) -> Iterator[Chart]:
    for number, each in enumerate(page.ranked[:MOST_SEQUENCES] if page.ranked else ()):
        if each.plan:
            texts = page.texts
            waits = sum(task.wait_s > SHOWN_S for task in each.plan)
            alt = texts("time_chart.picture", name=each.name, waits=waits)
            caption = texts("time_chart.caption", name=each.name)
            picture = Picture(f"timechart{number}", alt, partial(_drawn, each))
            yield Chart(picture, caption, numbers=_table(texts, caption, each))


def _drawn(each: CycleEstimate, width_in: float) -> Drawn:
    from matplotlib.figure import Figure as Drawn

    from cyclekit.plots.gantt import draw_bars, height_in

    lanes, bars, arrows = chart_of([each])
    figure = Drawn(figsize=(width_in, height_in(lanes)), layout="constrained")
    lanes = [lane.removeprefix(f"{each.name}: ") for lane in lanes]
    draw_bars(figure.subplots(), lanes, bars, arrows, legend_of([each]) if width_in > 5.0 else {})
    return figure


def _table(texts: ReportTexts, caption: str, each: CycleEstimate) -> ReportTable:
    heads = [texts(f"time_chart.{name}") for name in ("agent", "task", "start", "end", "wait", "ended")]
    rows = [
        [
            task.agent,
            texts.task(task.task),
            *(fixed(value, 1) for value in (task.start_s, task.end_s, task.wait_s)),
            max(task.decided, key=lambda name: task.decided[name]) if task.wait_s > SHOWN_S else "",
        ]
        for task in each.plan
    ]
    return ReportTable(caption, heads, rows, frozenset((2, 3, 4)), silent=True)


TIME_CHART = Figure("time_chart", "where", _charts, _WORDS)
