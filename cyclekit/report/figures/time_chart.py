"""When robot and operator do what: a time chart of today's cycle and of each sequence, on a common time axis."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from cyclekit.config.sequences import PLAN
from cyclekit.estimate.baseline import logged_cycle, logged_order
from cyclekit.estimate.gantt import ALWAYS, SHOWN_S, blocks_of, legend_of
from cyclekit.plots.gantt import draw_blocks, height_in
from cyclekit.plots.style import tip
from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.findings import task_shares
from cyclekit.report.pictures import WIDE_IN, Picture
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import UNKNOWN, count, fixed, percent, span

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure as Drawn

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts

MAX_SEQUENCES = 4
"""Maximum number of sequences drawn; the others are in the tables."""
PAPER_IN = 4.5
"""Maximum height of a chart that is printed as a whole, inches."""
PARTS = ("nominal", "safety", "dwell", "wait")
_FIELDS = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
_WORDS = {
    "caption": "Mean times from the start of the cycle, on one time axis. Within a task the motion at full speed is "
    "drawn first, then the time that slow-down adds, in the colour of the mean speed. Hatched: wait; an arrow comes "
    "from what ended it, dotted where it did so in fewer than half of the cycles. "
    "A label is the number of the task and where it leads.",
    "course": "Line “tasks done”: expected course; its band holds {share} of the cycles.",
    "lane": "Operator: share of the cycles in which the operator is at each place or on the way to it.",
    "cut": "The cycle of a sequence of places ends when the robot is done: the operator’s tasks are cut there.",
    "picture": "Time chart of {count} cycles. {name}: {mean} s; largest safety loss at {task}, {loss} s.",
    "more": "{count} more are in the tables.",
    "today": "today, {executions} logged executions",
    "as_logged": "{executions} executions as logged, not at the latest pace",
    "one": "logged execution {name}",
    "split": "Mean split of one cycle, seconds",
    "tasks": "{name}: mean split per task, in order",
    "plan": "{name}: start, end and wait of each task",
    "cycle": "Cycle",
    "idle": "Until the operator is done, s",
    "number": "No.",
    "agent": "Agent",
    "task": "Task",
    "start": "Start, s",
    "end": "End, s",
    "band": "End in single cycles, s",
    "wait": "Wait before it, s",
    "ended": "Wait ended by",
    "rest": "{task}, continued",
    "ended_in": "{cause} (in {share} of the cycles)",
}


def _charts(page: PageInputs) -> Iterator[Chart]:
    texts, today = page.texts, _today(page)
    found = [*([today] if today else []), *page.ranked]
    if not found:
        return
    drawn = found[: MAX_SEQUENCES + bool(today)]
    caption = " ".join(_said(texts, drawn, len(found) - len(drawn)))
    tables = [_plan(texts, each) if each.plan else _tasks(texts, each) for each in found if each.tasks]
    if page.ranked:
        split = _split(texts, found)
    else:
        split, tables = _logged(texts, page), tables[:1]
    yield Chart(time_chart(texts, drawn, page.takt_s), caption, table=split, more=tables)


def time_chart(texts: ReportTexts, found: Sequence[CycleEstimate], takt_s: float | None) -> Picture:
    """Return the time chart of these cycles; on paper a high one is drawn cycle by cycle, so that it can break."""
    blocks, legend = blocks_of(found), legend_of(found, takt_s)
    whole = len(blocks) == 1 or height_in(blocks, legend, WIDE_IN) <= PAPER_IN
    paper = () if whole else tuple(partial(draw, found, takt_s, number=number) for number in range(len(blocks)))
    return Picture("timechart", _alt(texts, found), partial(draw, found, takt_s), paper)


def draw(found: Sequence[CycleEstimate], takt_s: float | None, width_in: float, *, number: int | None = None) -> Drawn:
    """Draw the time chart of these cycles, or of one of them on the same time axis; the first has the legend."""
    from matplotlib.figure import Figure as Drawn

    every, legend = blocks_of(found), legend_of(found, takt_s)
    blocks = every if number is None else every[number : number + 1]
    legend = {} if number else legend
    figure = Drawn(figsize=(width_in, height_in(blocks, legend, width_in)))
    draw_blocks(figure.add_subplot(), blocks, legend, takt_s, tip, like=every)
    return figure


def _alt(texts: ReportTexts, found: Sequence[CycleEstimate]) -> str:
    """Return the alternative text of the time chart of these cycles."""
    first = found[0]
    worst = max(first.tasks, key=lambda share: share.safety_loss_s, default=None)
    task, loss = (texts.task(worst.task), fixed(worst.safety_loss_s, 1)) if worst else (UNKNOWN, UNKNOWN)
    mean = fixed(first.expected_s, 1)
    return texts("time_chart.picture", count=len(found), name=first.name, mean=mean, task=task, loss=loss)


def _said(texts: ReportTexts, drawn: Sequence[CycleEstimate], left: int) -> Iterator[str]:
    yield texts("time_chart.caption")
    levels = sorted(drawn[-1].quantiles_s)
    if len(levels) > 1:
        yield texts("time_chart.course", share=percent(levels[-1] - levels[0]))
    if any(each.plan and each.operator and not each.asked for each in drawn):
        yield texts("time_chart.cut")
    if any(each.operator_at for each in drawn):
        yield texts("time_chart.lane")
    if left:
        yield texts("time_chart.more", count=left)


def _today(page: PageInputs) -> CycleEstimate | None:
    """Return today's cycle if its executions ran one order; without sequences a logged cycle."""
    today = page.verdict.today if page.verdict else None
    names = logged_order(page.dataset) if not page.ranked else today.names if today and today.order else ()
    if not names:
        return None
    key = "time_chart.as_logged" if today and today.as_logged_s is not None else "time_chart.today"
    key = "time_chart.one" if len(names) == 1 else key
    title = page.texts(key, name=names[0], executions=count(len(names)))
    both = today.order[:1] == (PLAN,) if today and today.order else page.coupled
    return logged_cycle(page.dataset, names, title, both=both)


