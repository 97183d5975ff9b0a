"""Predicted against logged means, on the executions that the model was evaluated on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.judged import calibration
from cyclekit.report.numbers import count, percent
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.report.inputs import PageInputs


def _charts(page: PageInputs) -> Iterator[Chart]:
    from cyclekit.report import maps

    texts = page.texts
    found = calibration(page.samples, page.judged.get("executions") or (), page.model)
    if found is None:
        return
    labels = {"logged": texts("trust.mean_logged"), "predicted": texts("trust.mean_predicted")}
    labels["tip"] = texts.section("trust")["tip_calibration"]
    caption = texts("trust.calibration")
    heads = [texts("trust.mean_predicted"), texts("trust.mean_logged"), texts("why.count")]
    rows = [
        [percent(predicted), percent(logged), count(int(number))]
        for predicted, logged, number in zip(found.predicted, found.logged, found.count, strict=True)
    ]
    name = texts("trust.calibration_title")
    table = ReportTable(name, heads, rows, frozenset({0, 1, 2}), silent=True)
    alt = texts("trust.calibration_picture", worst=percent(found.worst))
    drawn = Picture("calibration", alt, lambda width_in: maps.calibration(width_in, found, labels))
    yield Chart(drawn, caption, title=name, numbers=table)


CALIBRATION = Figure("calibration", "trust", _charts)
