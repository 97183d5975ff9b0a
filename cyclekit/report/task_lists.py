"""The report of task lists: logged executions and plans as time charts, who waits for what, and what is not known."""

from __future__ import annotations

import datetime as dt
import re
from collections import Counter
from dataclasses import dataclass, replace
from importlib.metadata import version as installed
from itertools import zip_longest
from typing import TYPE_CHECKING

from cyclekit.estimate.baseline import listed_cycle, listed_cycles
from cyclekit.estimate.finding import light_of, merged
from cyclekit.learning.task_times.parts import ALONE
from cyclekit.report.document import MARK
from cyclekit.report.figures.time_chart import MAX_SEQUENCES, time_chart
from cyclekit.report.light import put_away, traffic_light
from cyclekit.report.page import ReportFacts
from cyclekit.report.pictures import Picture
from cyclekit.report.play import play_lists
from cyclekit.report.template import Template
from cyclekit.report.tiles import tile_rows
from cyclekit.report.tried import Tried
from cyclekit.report.verdict import basis, beside_tiles, in_words, others, verdict
from cyclekit.storage.atomic import write_text
from cyclekit.text.numbers import (
    UNKNOWN,
    count,
    counted,
    fixed,
    given,
    interval,
    percent,
    seconds,
    signed_percent,
    span,
)
from cyclekit.text.plain_json import json_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.answers import CycleEstimates, Refusal
    from cyclekit.estimate.baseline import Baseline
    from cyclekit.estimate.plan.task_orders import TaskOrderPlan
    from cyclekit.estimate.result import CycleEstimate, PlannedShare
    from cyclekit.estimate.whatif.answer import WhatIf
    from cyclekit.report.texts import ReportTexts

PAGE = "tasks.html.jinja"
UNCHANGED = 0.1
"""Speeds beside the other agent that differ less from that alone are not shown."""
NOT_KNOWN = (
    "Task lists hold only starts and ends. Positions, distances, zones and the safety function are unknown: this page "
    "does not show how near the operator comes to the robot, and attributes no lost time to the safety system.",
    "A task's slow-down during another one is learned as a rate, whatever the reason.",
)


NO_MODEL = (
    "No model was given: other plans are not estimated here, and who waits for what is unknown. "
    "Train one: cyclekit train DATASET --out MODEL"
)
_WHICH = {
    "most": "Mean times of the order that was run most.",
    "middle": "Every order was run once: the shortest, the median and the longest execution.",
}
_NUMBER = re.compile(rf"(over |under )?[-−]?\d|-$|{UNKNOWN}$")


@dataclass(frozen=True)
class Part:
    """One part of the page: sentences, a picture, and a table, which may be `folded`."""

    title: str
    sentences: Sequence[str] = ()
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    chart: Picture | None = None
    folded: bool = False

    @property
    def numeric(self) -> frozenset[int]:
        """Columns of numbers."""
        return frozenset(
            at for at in range(len(self.heads)) if all(_NUMBER.match(row[at]) for row in self.rows)
        )  # fmt: skip


