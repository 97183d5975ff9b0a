"""The page of a fleet: cells ranked by time lost to safety, changes since last month, and cells that need a look.

Each cell links to its own report. The caller passes the figures; this module writes the sentences.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from importlib.metadata import version as installed
from typing import TYPE_CHECKING, Any

from cyclekit.report.numbers import fixed, percent
from cyclekit.report.template import Template

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.report.texts import Texts

FLEET_PAGE = "fleet.html.jinja"
OLD_DAYS = 7
"""A cell whose newest log is older than this needs a look: its logger may have stopped."""
MUCH_SET_ASIDE = 0.01
"""A cell with a larger share of rows set aside than this needs a look too."""


@dataclass(frozen=True)
class CellLine:
    """What is known of one cell.

    Attributes:
        name: Its name.
        figures: `executions`, `cycle_s`, `lost_s`, `lost_share`, `newest`, `set_aside_share`, `safety_changed`,
            `habits_changed`, `shifts`, `drift`, `model_doubt`; empty without a report. None in it = unknown.
        failed: Which stages failed and why.
        unread: Logs that could not be read, and why; empty if all were read.
        link: Path of its report, relative to the page; None without one.
    """

    name: str
    figures: Mapping[str, Any]
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
    ranked = sorted(cells, key=lambda cell: (-(cell.figures.get("lost_share") or -1.0), cell.name))
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
        rows=[_row(texts, rank, cell) for rank, cell in enumerate(ranked, start=1)],
    )


_HEADS = ("cell", "rank", "lost_head", "per_cycle", "cycle", "executions", "newest", "drift_head")


def _headline(texts: Texts, ranked: Sequence[CellLine], concerned: int) -> str:
    first = next((cell for cell in ranked if cell.figures.get("lost_share") is not None), None)
    said = texts("fleet.nothing_known") if first is None else texts(
        "fleet.most", name=first.name, share=percent(first.figures["lost_share"])
    )  # fmt: skip
    return f"{said} {texts('fleet.look_count' if concerned else 'fleet.look_none', count=concerned)}"


def _row(texts: Texts, rank: int, cell: CellLine) -> dict[str, Any]:
    known = cell.figures
    lost = known.get("lost_share")
    cells = [
        str(rank),
        texts("fleet.unknown") if lost is None else texts("fleet.minutes", minutes=fixed(60 * lost, 1)),
        fixed(known.get("lost_s"), 1),
        fixed(known.get("cycle_s"), 1),
        str(known.get("executions", 0)),
        str(known.get("newest") or texts("fleet.unknown")),
        _drift(texts, known),
    ]
    return {"name": cell.name, "link": cell.link, "cells": cells}


def _drift(texts: Texts, known: Mapping[str, Any]) -> str:
    if known.get("safety_changed") is None:
        return str(known.get("drift") or texts("fleet.unknown"))
    kinds = [kind for kind in ("safety", "habits") if known[f"{kind}_changed"]]
    if not kinds:
        return texts("fleet.no_drift")
    changes = ", ".join(texts(f"fleet.{kind}") for kind in kinds)
    return texts("fleet.drift", what=changes, shifts="; ".join(known["shifts"]))


def _worries(texts: Texts, cell: CellLine, today: dt.date) -> list[str]:
    """Return the reasons why a cell needs a look, one sentence each; empty if it needs none."""
    known, found = cell.figures, [texts("fleet.failed", why=why) for why in cell.failed]
    if cell.unread:
        found.append(texts("fleet.unread", why=cell.unread))
    if not known:
        return found or [texts("fleet.no_report")]
    newest = known.get("newest")
    if newest and (days := (today - dt.date.fromisoformat(newest)).days) > OLD_DAYS:
        found.append(texts("fleet.old", days=days, date=newest))
    if known["set_aside_share"] > MUCH_SET_ASIDE:
        found.append(texts("fleet.set_aside", share=percent(known["set_aside_share"])))
    if known["safety_changed"]:
        found.append(texts("fleet.changed", shifts="; ".join(known["shifts"])))
    if known.get("model_doubt"):
        found.append(texts("fleet.model", why=known["model_doubt"]))
    if known["lost_share"] is None:
        found.append(texts("fleet.no_scaling"))
    return found
