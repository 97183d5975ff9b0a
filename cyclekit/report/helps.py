"""Section 4: what would help: the lower bound of any change, other orders, changes tried, where time is lost.

Every row is an estimate or a sum over the log. `tried` reads and holds the changes; `plan` gives the order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclekit.estimate.statistics.same_work import by_work
from cyclekit.report.answer import not_answered
from cyclekit.report.figures import charts_of
from cyclekit.report.findings import losses
from cyclekit.report.numbers import count, decimals_for, fixed, percent, seconds, with_uncertainty
from cyclekit.report.tables import ReportTable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import polars as pl

    from cyclekit.estimate.plan import OrderPlan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.findings import Overview
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts
    from cyclekit.report.tried import Tried


def section(page: PageInputs) -> dict[str, Any]:
    """Return what the template needs for section 4."""
    texts, ranked, tried, planned = page.texts, page.ranked, page.what_if, page.planned
    before = {each.name: each for each in ranked}
    said = (
        _bound(page),
        _best(texts, tried, ranked, before),
        _plan_saves(texts, planned),
        *(_order(texts, alike) for alike in by_work(ranked).values()),
    )
    sentences = [text for text in said if text]
    unanswered = {each.kind for each in page.refused}
    if not tried and "change" not in unanswered:
        sentences.append(texts("helps.not_asked"))
    if planned is None and "order" not in unanswered:
        sentences.append(texts("helps.not_planned"))
    refused = not_answered(page, "change", "order")
    made = (_what_if(texts, tried, before), _plan(texts, planned), refused, _moments(texts, page.samples, page.seen))
    return {"sentences": sentences, "charts": charts_of("helps", page), "tables": [table for table in made if table]}


def _bound(page: PageInputs) -> str:
    """The lower bound for any change of the safety function: the cycle without slow-down, and without known waits."""
    texts, seen = page.texts, page.seen
    if page.ranked:
        best = page.ranked[0]
        lost_s, wait_s = best.safety_loss_s, best.wait_s if page.coupled else 0.0
        values = {"name": best.name, "mean": seconds(best.expected_s), "lost": seconds(lost_s), "wait": seconds(wait_s)}
        without = seconds(best.expected_s - best.idle_s * (wait_s > 0.0) - lost_s - wait_s)
        return texts("helps.bound_waits" if wait_s > 0.0 else "helps.bound", without=without, **values)
    if seen.lost_s is None or not len(seen.duration_s):
        return ""
    wait_s = sum(waited for row, waited in page.waits if row.gate.agent == "robot")
    without = seconds(float(seen.duration_s.mean()) - seen.lost_s - wait_s)
    key = "helps.bound_logged_waits" if wait_s > 0.0 else "helps.bound_logged"
    return texts(key, without=without, lost=seconds(seen.lost_s), wait=seconds(wait_s))


def _order(texts: ReportTexts, ranked: Sequence[CycleEstimate]) -> str:
    """The saving of the order alone among sequences of the same work (fastest first), if it is clear."""
    if len(ranked) < 2:
        return ""
    best, last = ranked[0], ranked[-1]
    if last.expected_low_s <= best.expected_high_s:
        return texts("helps.order_even")
    half = max(best.expected_high_s - best.expected_low_s, last.expected_high_s - last.expected_low_s) / 2
    saved = fixed(last.expected_s - best.expected_s, decimals_for(half))
    return texts("helps.order", best=best.name, last=last.name, saved=saved)


def _best(
    texts: ReportTexts, tried: Sequence[Tried], ranked: Sequence[CycleEstimate], before: Mapping[str, CycleEstimate]
) -> str:
    """The change with the largest clear saving on one sequence: on the fastest one, where changes of it were tried."""
    names = [each.sequence for each in tried]
    of = next((each.name for each in ranked if each.name in names), names[0] if names else None)
    sure = [each for each in tried if each.sequence == of and each.surely_saves(before)]
    if not sure:
        return texts("helps.none_saves") if tried else ""
    best = max(sure, key=lambda each: (each.saves(before) or (0.0,))[0])
    saved, interval = _saved(best.saves(before))
    values = {"change": best.label, "name": best.sequence, "saved": f"{saved} s"}
    return texts("helps.best", **values, interval=interval and texts("helps.best_interval", interval=interval))


def _saved(saves: tuple[float, float | None, float | None] | None) -> tuple[str, str]:
    """A saving and its interval as text; without an interval an empty one."""
    if saves is None:
        return "–", ""
    mean, low, high = saves
    return (fixed(mean, 1), "") if low is None or high is None else with_uncertainty(mean, low, high)


def _what_if(texts: ReportTexts, tried: Sequence[Tried], before: Mapping[str, CycleEstimate]) -> ReportTable | None:
    if not tried:
        return None
    rows = []
    for each in tried:
        mean, interval = with_uncertainty(each.expected_s, each.low_s, each.high_s)
        saved, range_s = _saved(each.saves(before))
        support = percent(each.support) if each.support is not None else "–"
        rows.append([each.label, each.sequence, mean, interval, saved, range_s or "–", support])
    names = ("change", "sequence", "expected", "interval", "saved", "saved_interval", "support")
    used = [n for n in range(len(names)) if n < 5 or any(row[n] != "–" for row in rows)]
    heads, rows = [texts(f"helps.{names[n]}") for n in used], [[row[n] for n in used] for row in rows]
    title = texts("helps.what_if")
    items = _limits(tried)
    numeric = frozenset(range(2, len(used)))
    return ReportTable(
        title, heads, rows, numeric, silent=True, title=title, items=items, after=texts("helps.no_proof")
    )


def _limits(tried: Sequence[Tried]) -> list[str]:
    """Limits of each number; names the sequence if the limit does not hold for all of them."""
    found = []
    for each in tried:
        alike = [other for other in tried if other.label == each.label]
        for limit in each.limits:
            of_all = all(limit in other.limits for other in alike)
            found.append(f"{each.label}: {limit}" if of_all else f"{each.label}, {each.sequence}: {limit}")
    return list(dict.fromkeys(found))


def _plan_saves(texts: ReportTexts, planned: OrderPlan | None) -> str:
    """The saving of the best order found, as a sentence."""
    if planned is None:
        return ""
    saved, low, high = planned.saves_s
    if low <= 0:
        return texts("helps.plan_even")
    mean, interval = with_uncertainty(saved, low, high)
    against = texts("helps.against_logged" if planned.against == "logged orders" else "helps.against_random")
    return texts("helps.plan_saves", saved=mean, interval=interval, against=against)


def _plan(texts: ReportTexts, planned: OrderPlan | None) -> ReportTable | None:
    """The order found, its saving and the number of orders and executions compared."""
    if planned is None:
        return None
    saved, low, high = planned.saves_s
    both = bool(planned.operator)
    places = decimals_for((high - low) / 2)
    against = texts("helps.against_logged" if planned.against == "logged orders" else "helps.against_random")
    every = texts("helps.every_order" if planned.searched == "all orders" else "helps.some_orders")
    beside = texts("helps.plan_against_both" if both else "helps.plan_against", against=against)
    rows = [
        [texts("helps.plan_expected"), fixed(planned.expected_s, places)],
        [beside, fixed(planned.against_s, places)],
        [texts("helps.plan_saved"), f"{fixed(saved, places)} ({fixed(low, places)} to {fixed(high, places)})"],
        *([] if both else [[texts("helps.plan_unseen"), fixed(planned.saves_unseen_s, places)]]),
    ]
    jobs = any("->" in visit for visit in planned.order)
    title, order = texts("helps.plan"), (", " if jobs else " → ").join(map(texts.task, planned.order))
    of = {"tried": count(planned.tried), "executions": count(planned.executions)}
    rests = texts("helps.plan_rests_both" if both else "helps.plan_rests", searched=every, **of)
    heads = [texts("helps.figure"), texts("helps.seconds")]
    said = texts("helps.plan_order", order=order)
    if planned.operator:
        said = texts("helps.plan_orders", order=order, operator=" → ".join(map(texts.place, planned.operator)))
    return ReportTable(title, heads, rows, frozenset({1}), silent=True, title=title, text=said, after=rests)


def _moments(texts: ReportTexts, samples: pl.DataFrame, seen: Overview) -> ReportTable | None:
    """Time lost by operator task, with the robot task that lost most; None where no operator task is known."""
    found = losses(samples, seen.executions)
    if all(each.human_task is None for each in found):
        return None
    whole = seen.lost_s or sum(each.seconds for each in found)
    rows = [
        [
            texts("helps.unknown") if each.human_task is None else texts.task(each.human_task),
            fixed(each.seconds, 1),
            percent(each.seconds / whole) if whole else "–",
            texts(
                "helps.worst",
                task=texts.task(each.robot_task),
                seconds=fixed(each.worst_s, 1),
                share=percent(each.worst_s / each.seconds if each.seconds else None),
            ),
        ]
        for each in found
    ]
    heads = [texts(f"helps.{key}") for key in ("operator", "lost_head", "part", "robot")]
    title = texts("helps.moments")
    return ReportTable(title, heads, rows, frozenset({1, 2}), silent=True, title=title)
