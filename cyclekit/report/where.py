"""Section 2: where the seconds of a cycle go, per sequence and task, estimated or logged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclekit.estimate.result import HIDDEN
from cyclekit.report.figures import charts_of
from cyclekit.report.figures.time_chart import MAX_SEQUENCES
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts


def section(page: PageInputs) -> dict[str, Any]:
    """Return what the template needs for section 2."""
    texts, charts = page.texts, charts_of("where", page)
    if page.ranked:
        activity = _activity(texts, page.ranked)
        return {"sentences": [texts("where.lead_estimated")], "charts": charts, "activity": activity}
    if page.tasks.is_empty():
        none = texts("where.none")
        return {"sentences": [none], "charts": charts, "activity": None, "missing": [none]}
    unknown = [texts("where.unknown")] if page.tasks["safety_loss_s"].null_count() else []
    return {"sentences": [texts("where.lead_logged"), *unknown], "charts": charts, "activity": None}


def _activity(texts: ReportTexts, ranked: Sequence[CycleEstimate]) -> ReportTable | None:
    """Safety loss by operator task, for the sequences that have it."""
    shown = [each for each in ranked[:MAX_SEQUENCES] if each.safety_by_activity_s]
    if not shown:
        return None
    total: dict[str, float] = {}
    for each in shown:
        for activity, loss in each.safety_by_activity_s.items():
            total[activity] = total.get(activity, 0.0) + loss
    if all(activity.startswith(HIDDEN) for activity in total):  # no task of the operator is known
        return None
    heads = [texts("where.activity_head"), *(f"{each.name}, s" for each in shown)]
    rows = [
        [texts.task(activity), *(fixed(each.safety_by_activity_s.get(activity), 1) for each in shown)]
        for activity in sorted(total, key=lambda name: -total[name])
    ]
    return ReportTable(texts("where.activity"), heads, rows, frozenset(range(1, len(heads))), silent=True)
