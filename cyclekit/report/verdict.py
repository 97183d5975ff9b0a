"""The verdict: today's logged cycle time against the best order and change found for the same work.

"Today" is the mean of the logged executions of this work (of the usual order alone, if more than half ran it), or of
the sequence that was named for the baseline; only where that was never logged, its estimate. Like is compared with
like: "today" is at the operator's latest pace and rolled out with any operators, as estimates are; else what he
learned, or the error of the model, would count as a saving.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.errors import UnknownName
from cyclekit.estimate.baseline import baseline_of
from cyclekit.estimate.statistics.same_work import by_work, work_of
from cyclekit.text.numbers import (
    count,
    decimals_of,
    difference,
    fixed,
    given,
    interval,
    percent,
    percent_interval,
    signed_percent,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.baseline import Baseline
    from cyclekit.estimate.plan import OrderPlan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.statistics.same_work import Work
    from cyclekit.report.texts import ReportTexts
    from cyclekit.report.tried import Tried


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
        asked: The estimate of the fastest sequence that was asked for; None if it is today's order, or the one found.
    """

    work: Work
    takt_s: float | None
    today: Baseline | None
    planned: OrderPlan | None
    best: CycleEstimate | None
    change: Tried | None
    asked: CycleEstimate | None = None

    @property
    def order(self) -> OrderPlan | None:
        """The order found, unless a given sequence is faster."""
        given = (
            self.best is not None and self.planned is not None and self.best.places != self.planned.sequence("").places
        )
        return None if given else self.planned

    @property
    def expected_s(self) -> float | None:
        """Mean cycle time of the best order, s: from the estimate, otherwise from the search."""
        if self.best is not None:
            return self.best.expected_s
        return None if self.planned is None else self.planned.expected_s

    def to_dict(self, text: str) -> dict[str, object]:
        """Return plain JSON values; `text` is the verdict in words."""
        order, change = self.order, self.change
        best: dict[str, object] = {
            "sequence": None if order or not self.best else self.best.name,
            "expected_s": self.expected_s,
        }
        best |= {"within": self.within, "saves_s": None if self.own else self.saves_s(self.expected_s)}
        tried: dict[str, object] = {} if change is None else {"label": change.label, "sequence": change.sequence}
        return {
            "text": text,
            "work": vars(self.work),
            "takt_s": self.takt_s,
            "today": None if self.today is None else self.today.to_dict(),
            "best": None if self.expected_s is None else best | {"order": order and order.sequence("").places},
            "change": None if change is None else tried | _saving(self, change.expected_s) | {"within": change.within},
        }

    @property
    def apart(self) -> str:
        """Why the mean of today is not the logged one: `at_pace`, `rolled`; empty where both look alike."""
        today, places = self.today, self.decimals
        if today is None or today.as_logged_s is None:
            return ""
        if today.pace_share is not None:
            return "at_pace"
        return "rolled" if difference(today.mean_s, today.as_logged_s, places) else ""

    @property
    def decimals(self) -> int:
        """Number of decimals that its cycle times show."""
        others = [each.expected_s for each in (self.change, self.asked) if each is not None]
        return decimals_of(None if self.today is None else self.today.mean_s, self.expected_s, *others)

    @property
    def within(self) -> tuple[float, float, float] | None:
        """Share of the cycles of `best` within the takt, with its 95 % interval; None without either."""
        return self.share_within(self.best)

    def share_within(self, one: CycleEstimate | None) -> tuple[float, float, float] | None:
        """Return the share of the cycles of an estimate within the takt, with its 95 % interval; None if unknown."""
        return None if one is None or self.takt_s is None else one.within(self.takt_s)

    def is_todays(self, one: CycleEstimate) -> bool:
        """Return whether today's cycles are logged executions of this order: what it differs by is no saving."""
        return self.today is not None and self.today.is_own(one)

    @property
    def own(self) -> bool:
        """Whether the best order is today's own."""
        if self.best is not None:
            return self.is_todays(self.best)
        return self.planned is not None and not any(self.planned.saves_s)

    def saves_s(self, expected_s: float | None) -> float | None:
        """Return what a mean cycle time saves against today, s; None without a cycle of today."""
        return None if self.today is None or expected_s is None else self.today.mean_s - expected_s


def _saving(found: TaktVerdict, expected_s: float) -> dict[str, object]:
    return {"expected_s": expected_s, "saves_s": found.saves_s(expected_s)}


