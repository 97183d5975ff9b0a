"""Section 3: why the robot slows down: scaling against distance, and operator positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclekit.learning.rules.safety import RuleSafety, asks_signals
from cyclekit.learning.rules.words import field_rows, kind_of
from cyclekit.learning.rules.words import sentences as in_words
from cyclekit.report.figures import charts_of
from cyclekit.report.floor import has_robot
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import count, percent

if TYPE_CHECKING:
    import polars as pl

    from cyclekit.report.findings import LoggedResponse, Predicts
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts

EXPLAINS = 0.8
"""From this share of explained variance on, the page says that the safety function acts on distance."""


def section(page: PageInputs) -> dict[str, Any]:
    """Return what the template needs for section 3."""
    texts, seen, found = page.texts, page.seen, page.response
    missing = _missing(texts, page.samples, found)
    sentences: list[str] = []
    if seen.slowed == 0.0:
        sentences.append(texts("why.never"))
    elif seen.slowed is not None and seen.halted is not None:
        shares = {"slowed": percent(seen.slowed)} | ({"halted": percent(seen.halted)} if seen.halted else {})
        sentences.append(texts("why.slowed" if seen.halted else "why.slowed_only", **shares))
    unsound = [one.shown for one in page.basis if one.level != "green"]
    if found and unsound:  # what follows rests on the distance
        sentences.append(texts("why.unsound", reasons="; ".join(unsound)))
    elif found:
        sentences.append(texts("why.lead", samples=count(found.samples)))
        key = "why.distance_good" if found.explained >= EXPLAINS else "why.distance_bad"
        sentences.append(texts(key, percent=percent(found.explained)))
    if isinstance(page.answers, RuleSafety) and not (unsound and not asks_signals(page.answers.rule)):
        rule = page.answers.rule
        explained = f"{kind_of(rule)}, {percent(rule.explained, 1)} of held-out samples"
        sentences.append(texts("why.rule", verdict=explained, sentences="; ".join(in_words(rule))))
    shown = {"sentences": sentences + missing, "charts": charts_of("why", page), "missing": missing}
    return shown | {"tables": _fields(texts, page.answers)}


def _fields(texts: ReportTexts, answers: Predicts | None) -> list[ReportTable]:
    """Return which field slows the robot to which speed, and where on its path; empty without a rule on signals."""
    if not isinstance(answers, RuleSafety) or not asks_signals(answers.rule):
        return []
    names = "why.field_signal", "why.field_value", "why.field_tool", "why.field_speed"
    return [
        ReportTable(
            heads=[texts(name) for name in names],
            rows=field_rows(answers.rule),
            caption=texts("why.fields"),
            silent=True,
            title=texts("why.fields"),
            text=texts("why.fields_text"),
        )
    ]


def _missing(texts: ReportTexts, samples: pl.DataFrame, found: LoggedResponse | None) -> list[str]:
    missing = []
    if not samples["human_x_m"].count():
        missing.append(texts("why.no_operator"))
    if not has_robot(samples):
        missing.append(texts("why.no_robot"))
    elif not samples["scaling"].count():
        missing.append(texts("why.no_scaling"))
    if found is None and not missing:
        missing.append(texts("why.too_few"))
    return missing