def report_tasks(
    card: TaskModelCard | None,
    dataset: Dataset,
    out: Path,
    *,
    estimates: CycleEstimates | None = None,
    planned: TaskOrderPlan | None = None,
    changed: Sequence[WhatIf] = (),
    refused: Sequence[Refusal] = (),
    takt_s: float | None = None,
    baseline: str | None = None,
    kind: str = "html",
    template: Path | None = None,
    cell_name: str | None = None,
    play: bool = True,
) -> ReportFacts:
    """Write the report of task lists.

    Args:
        card: What a model of task times has learned; None for the logs alone.
        dataset: The logs that today's cycle is read from.
        out: File to write.
        estimates: Of plans, the order found among them.
        planned: The order found.
        changed: Plans under changes.
        refused: Plans, changes and an order search that the logs cannot answer, each with the reason.
        takt_s: Takt time that the cycles are held against, s.
        baseline: Name of the plan that the others are compared with; by default the logged executions.
        kind: `html`, `json`, `md`, or `csv` for the estimates alone.
        template: Folder whose style and words replace the page's own.
        cell_name: Title of the page; the dataset's name where not given.
        play: Let the reader of the HTML page try other orders of its plans.

    Raises:
        UnknownName: There is no plan of that name.
        CyclekitError: The file cannot be written.
    """
    look, found = Template(template), sorted(estimates or (), key=lambda one: one.expected_s)
    texts, tried = look.texts, [Tried.of(one, takt_s) for one in changed]
    held = verdict(dataset, found, tried, None, takt_s, baseline)
    today = _today(texts, dataset, held.today) if held else None
    missing = [NOT_KNOWN[0], *([] if card else [NO_MODEL])]
    played = play_lists(texts, card, found, takt_s) if play and card and kind == "html" else None
    missing += played.missing if played else ()
    parts = [*_ranking(found, takt_s), *(_plan(one) for one in found), *_not_answered(refused, "sequence")]
    parts += [*_order(planned), *_changes(changed), *_not_answered(refused, "change", "order")]
    if found:
        drawn = [*([today] if today else []), *found[:MAX_SEQUENCES]]
        parts[0] = replace(parts[0], chart=time_chart(texts, drawn, takt_s))
    parts += [] if found and today else _logged(texts, dataset, takt_s)
    parts += [*(_learned(card) if card else ()), _trust(card, missing)]
    verdicts = [held, *others(dataset, found, tried, held)] if held else []
    headline = " ".join(text for each in verdicts if (text := in_words(texts, each)))
    headline = headline if held else _logged_in_words(dataset, takt_s)
    said = [basis(texts, held)] if held else []
    beside = [text for each in verdicts for text in beside_tiles(texts, each)]
    basis_of = merged(one.findings for one in found)
    light = traffic_light(texts, basis_of, [(one.name, one.findings) for one in found])
    headline = put_away(texts, light, headline)
    name, date = cell_name or dataset.card.name or dataset.path.name, dt.datetime.now(tz=dt.UTC).date().isoformat()
    executions = card.executions if card else len(dataset.executions)
    made = f"{date}, cyclekit {installed('cyclekit')}, {executions} executions"
    if kind == "csv":
        content = estimates.to_csv() if estimates else ""
    elif kind == "json":
        shown = [{key: getattr(part, key) for key in ("title", "sentences", "heads", "rows")} for part in parts]
        data = {"name": name, "headline": headline, "verdict": held.to_dict(headline) if held else None, "parts": shown}
        data |= {"estimates": [one.to_dict() for one in found], "refused": [one.to_dict() for one in refused]}
        content = json_text(data | light_of(basis_of)) + "\n"
    elif kind == "md":
        content = _markdown(name, made, [*(light.lines if light else []), headline, *said], parts)
    else:
        texts_of = {"cell": name, "made": made, "headline": headline, "version": installed("cyclekit")}
        sections = [part for part in parts if part.chart or not part.folded]
        rows = [] if light is not None and light.level == "red" else tile_rows(texts, verdicts)
        content = look.render(
            page=PAGE,
            rows=rows,
            said=beside if rows else said,
            parts=parts,
            sections=sections,
            play=played,
            light=light,
            **texts_of,
        )
        content += f"\n{MARK}\n"
    write_text(out, content)
    size, pictures = out.stat().st_size, content.count("<figure")
    return ReportFacts(out, size, headline, pictures, tuple(missing), len(found), None, tuple(refused), basis_of)


def _today(texts: ReportTexts, dataset: Dataset, today: Baseline | None) -> CycleEstimate | None:
    """Return the logged cycle that the plans are compared with, if its executions ran one order."""
    if not today or not today.order or not today.executions:
        return None
    key = "time_chart.today" if today.as_logged_s is None else "time_chart.as_logged"
    return listed_cycle(dataset, today.names, texts(key, executions=count(today.executions)))