def verdict(
    dataset: Dataset,
    ranked: Sequence[CycleEstimate],
    tried: Sequence[Tried],
    planned: OrderPlan | None,
    takt_s: float | None,
    baseline: str | None = None,
) -> TaktVerdict | None:
    """Compare the results with today's cycle; None without sequences, an order search or changes.

    The compared work is that of the baseline that was named, or of the order found; otherwise of the first sequences
    whose work was logged.

    Args:
        dataset: The logs.
        ranked: Estimates, those of the same work together, the fastest first.
        tried: Sequences under changes.
        planned: The order found.
        takt_s: The takt time.
        baseline: Name of the sequence that the others are compared with; None: the logged executions.

    Raises:
        UnknownName: No sequence has that name.
    """
    named = next((each for each in ranked if each.name == baseline), None)
    if baseline is not None and named is None:
        raise UnknownName("the baseline", "sequence", baseline, [each.name for each in ranked])
    works = [work_of(planned.sequence("").places)] if planned else [*by_work(ranked)] or [*by_work(tried)]
    works = [work_of(named.places, named.operator)] if named else [work for work in works if work.visits]
    if not works:
        return None
    first = {work: some[0] for work, some in by_work(ranked).items()}
    logged = {work: _today_of(dataset, work, takt_s, named, first.get(work)) for work in works}
    work = next((work for work in works if logged[work] is not None), works[0])
    return _of_work(
        work, by_work(ranked).get(work, []), logged[work], planned, takt_s, best_change(work, ranked, tried)
    )


def others(
    dataset: Dataset, ranked: Sequence[CycleEstimate], tried: Sequence[Tried], main: TaktVerdict | None
) -> list[TaktVerdict]:
    """Return the verdicts on the other kinds of work that were asked for, beside the main one."""
    found = []
    for work, mine in by_work(ranked).items():
        if main is not None and work != main.work and work.visits:
            today = _today_of(dataset, work, main.takt_s, None, mine[0])
            found.append(_of_work(work, mine, today, None, main.takt_s, best_change(work, ranked, tried)))
    return found


def _of_work(
    work: Work,
    mine: Sequence[CycleEstimate],
    today: Baseline | None,
    planned: OrderPlan | None,
    takt_s: float | None,
    change: Tried | None,
) -> TaktVerdict:
    """Return the verdict on one kind of work, from its estimates, the fastest first."""
    known = [planned.sequence("").places if planned else None, today.order if today else None]
    asked = next((each for each in mine if each.places not in known), None)
    return TaktVerdict(work, takt_s, today, planned, mine[0] if mine else None, change, asked)


def _today_of(
    dataset: Dataset, work: Work, takt_s: float | None, named: CycleEstimate | None, estimate: CycleEstimate | None
) -> Baseline | None:
    """Return the logged cycle of a work as an estimate of that work has it: at the same pace, with any operators."""
    pace, check = (estimate.pace, estimate.check) if estimate else ((), None)
    found = baseline_of(dataset, work, takt_s, named, pace)
    return None if found is None else found.rolled_out(check)


def best_change(work: Work, ranked: Sequence[CycleEstimate], tried: Sequence[Tried]) -> Tried | None:
    """Return the fastest change for this work, among those that clearly save time."""
    before = {each.name: each for each in ranked}
    mine = by_work(tried).get(work, [])
    return min((each for each in mine if each.surely_saves(before)), key=lambda each: each.expected_s, default=None)


def in_words(texts: ReportTexts, found: TaktVerdict) -> str:
    """Return the verdict as one or two sentences."""
    return " ".join(part for part in (_today(texts, found), _found(texts, found)) if part)


_TODAY = {
    "": ("verdict.today", "verdict.today_single", "verdict.baseline"),
    "at_pace": ("verdict.today_at_pace", "verdict.today_single_at_pace", "verdict.baseline_at_pace"),
    "rolled": ("verdict.today_rolled", "verdict.today_single_rolled", "verdict.baseline_rolled"),
}
"""Texts of several executions, of one, and of a sequence that was named, by `TaktVerdict.apart`."""


def _today(texts: ReportTexts, found: TaktVerdict) -> str:
    today = found.today
    if today is None:
        return ""
    mean = fixed(today.mean_s, found.decimals)
    several, single, named = _TODAY[found.apart]
    key = named if today.sequence is not None else single if today.executions == 1 else several
    values = {"name": today.sequence, "executions": count(today.executions)}
    if found.apart:
        values["logged"] = fixed(today.as_logged_s, found.decimals)
    said = texts(key, mean=mean, **values)
    return f"{said}{_within(texts, 'verdict.within_takt', today.within, found.takt_s)}."


def _within(texts: ReportTexts, key: str, within: tuple[float, float, float] | None, takt_s: float | None) -> str:
    """Return the share of cycles within the takt and its interval, as the end of a sentence; empty without a takt."""
    if within is None or takt_s is None:
        return ""
    share, low, high = within
    return texts(key, share=percent(share), takt=given(takt_s), interval=percent_interval(low, high))


