"""The report of a model of task times: plans as time charts, who waits for what, and what task lists cannot tell."""

from __future__ import annotations

import base64
import datetime as dt
import tempfile
from dataclasses import dataclass
from importlib.metadata import version as installed
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.dataset.cards.task_model import DETAIL
from cyclekit.estimate.gantt import write_gantt
from cyclekit.report.document import MARK
from cyclekit.report.numbers import fixed, percent
from cyclekit.report.page import ReportFacts
from cyclekit.report.template import Template
from cyclekit.storage.atomic import write_text
from cyclekit.text.plain_json import json_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards.task_model import TaskModelCard
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
    """One part of the page: sentences, a picture as a data address, and a table."""

    title: str
    sentences: Sequence[str] = ()
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    chart: str = ""


def report_tasks(
    card: TaskModelCard,
    out: Path,
    *,
    name: str,
    estimates: CycleEstimates | None = None,
    planned: TaskOrderPlan | None = None,
    changed: Sequence[WhatIf] = (),
    kind: str = "html",
    template: Path | None = None,
) -> ReportFacts:
    """Write the report of a model of task times.

    Args:
        card: What was learned.
        out: File to write.
        name: Title of the page.
        estimates: Of plans.
        planned: The order found.
        changed: Plans under changes.
        kind: `html`, `json`, `md`, or `csv` for the estimates alone.
        template: Folder whose style replaces the page's own.

    Raises:
        CyclekitError: The file cannot be written.
    """
    found = [*(estimates or ()), *([planned.estimate] if planned else [])]
    parts = [*_ranking(found), *_order(planned), *_changes(changed), _learned(card), _trust(card)]
    plans = [_plan(one, kind == "html") for one in found]
    parts[1:1] = plans
    headline = _headline(card, found)
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    made = f"{today}, cyclekit {installed('cyclekit')}, {card.executions} executions"
    if kind == "csv":
        content = estimates.to_csv() if estimates else ""
    elif kind == "json":
        data = {"name": name, "headline": headline, "parts": [vars(part) for part in parts]}
        content = json_text(data | {"estimates": [one.to_dict() for one in found]}) + "\n"
    elif kind == "md":
        content = _markdown(name, made, headline, parts)
    else:
        look = Template(template)
        values = {"cell": name, "made": made, "headline": headline, "parts": parts, "version": installed("cyclekit")}
        content = look.render(page=PAGE, **values) + f"\n{MARK}\n"
    write_text(out, content)
    return ReportFacts(out, out.stat().st_size, headline, content.count("<figure>"), (NOT_KNOWN[0],), len(found))


def _headline(card: TaskModelCard, found: Sequence[CycleEstimate]) -> str:
    if not found:
        return f"{len(card.tasks)} tasks of {len(card.agents)} agents, learned from {card.executions} executions."
    best = min(found, key=lambda one: one.expected_s)
    interval = f"95 % CI {fixed(best.expected_low_s, 1)} to {fixed(best.expected_high_s, 1)} s"
    return f"Shortest of {len(found)}: {best.name}, expected cycle time {fixed(best.expected_s, 1)} s ({interval})."


def _ranking(found: Sequence[CycleEstimate]) -> list[Part]:
    heads = ["plan", "expected, s", "95 % CI, s", "90 % of cycles, s", "robot waits, s"]
    rows = [
        [
            one.name,
            fixed(one.expected_s, 1),
            f"{fixed(one.expected_low_s, 1)} to {fixed(one.expected_high_s, 1)}",
            f"{fixed(min(one.quantiles_s.values()), 1)} to {fixed(max(one.quantiles_s.values()), 1)}",
            fixed(sum(task.wait_s for task in one.plan if task.kind == "robot"), 1),
        ]
        for one in sorted(found, key=lambda one: one.expected_s)
    ]
    return [Part("Plans", heads=heads, rows=rows)] if found else []


def _plan(one: CycleEstimate, drawn: bool) -> Part:
    rows = []
    for task in sorted(one.plan, key=lambda task: task.start_s):
        cause = max(task.decided, key=lambda name: task.decided[name])
        waits = [fixed(task.wait_s, 1), f"{cause} ({percent(task.decided[cause])})"]
        rows.append([task.agent, task.task, fixed(task.start_s, 1), fixed(task.end_s, 1), *waits])
    heads = ["agent", "task", "start, s", "end, s", "wait, s", "start decided by"]
    return Part(one.name, heads=heads, rows=rows, chart=_chart(one) if drawn else "")


def _chart(one: CycleEstimate) -> str:
    """Return the time chart of a plan as a data address."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "chart.svg"
        write_gantt(file, [one])
        return f"data:image/svg+xml;base64,{base64.b64encode(file.read_bytes()).decode()}"


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
        rates = {name: rate for name, rate in task.rates.items() if name and DETAIL not in name}
        beside = [f"{name} x{rate:.2f}" for name, rate in rates.items() if abs(rate - 1.0) > 0.1]
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


def _markdown(name: str, made: str, headline: str, parts: Sequence[Part]) -> str:
    lines = [f"# {name}", "", made, "", headline, ""]
    for part in parts:
        lines += [f"## {part.title}", "", *(line for text in part.sentences for line in (text, ""))]
        if part.rows:
            table = [part.heads, ["---"] * len(part.heads), *part.rows]
            lines += [*(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in table), ""]
    return "\n".join(lines)