def _heads(texts: ReportTexts) -> list[str]:
    return [*(f"{texts(f'where.{part}')}, s" for part in PARTS), texts("where.total")]


def _split(texts: ReportTexts, found: Sequence[CycleEstimate]) -> ReportTable:
    *parts, total = _heads(texts)
    idle = ["idle_s"] if any(each.idle_s > SHOWN_S for each in found) else []
    heads = [texts("time_chart.cycle"), *parts, *(texts("time_chart.idle") for _ in idle), total]
    fields = (*_FIELDS, *idle, "expected_s")
    rows = [[each.name, *(fixed(getattr(each, field), 1) for field in fields)] for each in found]
    return ReportTable(texts("time_chart.split"), heads, rows, frozenset(range(1, len(heads))))


def _tasks(texts: ReportTexts, each: CycleEstimate) -> ReportTable:
    heads = [texts("where.task"), texts("time_chart.number"), *_heads(texts)]
    heads += [texts("time_chart.end"), texts("time_chart.band")]
    rows, end_s = [], 0.0
    for number, share in enumerate(each.tasks, start=1):
        end_s += share.expected_s
        parts = [fixed(getattr(share, part), 1) for part in (*_FIELDS, "expected_s")]
        rows.append(
            [texts.task(share.task), str(number), *parts, fixed(end_s, 1), _band(share.end_low_s, share.end_high_s)]
        )
    caption = texts("time_chart.tasks", name=each.name)
    return ReportTable(caption, heads, rows, frozenset(range(1, len(heads))), silent=True)


def _band(low_s: float | None, high_s: float | None) -> str:
    return UNKNOWN if low_s is None or high_s is None else span(low_s, high_s, 1)


def _plan(texts: ReportTexts, each: CycleEstimate) -> ReportTable:
    heads = [texts(f"time_chart.{name}") for name in ("task", "agent", "start", "end", "band", "wait", "ended")]
    rows = []
    for task in each.plan:
        times = [fixed(task.start_s, 1), fixed(task.end_s, 1), _band(task.end_low_s, task.end_high_s)]
        cause, share = (task.ended_by if task.wait_s > SHOWN_S else None) or ("", 0.0)
        ended = texts.task(cause)
        ended = texts("time_chart.ended_in", cause=ended, share=percent(share)) if 0.0 < share < ALWAYS else ended
        name = texts.task(task.task)
        rows.append(
            [
                texts("time_chart.rest", task=name) if task.rest else name,
                task.agent,
                *times,
                fixed(task.wait_s, 1),
                ended,
            ]
        )
    caption = texts("time_chart.plan", name=each.name)
    return ReportTable(caption, heads, rows, frozenset((2, 3, 4, 5)), silent=True)


def _logged(texts: ReportTexts, page: PageInputs) -> ReportTable:
    """The mean split of every logged task, the costliest in safety loss first."""
    heads = [texts("where.task"), *_heads(texts), texts("where.seen")]
    rows = []
    for share in task_shares(page.tasks):
        parts = (share.nominal_s, share.safety_s, share.dwell_s, share.wait_s, share.total_s)
        rows.append([texts.task(share.name), *(fixed(part, 1) for part in parts), str(share.seen)])
    return ReportTable(texts("where.caption_logged"), heads, rows, frozenset(range(1, len(heads))))


TIME_CHART = Figure("time_chart", "where", _charts, _WORDS)
