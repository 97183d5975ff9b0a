"""The report as data: JSON with everything, CSV with the seconds per task, Markdown with the words and the tables.

The same findings as on the page, unrounded in JSON and CSV, so that others can calculate with them.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from cyclekit.estimate.finding import light_of
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit.report.figures import Chart
from cyclekit.report.findings import losses, safety_function, task_shares
from cyclekit.report.light import put_away
from cyclekit.report.provenance import provenance
from cyclekit.report.tables import ReportTable
from cyclekit.report.verdict import in_words
from cyclekit.text.plain_json import json_text
from cyclekit.text.plain_text import csv_text, markdown

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.light import TrafficLight
    from cyclekit.report.texts import ReportTexts
    from cyclekit.report.tried import Tried
    from cyclekit.report.verdict import TaktVerdict

PARTS = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
MARK = "<!-- written by cyclekit -->"
"""Marks a file that a later report may replace."""


def as_json(cell: str, made: str, page: PageInputs, sections: Mapping[str, Any]) -> str:
    """Return the whole report as one JSON document; unknown values are null."""
    found, headline = safety_function(page.samples, page.dataset.levels, None), sections["answer"]["headline"]
    document = {
        "cell": cell,
        "made": made,
        "answer": headline,
        **light_of(page.findings),
        "verdict": None if page.verdict is None else page.verdict.to_dict(_said(page, page.verdict)),
        "works": [each.to_dict(_said(page, each)) for each in page.verdicts],
        "sequences": [each.to_dict() for each in page.ranked],
        "refused": [each.to_dict() for each in page.refused],
        "logged_tasks": [asdict(share) | {"total_s": share.total_s} for share in task_shares(page.tasks)],
        "levels": [asdict(band) for band in found.bands] if found else [],
        "distance_explains": found.explained if found else None,
        "losses": [asdict(loss) for loss in losses(page.samples, page.seen.executions)],
        "waits": [row.to_dict() | {"waited_s": seconds} for row, seconds in page.waits],
        "what_if": [asdict(change) for change in page.what_if],
        "plan": None if page.planned is None else page.planned.to_dict(),
        "evaluation": None if page.evaluation is None else page.judged,
        "check": None if page.check is None else page.check.to_dict(),
        "to_log": None if page.to_log is None else page.to_log.to_dict(),
        "provenance": asdict(provenance(page.dataset, {}, advise=page.may_regress)),
        "sentences": {key: list(section.get("sentences", ())) for key, section in sections.items()},
    }
    return json_text(document) + "\n"


def _said(page: PageInputs, one: TaktVerdict) -> str:
    """The verdict on one kind of work in words, behind a plain mark if the light is red."""
    return put_away(page.texts, page.light if page.ranked else None, in_words(page.texts, one))


def as_csv(page: PageInputs) -> str:
    """Return one row per sequence (order 0, with its work) and per task of it; without any, one per logged task.

    Then one row per change tried, with its name in `change`, and one row per visit of the order found, with `change` =
    `order`.
    """
    ranked, planned = page.ranked, page.planned
    saves = ["saves_s", "saves_low_s", "saves_high_s"]
    heads = ["sequence", "order", "task", "expected_s", "low_s", "high_s", *PARTS, "seen", "change", *saves, "work"]
    rows: list[Sequence[object]] = [heads]
    for each in ranked:
        whole = [each.expected_s, each.expected_low_s, each.expected_high_s]
        work = str(work_of(each.places, each.operator))
        rows.append([each.name, 0, "", *whole, *(getattr(each, part) for part in PARTS), "", *[""] * 4, work])
        for order, task in enumerate(each.tasks, start=1):
            parts = [getattr(task, part) for part in PARTS]
            rows.append([each.name, order, task.task, task.expected_s, "", "", *parts, "", *[""] * 5])
    if not ranked:
        for share in task_shares(page.tasks):
            parts = [share.nominal_s, share.safety_s, share.dwell_s, share.wait_s]
            rows.append(["", "", share.name, share.total_s, "", "", *parts, share.seen, *[""] * 5])
    rows.extend(_tried_rows(ranked, page.what_if))
    if planned is not None:
        work = str(work_of(planned.sequence("").places))
        rows.append(["", 0, "", planned.expected_s, *[""] * 7, "order", *planned.saves_s, work])
        rows.extend(["", order, visit, *[""] * 8, "order", *[""] * 4] for order, visit in enumerate(planned.order, 1))
    return csv_text(rows)


def _tried_rows(ranked: Sequence[CycleEstimate], what_if: Sequence[Tried]) -> Iterator[list[object]]:
    before = {each.name: each for each in ranked}
    for each in what_if:
        saves = each.saves(before) or ("", "", "")
        work = str(work_of(each.places, each.operator)) if each.places else ""
        yield [each.sequence, 0, "", each.expected_s, each.low_s, each.high_s, *[""] * 5, each.label, *saves, work]


def as_markdown(
    texts: ReportTexts, cell: str, made: str, sections: Mapping[str, Any], light: TrafficLight | None
) -> str:
    """Return headings, sentences and tables as Markdown; without pictures."""
    lines = [f"# {markdown(texts('page.title', cell=cell))}", "", made, ""]
    lines += [*(f"- {markdown(text)}" for text in light.lines), ""] if light else []
    for number, (key, section) in enumerate(sections.items(), start=1):
        lines += [f"## {number} {texts(f'{key}.title')}", ""]
        if section.get("headline"):
            lines += [f"**{markdown(section['headline'])}**", ""]
        for sentence in section.get("sentences", ()):
            lines += [markdown(sentence), ""]
        if key == "trust":
            lines += [f"**{texts('page.not_safety')}.** {texts('trust.statement')}", ""]
            lines += [f"- {name}: {markdown(value)}" for name, value in section["facts"]] + [""]
        for table in _tables(section):
            lines += _table(table)
        lines += [f"- {markdown(text)}" for text in section.get("warnings", ())]
    return "\n".join(lines).rstrip() + f"\n\n{MARK}\n"


def _tables(value: object) -> Iterator[ReportTable]:
    """Every table of a section, in its order."""
    if isinstance(value, ReportTable):
        yield value
    elif isinstance(value, Chart):
        yield from _tables([value.numbers, value.table, *value.more])
    elif isinstance(value, dict):
        for entry in value.values():
            yield from _tables(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from _tables(entry)


def _table(table: ReportTable) -> list[str]:
    lines = [f"### {markdown(table.title or table.caption)}", ""]
    if table.text:
        lines += [markdown(table.text), ""]
    if table.rows:
        lines.append("| " + " | ".join(map(markdown, table.heads)) + " |")
        lines.append("|" + "".join("---:|" if n in table.numeric else "---|" for n in range(len(table.heads))))
        lines += ["| " + " | ".join(map(markdown, row)) + " |" for row in table.rows] + [""]
    lines += [f"- {markdown(item)}" for item in table.items]
    return [*lines, "", markdown(table.after), ""] if table.after else [*lines, ""]
