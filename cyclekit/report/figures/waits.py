"""Who waits for whom: the learned wait conditions as a picture and a table, with the seconds they cost today."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.learning.coupling.words import WaitRow, habit_lines
from cyclekit.plots.style import tip
from cyclekit.plots.waits import WaitArrow, draw_waits, height_in
from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import count, fixed, percent, span

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure as Drawn

    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts

MIN_OTHER_S = 0.05
"""Minimum wait of the robot without a known reason that has a row of its own, s per execution."""
_WORDS = {
    "title": "Who waits for whom",
    "caption": "Waits of robot and operator, learned from {executions} logged executions. An arrow leads from what is "
    "waited for to who waits; the number, and the width of the arrow, is the time waited per logged execution.",
    "picture": "Who waits for whom. Longest wait: {longest}.",
    "robot": "robot",
    "operator": "operator",
    "signal": "operator or signal",
    "machine": "operator, signal or machine",
    "told": "{who} until {until}: {seconds} s waited per execution",
    "who": "Who waits",
    "until": "Until",
    "lag": "Lag, s",
    "band": "Lag, 5 to 95 %, s",
    "obeyed": "Obeyed",
    "had_to_wait": "Had to wait",
    "seconds": "Waited per execution, s",
    "other": "robot, elsewhere",
    "other_until": "not known",
    "note": "Lag: time from the event until who waits goes on; work that begins only with the event is part of it, and "
    "below 0 it is just before the event. "
    "Obeyed: share of the logged passages that came after the event. Had to wait: passages in which this event came "
    "last, and so decided when to go on.",
    "source": "{text}.",
}


def _charts(page: PageInputs) -> Iterator[Chart]:
    texts, card, waits = page.texts, page.coupling, page.waits
    if card is None or not waits:
        return
    alt = texts("waits.picture", longest=_told(texts, *max(waits, key=lambda each: each[1])))
    most_s = max(seconds for _, seconds in waits)
    arrows = [_arrow(texts, row, seconds, most_s) for row, seconds in waits]
    of = {"machine" if row.condition.agent == row.gate.agent else row.condition.agent for row, _ in waits}
    right = next((name for name in ("machine", "signal") if name in of), "operator")
    heads = texts("waits.robot"), texts(f"waits.{right}")

    def drawn(width_in: float) -> Drawn:
        from matplotlib.figure import Figure as Drawn

        figure = Drawn(figsize=(width_in, height_in(arrows)))
        draw_waits(figure.add_subplot(), arrows, heads, tip)
        return figure

    caption = texts("waits.caption", executions=count(card.executions))
    table = _table(page, [texts("waits.source", text=f"{line[:1].upper()}{line[1:]}") for line in habit_lines(card)])
    yield Chart(Picture("waits", alt, drawn), caption, title=texts("waits.title"), table=table)


def _told(texts: ReportTexts, row: WaitRow, seconds: float) -> str:
    return texts("waits.told", who=row.who, until=row.until, seconds=fixed(seconds, 1))


def _arrow(texts: ReportTexts, row: WaitRow, seconds: float, most_s: float) -> WaitArrow:
    gate, one = row.gate, row.condition
    of_place = one.place if one.agent == "signal" else texts.place(one.place)
    of_agent = "signal" if one.agent == gate.agent else one.agent  # its own last departure: a machine works there
    text, weight = f"{fixed(seconds, 1)} s", seconds / most_s if most_s > 0.0 else 0.0
    told = _told(texts, row, seconds)
    return WaitArrow(gate.agent, texts.place(gate.place), of_agent, of_place, text, weight, told)


def _table(page: PageInputs, lines: Sequence[str]) -> ReportTable:
    texts = page.texts
    names = ("who", "until", "lag", "band", "obeyed", "had_to_wait", "seconds")
    shown = [
        [row.who, row.until, fixed(row.lag_s[1], 1), span(row.lag_s[0], row.lag_s[2], 1),
         percent(row.condition.held), row.had_to_wait, fixed(seconds, 1)]
        for row, seconds in page.waits
    ]  # fmt: skip
    known_s = sum(seconds for row, seconds in page.waits if row.gate.agent == "robot")
    other_s = float(page.tasks["lost_wait_s"].sum()) / page.seen.executions - known_s
    if other_s > MIN_OTHER_S:
        shown.append([texts("waits.other"), texts("waits.other_until"), "", "", "", "", fixed(other_s, 1)])
    heads = [texts(f"waits.{name}") for name in names]
    after = " ".join([*lines, texts("waits.note")])
    return ReportTable(texts("waits.title"), heads, shown, frozenset(range(2, 7)), silent=True, after=after)


WAITS = Figure("waits", "where", _charts, _WORDS)
