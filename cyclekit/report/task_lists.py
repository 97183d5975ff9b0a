"""The report of a model of task times: plans as time charts, who waits for what, and what task lists cannot tell."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version as installed
from typing import TYPE_CHECKING

from cyclekit.report.document import MARK
from cyclekit.report.figures.time_chart import MOST_SEQUENCES, alt_of, draw
from cyclekit.report.numbers import fixed, given, percent
from cyclekit.report.page import ReportFacts
from cyclekit.report.pictures import Picture
from cyclekit.report.template import Template
from cyclekit.report.tried import Tried
from cyclekit.report.verdict import basis, in_words, verdict
from cyclekit.storage.atomic import write_text
from cyclekit.text.plain_json import json_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.answers import CycleEstimates
    from cyclekit.estimate.plan.task_orders import TaskOrderPlan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.whatif.answer import WhatIf

PAGE = "tasks.html.jinja"
NOT_KNOWN = (
    "Task lists hold starts and ends alone. Nothing is known of positions, distances, zones and the safety function: "
    "this page does not say how near the operator comes to the robot, and no time in it is lost time of a safety "
    "system by name.",
    "What slows a task beside another one is learned as a rate, whatever the reason.",
)


@dataclass(frozen=True)
class Part:
    """One part of the page: sentences, a picture, and a table."""

    title: str
    sentences: Sequence[str] = ()
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    chart: Picture | None = None


def report_tasks(
    card: TaskModelCard,
    dataset: Dataset,
    out: Path,
    *,
    estimates: CycleEstimates | None = None,
    planned: TaskOrderPlan | None = None,
    changed: Sequence[WhatIf] = (),
    takt_s: float | None = None,
    baseline: str | None = None,
    kind: str = "html",
    template: Path | None = None,
    cell_name: str | None = None,
) -> ReportFacts:
    """Write the report of a model of task times.

    Args:
        card: What was learned.
        dataset: The logs that today's cycle is read from.
        out: File to write.
        estimates: Of plans, the order found among them.
        planned: The order found.
        changed: Plans under changes.
        takt_s: Takt time that the cycles are held against, s.
        baseline: Name of the plan that the others are held against; by default what was logged most.
        kind: `html`, `json`, `md`, or `csv` for the estimates alone.
        template: Folder whose style and words replace the page's own.
        cell_name: Title of the page; the dataset's name where not given.

    Raises:
        UnknownName: There is no plan of that name.
        CyclekitError: The file cannot be written.
    """
    look, found = Template(template), sorted(estimates or (), key=lambda one: one.expected_s)
    texts, tried = look.texts, [Tried.of(one, takt_s) for one in changed]
    held = verdict(dataset, found, tried, None, takt_s, baseline)
    parts = [*_ranking(found, takt_s), *_order(planned), *_changes(changed), _learned(card), _trust(card)]
    parts[1:1] = [_plan(one) for one in found]
    if found:
        drawn = found[:MOST_SEQUENCES]
        chart = Picture("timechart", alt_of(texts, drawn), partial(draw, drawn, takt_s))
        parts[0] = replace(parts[0], chart=chart)
    headline = in_words(texts, held) if held else f"{len(card.tasks)} tasks of {len(card.agents)} agents."
    said = [basis(texts, held)] if held else []
    name, today = cell_name or dataset.card.name or dataset.path.name, dt.datetime.now(tz=dt.UTC).date().isoformat()
    made = f"{today}, cyclekit {installed('cyclekit')}, {card.executions} executions"
    if kind == "csv":
        content = estimates.to_csv() if estimates else ""
    elif kind == "json":
        shown = [{key: value for key, value in vars(part).items() if key != "chart"} for part in parts]
        data = {"name": name, "headline": headline, "verdict": held.to_dict(headline) if held else None, "parts": shown}
        content = json_text(data | {"estimates": [one.to_dict() for one in found]}) + "\n"
    elif kind == "md":
        content = _markdown(name, made, [headline, *said], parts)
    else:
        texts_of = {"cell": name, "made": made, "headline": headline, "version": installed("cyclekit")}
        content = look.render(page=PAGE, said=said, parts=parts, **texts_of) + f"\n{MARK}\n"
    write_text(out, content)
    return ReportFacts(out, out.stat().st_size, headline, content.count("<figure>"), (NOT_KNOWN[0],), len(found))


def _ranking(found: Sequence[CycleEstimate], takt_s: float | None) -> list[Part]:
    heads = ["plan", "expected, s", "95 % CI, s", "90 % of cycles, s", "robot waits, s"]
    heads += [f"within {given(takt_s)} s"] if takt_s is not None else []
    rows = [
        [
            one.name,
            fixed(one.expected_s, 1),
            f"{fixed(one.expected_low_s, 1)} to {fixed(one.expected_high_s, 1)}",
            f"{fixed(min(one.quantiles_s.values()), 1)} to {fixed(max(one.quantiles_s.values()), 1)}",
            fixed(sum(task.wait_s for task in one.plan if task.kind == "robot"), 1),
            *([percent(one.takt_probability[0])] if one.takt_probability else []),
        ]
        for one in found
    ]
    return [Part("Plans", heads=heads, rows=rows)] if found else []


def _plan(one: CycleEstimate) -> Part:
    rows = []
    for task in sorted(one.plan, key=lambda task: task.start_s):
        cause = max(task.decided, key=lambda name: task.decided[name])
        waits = [fixed(task.wait_s, 1), f"{cause} ({percent(task.decided[cause])})"]
        rows.append([task.agent, task.task, fixed(task.start_s, 1), fixed(task.end_s, 1), *waits])
    return Part(one.name, heads=["agent", "task", "start, s", "end, s", "wait, s", "start decided by"], rows=rows)


def _order(planned: TaskOrderPlan | None) -> list[Part]:
    if planned is None:
        return []
    saved, low, high = planned.saves_s
    said = (
        f"The order found takes {fixed(planned.estimate.expected_s, 1)} s; {planned.against} take "
        f"{fixed(planned.against_s, 1)} s on average. It saves {fixed(saved, 1)} s ({fixed(low, 1)} to "
        f"{fixed(high, 1)} s, 95 %)."
    )
    return [Part("Order found", [said], ["agent", "task"], [[task.agent, task.name] for task in planned.tasks])]


def _changes(changed: Sequence[WhatIf]) -> list[Part]:
    rows = []
    for one in changed:
        saved, low, high = one.saves_s
        times = [fixed(one.before.expected_s, 1), fixed(one.after.expected_s, 1)]
        rows.append([one.change, one.after.name, *times, f"{fixed(saved, 1)} ({fixed(low, 1)} to {fixed(high, 1)})"])
    heads = ["change", "plan", "before, s", "after, s", "saves, s (95 %)"]
    return [Part("What if", heads=heads, rows=rows)] if rows else []


def _learned(card: TaskModelCard) -> Part:
    rows = []
    for task in card.tasks:
        beside = [f"{name} x{rate:.2f}" for name, rate in task.rates.items() if name and abs(rate - 1.0) > 0.1]
        waits = ", ".join(task.waits_for[1:]) or "-"
        rows.append(
            [task.agent, task.task, str(len(task.work_s)), fixed(task.usual_s, 1), waits, ", ".join(beside) or "-"]
        )
    drift = [f"{pace.said(agent)}." for agent, pace in card.pace.items()]
    heads = ["agent", "task", "times", "mean, s", "waits for", "speed beside other tasks"]
    return Part("Who waits for what", drift, heads, rows)


def _trust(card: TaskModelCard) -> Part:
    judged = card.held_out
    said = "Too few executions to validate the model on orders that were held out."
    if judged is not None:
        said = (
            f"Validated on {judged.orders} orders that were held out: mean cycle time {judged.bias:+.1%} off "
            f"(standard error {judged.within:.1%}), error of single orders beyond chance {judged.order_error:.1%}."
        )
    return Part("How reliable are these numbers?", [said, *NOT_KNOWN])


def _markdown(name: str, made: str, said: Sequence[str], parts: Sequence[Part]) -> str:
    lines = [f"# {name}", "", made, "", *(line for text in said for line in (text, ""))]
    for part in parts:
        lines += [f"## {part.title}", "", *(line for text in part.sentences for line in (text, ""))]
        if part.rows:
            table = [part.heads, ["---"] * len(part.heads), *part.rows]
            lines += [*(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in table), ""]
    return "\n".join(lines)
