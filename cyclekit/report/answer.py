"""Section 1: what a cycle takes, sequence by sequence, and how sure that is.

Numbers are rounded to their intervals; sequences that the logs cannot tell apart are said to be so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.report.numbers import decimals_for, fixed, percent, seconds, with_uncertainty
from cyclekit.report.pictures import picture
from cyclekit.report.tables import Table, spell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.findings import Overview
    from cyclekit.report.texts import Texts


def section(
    texts: Texts,
    ranked: Sequence[CycleEstimate],
    seen: Overview,
    *,
    has_model: bool,
    takt_s: float | None = None,
    checked: bool = False,
) -> dict[str, Any]:
    """Return what the template needs for section 1; `ranked` has the fastest first, `checked` by logged executions."""
    missing = [] if has_model else [texts("answer.no_model")]
    if not ranked:
        missing.insert(0, texts("answer.no_estimates"))
        return {**_logged(texts, seen, missing), "missing": missing}
    best = ranked[0]
    mean, interval = with_uncertainty(best.expected_s, best.expected_low_s, best.expected_high_s)
    sentences = [" ".join(_best(texts, best, interval))]
    tied = [each.name for each in ranked[1:] if each.expected_low_s <= best.expected_high_s]
    if tied:
        sentences.append(texts("answer.tied", names=", ".join(tied)))
    if takt_s is not None:
        share = percent(in_time(best, takt_s))
        sentences.append(texts("answer.takt", takt=fixed(takt_s, 1), share=share, tracks=str(len(best.durations_s))))
    return {
        "headline": texts("answer.best", name=best.name, mean=mean),
        "sentences": sentences + missing,
        "picture": _picture(texts, ranked, mean, takt_s),
        "caption": texts("answer.caption"),
        "table": _table(texts, ranked, takt_s),
        "interval_note": texts("answer.interval_checked" if checked else "answer.interval_tracks"),
        "warnings": [
            texts("answer.warning", name=each.name, text=warning) for each in ranked for warning in each.warnings
        ],
        "missing": missing,
    }


def in_time(estimate: CycleEstimate, takt_s: float) -> float | None:
    """Return the part of the single cycles that take no longer than the takt; None where there are none."""
    cycles = np.asarray(estimate.durations_s, dtype=np.float64)
    return float((cycles <= takt_s).mean()) if len(cycles) else None


def _best(texts: Texts, best: CycleEstimate, interval: str) -> list[str]:
    parts = [texts("answer.interval", interval=interval)]
    if len(best.quantiles_s) > 1:
        levels = sorted(best.quantiles_s)
        low, high = best.quantiles_s[levels[0]], best.quantiles_s[levels[-1]]
        places = min(1, decimals_for((high - low) / 2))
        share = percent(levels[-1] - levels[0])
        parts.append(texts("answer.cycles", share=share, low=fixed(low, places), high=fixed(high, places)))
    lost = percent(best.safety_loss_s / best.expected_s) if best.expected_s > 0 else percent(None)
    parts.append(texts("answer.split", safety=fixed(best.safety_loss_s, 1), percent=lost))
    worst = max(best.tasks, key=lambda task: task.safety_loss_s, default=None)
    if worst and worst.safety_loss_s > 0.05:
        parts.append(texts("answer.worst", task=spell(worst.task), loss=fixed(worst.safety_loss_s, 1)))
    return parts


def _logged(texts: Texts, seen: Overview, missing: Sequence[str]) -> dict[str, Any]:
    """The answer without estimates: the executions as they were."""
    found: dict[str, Any] = {"sentences": list(missing), "picture": None, "caption": "", "table": None, "warnings": []}
    durations = seen.duration_s
    if not len(durations):
        return {**found, "headline": texts("answer.no_executions")}
    mean = float(np.mean(durations))
    key = "answer.logged" if len(durations) > 1 else "answer.logged_one"
    facts = []
    if seen.lost_s is not None:
        facts.append(texts("answer.logged_lost", lost=seconds(seen.lost_s), percent=percent(seen.lost_s / mean)))
    if len(durations) > 1:
        low, high = seconds(float(durations.min())), seconds(float(durations.max()))
        facts.append(texts("answer.spread", low=low, high=high))
    found["sentences"] = ([" ".join(facts)] if facts else []) + list(missing)
    return {**found, "headline": texts(key, median=seconds(mean))}


def _picture(texts: Texts, ranked: Sequence[CycleEstimate], mean: str, takt_s: float | None) -> object:
    from cyclekit.report import charts

    labels = {
        "seconds": texts("answer.axis"),
        "mean": texts("answer.mean"),
        "cycles": texts.section("answer")["quantiles"],
        "without": texts("answer.without"),
        "tip": texts.section("answer")["tip"],
        "takt": texts("answer.takt_key", takt=fixed(takt_s, 1)),
    }
    alt = texts("answer.picture", count=len(ranked), name=ranked[0].name, mean=mean)
    return picture("cycle", alt, lambda width_in: charts.cycle_times(width_in, ranked, labels, takt_s))


def _table(texts: Texts, ranked: Sequence[CycleEstimate], takt_s: float | None) -> Table:
    levels = sorted(ranked[0].quantiles_s)
    heads = [
        texts("answer.sequence"),
        texts("answer.rank"),
        texts("answer.expected"),
        texts("answer.interval_head"),
        *(texts("answer.quantile_head", level=f"{100 * level:g}") for level in levels),
        *([texts("answer.takt_head", takt=fixed(takt_s, 1))] if takt_s is not None else []),
        texts("answer.safety_head"),
        texts("answer.support_head"),
    ]
    rows = []
    for rank, each in enumerate(ranked, start=1):
        mean, interval = with_uncertainty(each.expected_s, each.expected_low_s, each.expected_high_s)
        quantiles = [fixed(each.quantiles_s.get(level), 1) for level in levels]
        safety = fixed(each.safety_loss_s, 1)
        takt = [percent(in_time(each, takt_s))] if takt_s is not None else []
        rows.append([each.name, str(rank), mean, interval, *quantiles, *takt, safety, percent(each.support)])
    return Table(texts("answer.caption"), heads, rows, frozenset(range(1, len(heads))), silent=True)