def _logged(texts: ReportTexts, dataset: Dataset, takt_s: float | None) -> list[Part]:
    """Return the logged executions as a time chart, with its numbers."""
    found = listed_cycles(dataset)
    rows = []
    for one in found.values():
        turn = Counter[str]()
        for task in one.plan:
            turn[task.agent] += 1
            times = [fixed(task.start_s, 1), fixed(task.end_s, 1), _ends(task), fixed(task.wait_s, 1)]
            rows.append([one.name, task.agent, str(turn[task.agent]), task.task, *times])
    heads = ["Cycle", "Agent", "No.", "Task", "Start, s", "End, s", "End in 90 % of cycles, s", "Wait, s"]
    said = next(text for which, text in _WHICH.items() if which in found) if found else ""
    chart = time_chart(texts, list(found.values()), takt_s) if found else None
    return [Part("Logged executions", [said], heads, rows, chart, folded=True)] if found else []


def _ends(task: PlannedShare) -> str:
    known = task.end_low_s is not None and task.end_high_s is not None
    return span(task.end_low_s, task.end_high_s, 1) if known else UNKNOWN


def _logged_in_words(dataset: Dataset, takt_s: float | None) -> str:
    cycles_s = dataset.executions.filter("complete")["duration_s"].to_list()
    tasks = dataset.every_task().select("agent", "agent_name", "task").unique()
    agents = counted(tasks.select("agent", "agent_name").n_unique(), "agent")
    listed = f"{counted(tasks.height, 'task')} of {agents}"
    if not cycles_s:
        return f"{listed}; no complete execution."
    mean, ends = fixed(sum(cycles_s) / len(cycles_s), 1), span(min(cycles_s), max(cycles_s), 1)
    many = f"{counted(len(cycles_s), 'logged execution')} {'takes' if len(cycles_s) == 1 else 'take'}"
    said = f"{many} {mean} s" + (f" on average ({ends} s)" if ends != mean else "")
    if takt_s is not None:
        within = sum(cycle_s <= takt_s for cycle_s in cycles_s) / len(cycles_s)
        said += f", {percent(within)} of them within the takt of {given(takt_s)} s"
    return f"{said}: {listed}."


def _ranking(found: Sequence[CycleEstimate], takt_s: float | None) -> list[Part]:
    heads = ["Plan", "Mean, s", "95 % CI, s", "90 % of cycles, s", "Robot waits, s"]
    heads += [f"Within {given(takt_s)} s"] if takt_s is not None else []
    rows = [
        [
            one.name,
            fixed(one.expected_s, 1),
            interval(one.expected_low_s, one.expected_high_s, 1),
            span(min(one.quantiles_s.values()), max(one.quantiles_s.values()), 1),
            fixed(sum(task.wait_s for task in one.plan if task.kind == "robot"), 1),
            *([percent(one.takt_probability[0])] if one.takt_probability else []),
        ]
        for one in found
    ]
    return [Part("Plans", heads=heads, rows=rows)] if found else []


def _not_answered(refused: Sequence[Refusal], *kinds: str) -> list[Part]:
    rows = [[one.name, one.why] for one in refused if one.kind in kinds]
    head = "Plan" if kinds == ("sequence",) else "Change"
    return [Part(f"{head}s not answered", heads=[head, "Reason"], rows=rows)] if rows else []


def _plan(one: CycleEstimate) -> Part:
    rows, turn = [], Counter[str]()
    for task in sorted(one.plan, key=lambda task: task.start_s):
        turn[task.agent] += 1
        cause = max(task.decided, key=lambda name: task.decided[name])
        waits = [fixed(task.wait_s, 1), f"{cause} ({percent(task.decided[cause])})"]
        named = [task.agent, str(turn[task.agent]), task.task]
        rows.append([*named, fixed(task.start_s, 1), fixed(task.end_s, 1), *waits])
    heads = ["Agent", "No.", "Task", "Start, s", "End, s", "Wait, s", "Starts after"]
    return Part(one.name, heads=heads, rows=rows, folded=True)


