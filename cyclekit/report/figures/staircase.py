"""The staircase: robot speed against the distance to the operator."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.light import resting
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import UNKNOWN, count, span, whole_percent

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.report.findings import LoggedResponse
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts

DATA_M = 0.25
"""Distance per row of the table behind the staircase."""


def _charts(page: PageInputs) -> Iterator[Chart]:
    texts, found = page.texts, page.response
    if found is None:
        return
    from cyclekit.report import maps

    labels = {key: texts(f"why.{key}") for key in ("logged", "predicted", "distance", "speed")}
    labels["tip"] = texts.section("why")["tip_samples"]
    bands = " ".join(
        texts("why.band", speed=whole_percent(b.scaling), span=span(b.low_m, b.high_m, 2)) for b in found.bands
    )
    levels, alt = page.dataset.levels, texts("why.picture", bands=bands)
    picture = Picture("staircase", alt, lambda width_in: maps.staircase(width_in, found, levels, labels))
    table = _bands(texts, found) if found.bands else None
    caption = f"{resting(texts, page.basis)} {texts('why.caption')}".lstrip()
    yield Chart(picture, caption, numbers=_data(texts, found), table=table)


def _bands(texts: ReportTexts, found: LoggedResponse) -> ReportTable:
    heads = [texts("why.level"), texts("why.range"), texts("why.count")]
    rows = [[whole_percent(b.scaling), span(b.low_m, b.high_m, 2), count(b.samples)] for b in found.bands]
    return ReportTable(texts("why.bands"), heads, rows, frozenset({0, 1, 2}))


def _data(texts: ReportTexts, found: LoggedResponse) -> ReportTable:
    """The numbers behind the staircase: one row per 0.25 m of distance."""
    heads = [texts(f"why.{key}") for key in ("range_head", "logged", "predicted", "count")]
    edges = np.floor(found.bin_m / DATA_M + 1e-9)
    counts = {round(d, 4): 0.0 for d in found.bin_m.tolist()}
    for distance, _, number in found.cells.tolist():
        counts[round(distance, 4)] = counts.get(round(distance, 4), 0.0) + number
    weight = np.array([counts[round(d, 4)] for d in found.bin_m.tolist()])
    rows = []
    for edge in np.unique(edges).tolist():
        mine = edges == edge
        logged = whole_percent(float(np.average(found.logged[mine], weights=weight[mine])))
        expected = UNKNOWN
        if found.predicted is not None and np.isfinite(found.predicted[mine]).all():
            expected = whole_percent(float(np.average(found.predicted[mine], weights=weight[mine])))
        name = span(edge * DATA_M, (edge + 1) * DATA_M, 2)
        rows.append([name, logged, expected, count(int(weight[mine].sum()))])
    return ReportTable(texts("why.data"), heads, rows, frozenset({0, 1, 2, 3}), silent=True)


STAIRCASE = Figure("staircase", "why", _charts)
