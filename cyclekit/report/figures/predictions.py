"""Logged against predicted: the heatmap of levels, and the means on the executions judged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.rules.safety import RuleSafety, asks_signals
from cyclekit.report.calibration import calibration
from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import count, fixed, percent

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.report.inputs import PageInputs


def _confusion(page: PageInputs) -> Iterator[Chart]:
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
    yield Chart(drawn, caption, title=name, numbers=table, half=True)


CONFUSION = Figure("confusion", "trust", _confusion)


def _calibration(page: PageInputs) -> Iterator[Chart]:
    from cyclekit.report import maps

    texts = page.texts
    answers = page.answers
    if isinstance(answers, RuleSafety) and asks_signals(answers.rule):
        return
    found = calibration(page.samples, page.judged.get("executions") or (), answers)
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
    yield Chart(drawn, caption, title=name, numbers=table, half=True)


CALIBRATION = Figure("calibration", "trust", _calibration)
