"""Where the seconds go: the split of each sequence and of its tasks, or of the logged tasks without estimates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.findings import Share, task_shares
from cyclekit.report.numbers import fixed
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts

MOST_SEQUENCES = 3
"""Maximum number of sequences drawn task by task; the others are in the first picture and in the tables."""

MOST_LOGGED, MOST_ROWS = 12, 30


def _charts(page: PageInputs) -> Iterator[Chart]:
    texts, ranked = page.texts, page.ranked
    if not ranked:
        if logged := task_shares(page.tasks):
            yield _chart(texts, "logged", texts("where.caption_logged"), logged, seen=True)
        return
    whole = [Share(e.name, e.nominal_s, e.safety_loss_s, e.dwell_s, e.wait_s) for e in ranked]
    yield _chart(texts, "sequences", texts("where.caption_sequences"), whole)
    longest_s = max((task.expected_s for each in ranked[:MOST_SEQUENCES] for task in each.tasks), default=None)
    for number, each in enumerate(ranked[:MOST_SEQUENCES]):
        rows = [
            Share(f"{order}  {texts.task(t.task)}", t.nominal_s, t.safety_loss_s, t.dwell_s, t.wait_s)
            for order, t in enumerate(each.tasks, start=1)
        ]
        if rows:
            caption = texts("where.caption_tasks", name=each.name)
            yield _chart(texts, f"tasks{number}", caption, rows, longest_s=longest_s)


def _chart(
    texts: ReportTexts,
    name: str,
    caption: str,
    rows: Sequence[Share],
    *,
    seen: bool = False,
    longest_s: float | None = None,
) -> Chart:
    from cyclekit.report import charts

    rows = [Share(texts.task(r.name), r.nominal_s, r.safety_s, r.dwell_s, r.wait_s, r.seen) for r in rows]
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
    picture = Picture(name, alt, lambda width_in: charts.shares(width_in, drawn, labels, longest_s))
    return Chart(picture, caption, numbers=_table(texts, caption, rows, seen=seen))


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


TIME_SHARES = Figure("time_shares", "where", _charts)
