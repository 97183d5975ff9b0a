"""Cycle time of each sequence: mean, single cycles, and the time without slow-down."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.estimate.statistics.same_work import by_work
from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.pictures import Picture
from cyclekit.text.numbers import decimals_of, fixed, given

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.report.inputs import PageInputs


def _charts(page: PageInputs) -> Iterator[Chart]:
    best, texts, takt_s = page.best, page.texts, page.takt_s
    if best is None:
        return
    from cyclekit.report import charts

    labels = {
        "seconds": texts("answer.axis"),
        "mean": texts("answer.mean"),
        "cycles": texts.section("answer")["quantiles"],
        "without": texts("answer.without"),
        "tip": texts.section("answer")["tip"],
        "takt": texts("answer.takt_key", takt="" if takt_s is None else given(takt_s)),
    }
    mean = fixed(best.expected_s, decimals_of(*(each.expected_s for each in page.ranked)))
    alt = texts("answer.picture", count=len(page.ranked), name=best.name, mean=mean)
    picture = Picture("cycle", alt, lambda width_in: charts.cycle_times(width_in, page.ranked, labels, takt_s))
    yield Chart(picture, texts("answer.caption" if len(by_work(page.ranked)) == 1 else "answer.caption_works"))


CYCLE_TIMES = Figure("cycle_times", "answer", _charts)