def _order(planned: TaskOrderPlan | None) -> list[Part]:
    if planned is None:
        return []
    expected_s = planned.estimate.expected_s
    said = (
        f"The order found takes {seconds(expected_s, planned.against_s)}; {planned.against} take "
        f"{seconds(planned.against_s, expected_s)} on average. It saves {planned.saving_in_words}."
    )
    agents = list(dict.fromkeys(task.agent for task in planned.tasks))
    lines = [[task.name for task in planned.tasks if task.agent == agent] for agent in agents]
    rows = [[str(number), *names] for number, names in enumerate(zip_longest(*lines, fillvalue=""), start=1)]
    return [Part("Order found", [said], ["No.", *agents], rows)]


def _changes(changed: Sequence[WhatIf]) -> list[Part]:
    rows = []
    for one in changed:
        times = [fixed(each.expected_s, one.decimals) for each in (one.before, one.after)]
        rows.append([one.change, one.after.name, *times, one.saving_in_words])
    heads = ["Change", "Plan", "Before, s", "After, s", "Saves, s (95 % CI)"]
    return [Part("What if", heads=heads, rows=rows)] if rows else []


def _learned(card: TaskModelCard) -> list[Part]:
    """Return who waits for what, and how fast tasks proceed beside those of the other agent."""
    rows = [
        [task.agent, task.task, str(len(task.work_s)), fixed(task.usual_s, 1), ", ".join(task.waits_for[1:]) or "-"]
        for task in card.tasks
    ]
    said = [f"{each}." for each in card.notices]
    waits = Part("Who waits for what", said, ["Agent", "Task", "Times", "Mean, s", "Waits for"], rows)
    return [waits, *_speeds(card)]


def _speeds(card: TaskModelCard) -> list[Part]:
    """Return the speed of each task during tasks of the other agent, and while he waits after them."""
    rows, two = [], len({task.agent for task in card.tasks}) == 2
    for task in card.tasks:
        alone = task.rates.get(ALONE, 1.0)
        waiting = {name: rate * alone for name, rate in task.waiting.items()}
        for name in dict.fromkeys((*task.rates, *waiting)):
            speeds = [task.rates.get(name), waiting.get(name)]
            shown = ["" if rate is None or abs(rate - 1.0) <= UNCHANGED else fixed(rate, 2) for rate in speeds]
            if name and any(shown):
                other = name.partition(": ")[2] if two else name  # the only other agent needs no name
                rows.append([task.agent, task.task, other, *(text or "-" for text in shown)])
    said = f"1.20: 1.2 times as fast as alone. Changes of less than {percent(UNCHANGED)} are left out."
    heads = ["Agent", "Task", "Other agent's task", "During it", "While waiting after it"]
    return [Part("Speed beside the other agent", [said], heads, rows)] if rows else []


def _trust(card: TaskModelCard | None, missing: Sequence[str]) -> Part:
    held_out = card.held_out if card else None
    said = "Too few executions to validate the model on orders that were held out."
    if held_out is not None:
        said = (
            f"Validated on {counted(held_out.orders, 'order')} that were held out: mean cycle time "
            f"{signed_percent(held_out.bias, 1)} off (standard error {percent(held_out.within, 1)}), "
            f"error of single orders beyond chance {percent(held_out.order_error, 1)}."
        )
    known = [said, *missing[:1], NOT_KNOWN[1], *missing[1:]] if card else missing
    return Part("How reliable are these numbers?", known)


def _markdown(name: str, made: str, said: Sequence[str], parts: Sequence[Part]) -> str:
    lines = [f"# {name}", "", made, "", *(line for text in said for line in (text, ""))]
    for part in parts:
        lines += [f"## {part.title}", "", *(line for text in part.sentences for line in (text, ""))]
        if part.rows:
            table = [part.heads, ["---"] * len(part.heads), *part.rows]
            lines += [*(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in table), ""]
    return "\n".join(lines)
