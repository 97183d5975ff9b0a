"""The heatmap of logged against predicted level, with its table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.numbers import fixed, percent
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.report.inputs import PageInputs


def _charts(page: PageInputs) -> Iterator[Chart]:
    from cyclekit.report import maps

    texts, judged = page.texts, page.judged
    matrix: Sequence[Sequence[float]] = judged.get("confusion") or ()
    levels = [entry["level"] if isinstance(entry, dict) else entry for entry in judged.get("levels") or ()]
    if not matrix or len(matrix) != len(levels):
        return
    names = [percent(float(level)) for level in levels]
    counts = np.asarray(matrix, dtype=np.float64)
    rows = []
    for name, line in zip(names, counts.tolist(), strict=True):
        total = sum(line)
        rows.append([name, *(fixed(100 * value / total, 1) if total else "–" for value in line)])
    caption = texts("trust.confusion")
    name = texts("trust.confusion_title")
    table = ReportTable(name, [texts("trust.truth"), *names], rows, frozenset(range(len(names) + 1)), silent=True)
    labels = {"logged": texts("trust.truth"), "predicted": texts("trust.predicted")}
    labels["tip"] = texts.section("trust")["tip_confusion"]
    right = percent(float(counts.trace() / counts.sum())) if counts.sum() else percent(None)
    alt = texts("trust.confusion_picture", right=right)
    drawn = Picture("heatmap", alt, lambda width_in: maps.heatmap(width_in, counts, names, labels))
    yield Chart(drawn, caption, title=name, numbers=table)


CONFUSION = Figure("confusion", "trust", _charts)
