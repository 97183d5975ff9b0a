"""The page of a fleet: cells ranked by time lost to safety, changes since last month, and cells that need a look.

Each cell links to its own report. The caller passes the figures; this module writes the sentences.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from importlib.metadata import version as installed
from typing import TYPE_CHECKING

from cyclekit.ingest.validate.lost_rows import SAID
from cyclekit.report.fleet_months import months_picture
from cyclekit.report.template import Template
from cyclekit.text.numbers import count, fixed, percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import FiguresCard
    from cyclekit.report.texts import ReportTexts

FLEET_PAGE = "fleet.html.jinja"
OLD_DAYS = 7
"""A cell whose newest log is older than this needs a look: its logger may have stopped."""


@dataclass(frozen=True)
class CellLine:
    """What is known of one cell.

    Attributes:
        name: Its name.
        figures: Nothing in it is known where there is no report yet.
        failed: Which stages failed and why.
        unread: Logs that could not be read, and why; empty if all were read.
        link: Path of its report, relative to the page; None without one.
    """

    name: str
    figures: FiguresCard
    failed: Sequence[str] = ()
    unread: str = ""
    link: str | None = None


def fleet_page(name: str, cells: Sequence[CellLine], today: dt.date) -> str:
    """Return the page as one self-contained HTML document with links to the reports.

    Args:
        name: Name of the fleet.
        cells: Its cells, in any order.
        today: Date against which the age of logs is counted.
    """
    look = Template()
    texts = look.texts
    ranked = sorted(cells, key=lambda cell: (-(cell.figures.lost_share or -1.0), cell.name))
    worries = {cell.name: _worries(texts, cell, today) for cell in ranked}
    concerned = [cell for cell in ranked if worries[cell.name]]
    return look.render(
        page=FLEET_PAGE,
        name=name,
        version=installed("cyclekit"),
        made=texts("fleet.made", date=today.isoformat(), version=installed("cyclekit"), cells=len(cells)),
        headline=_headline(texts, ranked, len(concerned)),
        look=[{"name": cell.name, "link": cell.link, "why": worries[cell.name]} for cell in concerned],
        heads=[texts(f"fleet.{head}") for head in _HEADS],
        months=months_picture(texts, {cell.name: cell.figures.months for cell in ranked}),
        rows=[_row(texts, rank, cell) for rank, cell in enumerate(ranked, start=1)],
    )


_HEADS = ("cell", "rank", "lost_head", "per_cycle", "cycle", "executions", "newest", "drift_head")


def _headline(texts: ReportTexts, ranked: Sequence[CellLine], concerned: int) -> str:
    known = [(cell.name, cell.figures.lost_share) for cell in ranked if cell.figures.lost_share is not None]
    said = texts("fleet.nothing_known")
    if known:
        said = texts("fleet.most", name=known[0][0], share=percent(known[0][1]))
    key = {0: "fleet.look_none", 1: "fleet.look_one"}.get(concerned, "fleet.look_count")
    return f"{said} {texts(key, count=count(concerned))}"


def _row(texts: ReportTexts, rank: int, cell: CellLine) -> dict[str, object]:
    known = cell.figures
    lost = known.lost_share
    cells = [
        str(rank),
        texts("fleet.unknown") if lost is None else texts("fleet.minutes", minutes=fixed(60 * lost, 1)),
        fixed(known.lost_s, 1),
        fixed(known.cycle_s, 1),
        str(known.executions or 0),
        str(known.newest or texts("fleet.unknown")),
        _drift(texts, known),
    ]
    said = {"green": texts("fleet.green"), "amber": texts("fleet.amber"), "red": texts("fleet.red")}
    lamp = {"level": known.light, "said": said[known.light]} if known.light else None
    return {"name": cell.name, "link": cell.link, "cells": cells, "lamp": lamp}


def _drift(texts: ReportTexts, known: FiguresCard) -> str:
    if known.safety_changed is None:
        return known.drift or texts("fleet.unknown")
    changed = {"safety": known.safety_changed, "habits": known.habits_changed}
    kinds = [kind for kind, is_so in changed.items() if is_so]
    if not kinds:
        return texts("fleet.no_drift")
    changes = ", ".join(texts(f"fleet.{kind}") for kind in kinds)
    return texts("fleet.drift", what=changes, shifts="; ".join(known.shifts))


def _worries(texts: ReportTexts, cell: CellLine, today: dt.date) -> list[str]:
    """Return the reasons why a cell needs a look, one sentence each; empty if it needs none."""
    known, found = cell.figures, [texts("fleet.failed", why=_in_a_row(why)) for why in cell.failed]
    if cell.unread:
        found.append(texts("fleet.unread", why=_in_a_row(cell.unread)))
    if known.light == "red":
        found.append(texts("fleet.red_why", why="; ".join(known.light_why)))
    if known.light == "amber":
        found.append(texts("fleet.amber_why", why="; ".join(known.light_why)))
    if known.executions is None:
        return found or [texts("fleet.no_report")]
    if known.newest is not None and (days := (today - known.newest).days) > OLD_DAYS:
        found.append(texts("fleet.old", days=days, date=known.newest.isoformat()))
    if known.set_aside_share is not None and known.set_aside_share > SAID:
        found.append(texts("fleet.set_aside", share=percent(known.set_aside_share)))
    if known.safety_changed:
        found.append(texts("fleet.changed", shifts="; ".join(known.shifts)))
    if known.model_doubt:
        found.append(texts("fleet.model", why=known.model_doubt))
    if known.lost_share is None:
        found.append(texts("fleet.no_scaling"))
    return found


def _in_a_row(text: str) -> str:
    """Return the lines of an error as sentences in a row."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return " ".join(line if line[-1] in ".!?:" else f"{line}." for line in lines)
