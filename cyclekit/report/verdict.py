"""The verdict: today's logged cycle time against the best order and change found for the same work.

"Today" uses only the logged executions that did this work, never an estimate of an order that did not run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.estimate.resample import TOGETHER, resampled
from cyclekit.estimate.same_work import by_work, work_of
from cyclekit.report.numbers import count, fixed, given, percent, signed_percent, with_uncertainty

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.plan import OrderPlan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.same_work import Work
    from cyclekit.report.texts import ReportTexts
    from cyclekit.report.tried import Tried


@dataclass(frozen=True)
class Today:
    """The logged executions that did the work.

    Attributes:
        executions: Number of them.
        mean_s: Their mean cycle time.
        low_s, high_s: Its 95 % interval from resampling executions; both equal the mean for one execution.
        missed: Number of executions longer than the takt; None without a takt.
    """

    executions: int
    mean_s: float
    low_s: float
    high_s: float
    missed: int | None = None

    @property
    def missed_share(self) -> float | None:
        """Share of the executions longer than the takt."""
        return None if self.missed is None else self.missed / self.executions


@dataclass(frozen=True)
class TaktVerdict:
    """The first statement of the page.

    Attributes:
        work: The work whose cycle times are compared.
        takt_s: The takt time, if one was given.
        today: The logged cycle; None if no logged execution does this work.
        planned: The order found, if a search was made.
        best: The estimate of the fastest sequence of this work, if there is one.
        change: The fastest change of a sequence of this work, among those that clearly save time.
    """

    work: Work
    takt_s: float | None
    today: Today | None
    planned: OrderPlan | None
    best: CycleEstimate | None
    change: Tried | None

    @property
    def order(self) -> OrderPlan | None:
        """The order found, unless a given sequence is faster."""
        given = self.best is not None and self.planned is not None and self.best.places != self.planned.places
        return None if given else self.planned

    @property
    def expected_s(self) -> float | None:
        """Mean cycle time of the best order, s: from the estimate, otherwise from the search."""
        if self.best is not None:
            return self.best.expected_s
        return None if self.planned is None else self.planned.expected_s

    def to_dict(self, text: str) -> dict[str, Any]:
        """Return plain JSON values; `text` is the verdict in words."""
        order, change = self.order, self.change
        best = {"sequence": None if order or not self.best else self.best.name, "expected_s": self.expected_s}
        tried = {} if change is None else {"label": change.label, "sequence": change.sequence}
        return {
            "text": text,
            "work": vars(self.work),
            "takt_s": self.takt_s,
            "today": None if self.today is None else vars(self.today) | {"missed_share": self.today.missed_share},
            "best": None if self.expected_s is None else best | {"order": order and order.places},
            "change": None if change is None else tried | {"expected_s": change.expected_s},
        }


def verdict(
    dataset: Dataset,
    ranked: Sequence[CycleEstimate],
    tried: Sequence[Tried],
    planned: OrderPlan | None,
    takt_s: float | None,
) -> TaktVerdict | None:
    """Compare the results with today's cycle; None without a takt, an order search or changes.

    The compared work is that of the order found; otherwise of the first sequences whose work was logged.

    Args:
        dataset: The logs.
        ranked: Estimates, those of the same work together, the fastest first.
        tried: Sequences under changes.
        planned: The order found.
        takt_s: The takt time.
    """
    works = [work_of(planned.places)] if planned else [*by_work(ranked)] or [*by_work(tried)]
    works = [work for work in works if work.visits]
    if not works:
        return None
    logged = {work: today_of(dataset, work, takt_s) for work in works}
    work = next((work for work in works if logged[work] is not None), works[0])
    mine = by_work(ranked).get(work, [])
    return TaktVerdict(work, takt_s, logged[work], planned, mine[0] if mine else None, best_change(work, ranked, tried))


def today_of(dataset: Dataset, work: Work, takt_s: float | None) -> Today | None:
    """Return the logged executions that did this work, without reference runs (those without an operator)."""
    durations = dict(dataset.executions.filter("complete").select("execution", "duration_s").iter_rows())
    names = [
        one.execution
        for one in dataset.card.executions
        if one.execution in durations and not one.reference and work_of(one.places) == work
    ]
    if not names:
        return None
    cycles = np.array([durations[name] for name in names], dtype=np.float64)
    low, high = np.quantile(resampled(names, 0, together=min(TOGETHER, len(names))) @ cycles, (0.025, 0.975)).tolist()
    missed = None if takt_s is None else int((cycles > takt_s).sum())
    return Today(len(names), float(cycles.mean()), low, high, missed)


def best_change(work: Work, ranked: Sequence[CycleEstimate], tried: Sequence[Tried]) -> Tried | None:
    """Return the fastest change for this work, among those that clearly save time."""
    before = {each.name: each for each in ranked}
    mine = by_work(tried).get(work, [])
    return min((each for each in mine if each.surely_saves(before)), key=lambda each: each.expected_s, default=None)


def in_words(texts: ReportTexts, found: TaktVerdict) -> str:
    """Return the verdict as one or two sentences."""
    return " ".join(part for part in (_today(texts, found), _found(texts, found)) if part)


def _today(texts: ReportTexts, found: TaktVerdict) -> str:
    today, takt_s = found.today, found.takt_s
    if today is None:
        return ""
    mean, _ = with_uncertainty(today.mean_s, today.low_s, today.high_s)
    if today.missed_share is None or takt_s is None:
        return texts("verdict.today", mean=mean)
    return texts("verdict.today_takt", mean=mean, missed=percent(today.missed_share), takt=given(takt_s))


def _found(texts: ReportTexts, found: TaktVerdict) -> str:
    """The order found or the fastest sequence, and the best change, against today."""
    best, change, said = found.best, found.change, ""
    if found.order is not None:
        said = texts("verdict.order_none")
        if found.order.saves_s[1] > 0 and found.expected_s is not None:
            said = texts("verdict.order", mean=_mean(found), change=_beside(found, found.expected_s))
    elif best is not None:
        clear = found.today is None or not _overlap(best, found.today)
        beside = _beside(found, best.expected_s) if clear else texts("verdict.not_clear")
        said = texts("verdict.sequence", name=best.name, mean=_mean(found), change=beside)
    if change is None:
        return f"{said}." if said else ""
    mean, _ = with_uncertainty(change.expected_s, change.low_s, change.high_s)
    values = {"label": change.label, "mean": mean, "change": _beside(found, change.expected_s)}
    if not said:
        return f"{texts('verdict.change_alone', name=change.sequence, **values)}."
    named = best.places if best else found.order.places if found.order else ()
    if change.places == named:
        return f"{said}; {texts('verdict.with_change', **values)}."
    return f"{said}; {texts('verdict.with_change_of', name=change.sequence, **values)}."


def _mean(found: TaktVerdict) -> str:
    """The mean of the best order, rounded to its interval if it has one."""
    if found.best is None:
        return fixed(found.expected_s, 1)
    return with_uncertainty(found.best.expected_s, found.best.expected_low_s, found.best.expected_high_s)[0]


def _overlap(best: CycleEstimate, today: Today) -> bool:
    return best.expected_low_s <= today.high_s and today.low_s <= best.expected_high_s


def _beside(found: TaktVerdict, mean_s: float) -> str:
    """The difference from today, as ` (-9 %)`; empty without a cycle of today."""
    return "" if found.today is None else f" ({signed_percent(mean_s / found.today.mean_s - 1)})"


def basis(texts: ReportTexts, found: TaktVerdict) -> str:
    """Return the numbers of today, or the statement that no logged execution does this work."""
    today = found.today
    if today is None:
        return texts("verdict.no_today", work=str(found.work))
    mean, interval = with_uncertainty(today.mean_s, today.low_s, today.high_s)
    values = {"mean": mean, "interval": interval, "executions": count(today.executions)}
    if today.executions == 1:
        return texts("verdict.today_one", mean=fixed(today.mean_s, 1))
    if today.missed is None or found.takt_s is None:
        return texts("verdict.basis", **values)
    missed = {"missed": count(today.missed), "share": percent(today.missed_share), "takt": given(found.takt_s)}
    return texts("verdict.basis_takt", **values, **missed)