def _found(texts: ReportTexts, found: TaktVerdict) -> str:
    """The order found or the fastest sequence, and the best change, against today."""
    best, change, said = found.best, found.change, ""
    if found.order is not None:
        asked = _asked(texts, found)
        said = asked + texts("verdict.order_none")
        if found.order.saves_s[1] > 0 and found.expected_s is not None:
            said = asked + texts(
                "verdict.order", mean=_mean(found), change=against_today(texts, found, found.expected_s)
            )
            said += _within(texts, "verdict.within", found.within, found.takt_s)
    elif best is not None and found.today is not None and found.today.sequence == best.name:
        said = texts("verdict.none_faster")
    elif best is not None and found.is_todays(best):
        said = texts("verdict.todays", name=best.name, mean=_mean(found))
    elif best is not None:
        said = texts("verdict.sequence", name=best.name, mean=_mean(found), change=of_sequence(texts, found, best))
        said += _within(texts, "verdict.within", found.within, found.takt_s)
    if change is None:
        return f"{said}." if said else ""
    mean = fixed(change.expected_s, found.decimals)
    beside = against_today(texts, found, change.expected_s) + _within(
        texts, "verdict.within", change.within, found.takt_s
    )
    values = {"label": change.label, "mean": mean, "change": beside}
    if not said:
        return f"{texts('verdict.change_alone', name=change.sequence, **values)}."
    named = best.places if best else found.order.sequence("").places if found.order else ()
    if change.places == named:
        return f"{said}; {texts('verdict.with_change', **values)}."
    return f"{said}; {texts('verdict.with_change_of', name=change.sequence, **values)}."


def _asked(texts: ReportTexts, found: TaktVerdict) -> str:
    """The sequence that was asked for, as a sentence before the order found; empty without one."""
    if found.asked is None:
        return ""
    values = {"mean": fixed(found.asked.expected_s, found.decimals), "change": of_sequence(texts, found, found.asked)}
    return f"{texts('verdict.sequence', name=found.asked.name, **values)}. "


def _mean(found: TaktVerdict) -> str:
    """The mean of the best order."""
    return fixed(found.expected_s, found.decimals)


def _overlap(best: CycleEstimate, today: Baseline) -> bool:
    return best.expected_low_s <= today.high_s and today.low_s <= best.expected_high_s


def of_sequence(texts: ReportTexts, found: TaktVerdict, one: CycleEstimate) -> str:
    """The difference of a sequence from today, if it is clear; the end of a sentence."""
    if found.is_todays(one):
        return texts("verdict.own")
    if found.today is not None and _overlap(one, found.today):
        return texts("verdict.not_clear")
    return against_today(texts, found, one.expected_s)


def against_today(texts: ReportTexts, found: TaktVerdict, mean_s: float) -> str:
    """The difference from today, as `, 8.9 s less (−9 %)`; empty without a cycle of today."""
    if found.today is None:
        return ""
    saves_s = difference(found.today.mean_s, mean_s, found.decimals)
    if not saves_s:
        return texts("verdict.same")
    part = signed_percent(-saves_s / found.today.mean_s)
    return texts(
        "verdict.saves" if saves_s > 0 else "verdict.longer", seconds=fixed(abs(saves_s), found.decimals), part=part
    )


def beside_tiles(texts: ReportTexts, found: TaktVerdict) -> list[str]:
    """Return what the tiles of a verdict do not say: that nothing faster was found, or that nothing was logged."""
    said = []
    if found.today is None or not found.today.executions:
        said.append(basis(texts, found))
    if found.order is not None and found.order.saves_s[1] <= 0:
        said.append(f"{texts('verdict.order_none')}.")
    elif found.order is None and (
        found.own or (found.today and found.best and found.best.name == found.today.sequence)
    ):
        said.append(f"{texts('verdict.none_faster')}.")
    return said


def basis(texts: ReportTexts, found: TaktVerdict) -> str:
    """Return the numbers of today, or the statement that no logged execution does this work."""
    today = found.today
    if today is None:
        return texts("verdict.no_today", work=str(found.work))
    places = found.decimals
    mean, bounds = fixed(today.mean_s, places), interval(today.low_s, today.high_s, places)
    if not today.executions:
        return texts("verdict.estimated", name=today.sequence, mean=mean, interval=bounds)
    if today.executions == 1 and not found.apart:
        return texts("verdict.today_one", mean=mean)
    if today.executions == 1:
        logged = fixed(today.as_logged_s, places)
        key = "verdict.today_one_at_pace" if found.apart == "at_pace" else "verdict.today_one_rolled"
        return texts(key, mean=mean, interval=bounds, logged=logged)
    values = {"mean": mean, "interval": bounds, "executions": count(today.executions)}
    said = texts("verdict.basis_order" if today.order else "verdict.basis", **values)
    said += texts("verdict.basis_others", others=count(today.others)) if today.others else ""
    if found.apart == "rolled":
        said += texts("verdict.basis_rolled", logged=fixed(today.as_logged_s, places))
    if found.apart == "at_pace":
        said += texts("verdict.basis_pace", logged=fixed(today.as_logged_s, places), part=percent(today.pace_share))
    if today.missed is None or found.takt_s is None:
        return f"{said}."
    missed = {"missed": count(today.missed), "share": percent(today.missed_share), "takt": given(found.takt_s)}
    key = "verdict.basis_missed_at_pace" if found.apart == "at_pace" else "verdict.basis_missed"
    return f"{said}; {texts(key, **missed)}"
