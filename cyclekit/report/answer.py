"""Section 1: cycle time per sequence with its confidence interval.

Numbers are rounded to their intervals. Sequences with overlapping intervals are named; sequences of different work are
not ranked against each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.estimate.result import MAJORITY
from cyclekit.estimate.statistics.same_work import by_work
from cyclekit.report import verdict
from cyclekit.report.figures import charts_of
from cyclekit.report.tables import ReportTable
from cyclekit.report.tiles import tile_rows
from cyclekit.text.numbers import UNKNOWN, decimals_of, fixed, given, interval, percent, seconds, span
from cyclekit.text.plain_text import shown_task

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.statistics.same_work import Work
    from cyclekit.report.findings import Overview
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts

SURE = 0.975
"""A mean that is below another one in this part of the resampled logs is below it (95 %, both sides)."""


def _is_shorter(best: CycleEstimate, other: CycleEstimate) -> bool:
    """Return whether one mean is clearly below another: with the same operators, or else by their intervals."""
    odds = best.beats.get(other.name)
    return best.expected_high_s < other.expected_low_s if odds is None else odds >= SURE


def section(page: PageInputs) -> dict[str, Any]:
    """Return what the template needs for section 1."""
    texts, ranked, takt_s, found, best = page.texts, page.ranked, page.takt_s, page.verdict, page.best
    missing = [] if page.model is not None or page.unseen else [texts("answer.no_model")]
    headline = " ".join(text for each in page.verdicts if (text := verdict.in_words(texts, each)))
    said = {"headline": headline, "lead": [verdict.basis(texts, found)]} if found else {}
    if best is None:
        missing.insert(0, texts("answer.no_estimates"))
        logged = {**_logged(texts, page.seen, takt_s, missing), "charts": charts_of("answer", page)}
        if said.get("headline"):
            logged |= {"headline": said["headline"], "sentences": [*said["lead"], *logged["sentences"]]}
        return {**logged, "missing": missing}
    mean = fixed(best.expected_s, page.decimals)
    about = _best(texts, best, page.decimals)
    sentences = []
    works = by_work(ranked)
    same = next(work for work in works.values() if best in work)
    tied = [each.name for each in same if each is not best and not _is_shorter(best, each)]
    if tied:
        sentences.append(texts("answer.tied", names=", ".join(f"“{name}”" for name in tied), best=best.name))
    if len(works) > 1:
        sentences.append(texts("answer.works", count=len(works)))
    takt = (
        []
        if takt_s is None
        else [texts("answer.takt", name=best.name, takt=given(takt_s), share=_within(best, takt_s))]
    )
    of_tiles = [text for each in page.verdicts for text in verdict.beside_tiles(texts, each)]
    named = [f"“{best.name}”: {' '.join(about[1:])}"]
    return {
        "headline": said["headline"] if said else texts("answer.best", name=best.name, mean=mean),
        "tiles": tile_rows(texts, page.verdicts),
        "sentences": [*(said["lead"] if said else []), " ".join(about), *sentences, *takt, *missing],
        "beside": [*of_tiles, *named, *sentences, *missing],
        "charts": charts_of("answer", page),
        "table": _table(page, works),
        "refused": not_answered(page, "sequence"),
        "interval_note": texts("answer.interval_checked" if page.check is not None else "answer.interval_tracks"),
        "warnings": _warnings(texts, ranked),
        "missing": missing,
    }


def not_answered(page: PageInputs, *kinds: str) -> ReportTable | None:
    """Return the sequences, changes or order searches (`kinds`) that the logs cannot answer, with the reasons."""
    texts = page.texts
    rows = [[each.name, shown_task(each.why)] for each in page.refused if each.kind in kinds]
    title = texts("answer.refused")
    what = texts("answer.refused_sequence") if kinds == ("sequence",) else texts("answer.refused_change")
    heads = [what, texts("answer.refused_why")]
    return ReportTable(title, heads, rows, silent=True, title=title) if rows else None


def _caption(texts: ReportTexts, works: Mapping[Work, Sequence[CycleEstimate]]) -> str:
    return texts("answer.caption" if len(works) == 1 else "answer.caption_works")


def _within(one: CycleEstimate, takt_s: float) -> str:
    within = one.within(takt_s)
    return percent(None if within is None else within[0])


def _best(texts: ReportTexts, best: CycleEstimate, places: int) -> list[str]:
    mean, bounds = fixed(best.expected_s, places), interval(best.expected_low_s, best.expected_high_s, places)
    parts = [texts("answer.interval", name=best.name, mean=mean, interval=bounds)]
    if len(best.quantiles_s) > 1:
        levels = sorted(best.quantiles_s)
        low, high = best.quantiles_s[levels[0]], best.quantiles_s[levels[-1]]
        share = percent(levels[-1] - levels[0])
        parts.append(texts("answer.cycles", share=share, span=span(low, high, places)))
    lost = percent(best.safety_loss_s / best.expected_s) if best.expected_s > 0 else percent(None)
    parts.append(texts("answer.split", safety=fixed(best.safety_loss_s, places), percent=lost))
    worst = best.costliest_task
    if worst and worst[0].safety_loss_s > 0.05:
        key = "answer.worst_most" if worst[1] > MAJORITY else "answer.worst"
        loss = fixed(worst[0].safety_loss_s, places)
        parts.append(texts(key, task=texts.task(worst[0].task), loss=loss, share=percent(worst[1])))
    return parts


def _warnings(texts: ReportTexts, ranked: Sequence[CycleEstimate]) -> list[str]:
    """Return the limits that are not in the light, each sentence once with the names of its sequences."""
    names: dict[str, list[str]] = {}
    for each in ranked:
        for text in each.limits:
            names.setdefault(text, []).append(each.name)
    return [texts("answer.warning", name=", ".join(those), text=text) for text, those in names.items()]


def _logged(texts: ReportTexts, seen: Overview, takt_s: float | None, missing: Sequence[str]) -> dict[str, Any]:
    """The answer without estimates: the executions as they were."""
    found: dict[str, Any] = {"tiles": [], "sentences": list(missing), "table": None, "refused": None, "warnings": []}
    durations = seen.duration_s
    if not len(durations):
        return {**found, "headline": texts("answer.no_executions")}
    mean = float(np.mean(durations))
    key = "answer.logged" if len(durations) > 1 else "answer.logged_one"
    facts = []
    if seen.lost_s is not None:
        facts.append(texts("answer.logged_lost", lost=seconds(seen.lost_s), percent=percent(seen.lost_s / mean)))
    if len(durations) > 1:
        ends = float(durations.min()), float(durations.max())
        facts.append(texts("answer.spread", span=f"{span(*ends, decimals_of(*ends))} s"))
    if takt_s is not None:
        share = percent(float((durations > takt_s).mean()))
        facts.append(texts("answer.logged_takt", share=share, takt=given(takt_s)))
    found["sentences"] = ([" ".join(facts)] if facts else []) + list(missing)
    return {**found, "headline": texts(key, mean=seconds(mean))}


def _table(page: PageInputs, works: Mapping[Work, Sequence[CycleEstimate]]) -> ReportTable:
    """One row per sequence, ranked within its work; with several kinds of work also the time per visit."""
    several, texts, takt_s, places = len(works) > 1, page.texts, page.takt_s, page.decimals
    levels = sorted(next(iter(works.values()))[0].quantiles_s)
    heads = [
        texts("answer.sequence"),
        texts("answer.rank"),
        texts("answer.expected"),
        texts("answer.interval_head"),
        *(texts("answer.quantile_head", level=given(100 * level)) for level in levels),
        *([texts("answer.takt_head", takt=given(takt_s))] if takt_s is not None else []),
        texts("answer.safety_head"),
        texts("answer.support_head"),
        *((texts("answer.visits"), texts("answer.per_visit")) if several else ()),
    ]
    rows = []
    for each, rank in ((each, _rank(n, work, several)) for work in works.values() for n, each in enumerate(work, 1)):
        mean, bounds = fixed(each.expected_s, places), interval(each.expected_low_s, each.expected_high_s, places)
        quantiles = [fixed(each.quantiles_s.get(level), places) for level in levels]
        takt = [_within(each, takt_s)] if takt_s is not None else []
        visits = [str(len(each.places) - 1), fixed(each.per_visit_s, 2)] if several else []
        loss = fixed(each.safety_loss_s, places)
        rows.append([each.name, rank, mean, bounds, *quantiles, *takt, loss, percent(each.support), *visits])
    return ReportTable(_caption(texts, works), heads, rows, frozenset(range(1, len(heads))), silent=True)


def _rank(place: int, work: Sequence[CycleEstimate], several: bool) -> str:
    """The rank among the sequences of the same work; a dash where there is only one."""
    if not several:
        return str(place)
    return f"{place}/{len(work)}" if len(work) > 1 else UNKNOWN
