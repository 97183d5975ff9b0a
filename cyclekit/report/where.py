"""Section 2: where the seconds of a cycle go, per sequence and task, estimated or logged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclekit.report.findings import Share, task_shares
from cyclekit.report.numbers import fixed
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable, spell

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.texts import ReportTexts

MOST_SEQUENCES = 3
"""Maximum number of sequences drawn task by task; the others are in the first picture and in the tables."""

MOST_LOGGED, MOST_ROWS = 12, 30


def section(texts: ReportTexts, ranked: Sequence[CycleEstimate], tasks: pl.DataFrame) -> dict[str, Any]:
    """Return what the template needs for section 2."""
    if ranked:
        return {
            "sentences": [texts("where.lead_estimated")],
            "charts": _estimated(texts, ranked),
            "activity": _activity(texts, ranked),
        }
    rows = task_shares(tasks)
    if not rows:
        none = texts("where.none")
        return {"sentences": [none], "charts": [], "activity": None, "missing": [none]}
    sentences = [texts("where.lead_logged")]
    if tasks["safety_loss_s"].null_count():
        sentences.append(texts("where.unknown"))
    chart = _chart(texts, "logged", texts("where.caption_logged"), rows, seen=True)
    return {"sentences": sentences, "charts": [chart], "activity": None}


def _estimated(texts: ReportTexts, ranked: Sequence[CycleEstimate]) -> list[dict[str, Any]]:
    whole = [Share(e.name, e.nominal_s, e.safety_loss_s, e.dwell_s, e.wait_s) for e in ranked]
    charts = [_chart(texts, "sequences", texts("where.caption_sequences"), whole)]
    longest_s = max((task.expected_s for each in ranked[:MOST_SEQUENCES] for task in each.tasks), default=None)
    for number, each in enumerate(ranked[:MOST_SEQUENCES]):
        rows = [
            Share(f"{order}  {spell(t.task)}", t.nominal_s, t.safety_loss_s, t.dwell_s, t.wait_s)
            for order, t in enumerate(each.tasks, start=1)
        ]
        if rows:
            caption = texts("where.caption_tasks", name=each.name)
            charts.append(_chart(texts, f"tasks{number}", caption, rows, longest_s=longest_s))
    return charts


def _chart(
    texts: ReportTexts,
    name: str,
    caption: str,
    rows: Sequence[Share],
    *,
    seen: bool = False,
    longest_s: float | None = None,
) -> dict[str, Any]:
    from cyclekit.report import charts

    rows = [Share(spell(r.name), r.nominal_s, r.safety_s, r.dwell_s, r.wait_s, r.seen) for r in rows]
    drawn = rows[: MOST_LOGGED if seen else MOST_ROWS]
    words = texts.section("where")
    labels = {"seconds": words["axis"], **{key: words[key] for _, key, _ in charts.PARTS}}
    worst = max(rows, key=lambda row: row.safety_s)
    alt = texts(
        "where.picture",
        count=len(drawn),
        name=worst.name.strip(),
        loss=fixed(worst.safety_s, 1),
        total=fixed(worst.total_s, 1),
    )
    if len(rows) > len(drawn):
        caption = f"{caption} {texts('where.more', count=len(rows) - len(drawn))}"
    return {
        "picture": Picture(name, alt, lambda width_in: charts.shares(width_in, drawn, labels, longest_s)),
        "caption": caption,
        "table": _table(texts, caption, rows, seen=seen),
    }


def _table(texts: ReportTexts, caption: str, rows: Sequence[Share], *, seen: bool) -> ReportTable:
    from cyclekit.report.charts import PARTS

    words = texts.section("where")
    heads = [words["task"], *(f"{words[key]}, s" for _, key, _ in PARTS), words["total"]]
    body = [
        [row.name, *(fixed(getattr(row, field), 1) for field, _, _ in PARTS), fixed(row.total_s, 1)] for row in rows
    ]
    if seen:
        heads.append(words["seen"])
        body = [[*line, str(row.seen)] for line, row in zip(body, rows, strict=True)]
    return ReportTable(caption, heads, body, frozenset(range(1, len(heads))), silent=True)


def _activity(texts: ReportTexts, ranked: Sequence[CycleEstimate]) -> ReportTable | None:
    """Safety loss by operator task, for the sequences that have it."""
    shown = [each for each in ranked[:MOST_SEQUENCES] if each.safety_by_activity_s]
    if not shown:
        return None
    total: dict[str, float] = {}
    for each in shown:
        for activity, loss in each.safety_by_activity_s.items():
            total[activity] = total.get(activity, 0.0) + loss
    heads = [texts("where.activity_head"), *(f"{each.name}, s" for each in shown)]
    rows = [
        [spell(activity), *(fixed(each.safety_by_activity_s.get(activity), 1) for each in shown)]
        for activity in sorted(total, key=lambda name: -total[name])
    ]
    return ReportTable(texts("where.activity"), heads, rows, frozenset(range(1, len(heads))), silent=True)
