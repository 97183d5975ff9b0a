"""The figures of the page: each is a function in a module of this folder, and a line here puts it on the page.

In: what the page is made of (`report.inputs`). Out: the charts of a section, in the order of `FIGURES`. A new figure
brings its words along (`Figure.words`); nothing else of the report knows it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.report.figures.cycle_times import CYCLE_TIMES
from cyclekit.report.figures.figure import Chart as Chart
from cyclekit.report.figures.figure import Figure as Figure
from cyclekit.report.figures.floor_plans import LOST_TIME, ZONES
from cyclekit.report.figures.lost_causes import LOST_CAUSES
from cyclekit.report.figures.predictions import CALIBRATION, CONFUSION
from cyclekit.report.figures.staircase import STAIRCASE
from cyclekit.report.figures.time_chart import TIME_CHART
from cyclekit.report.figures.waits import WAITS

if TYPE_CHECKING:
    from cyclekit.report.inputs import PageInputs

FIGURES: tuple[Figure, ...] = (
    CYCLE_TIMES,
    TIME_CHART,
    WAITS,
    LOST_CAUSES,
    STAIRCASE,
    ZONES,
    LOST_TIME,
    CONFUSION,
    CALIBRATION,
)
"""Every figure, in the order of the page."""


def charts_of(section: str, page: PageInputs) -> list[Chart]:
    """Return the charts of a section: those of each of its figures that has something to show."""
    return [chart for each in FIGURES if each.section == section for chart in each.charts(page)]
