"""Section 4: what would help: the lower bound of any change, other orders, changes tried, where time is lost.

Every row is an estimate or a sum over the log. `tried` reads and holds the changes; `plan` gives the order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclekit.estimate.baseline import LOGGED
from cyclekit.estimate.statistics.same_work import by_work
from cyclekit.report.answer import not_answered
from cyclekit.report.figures import charts_of
from cyclekit.report.findings import losses
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import UNKNOWN, count, difference, fixed, interval, percent, seconds

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
        _best(page, before),
        _plan_saves(page),
        *(_order(texts, alike, page.decimals) for alike in by_work(ranked).values()),
    )
    sentences = [text for text in said if text]
    unanswered = {each.kind for each in page.refused}
    if not tried and "change" not in unanswered:
        sentences.append(texts("helps.not_asked"))
    if planned is None and "order" not in unanswered:
        sentences.append(texts("helps.not_planned"))
    refused = not_answered(page, "change", "order")
    made = (_what_if(page, before), _plan(page), refused, _moments(texts, page.samples, page.seen))
    return {"sentences": sentences, "charts": charts_of("helps", page), "tables": [table for table in made if table]}


def _bound(page: PageInputs) -> str:
    """The lower bound for any change of the safety function: the cycle without slow-down, and without known waits."""
    texts, seen = page.texts, page.seen
    if page.ranked:
        best = page.ranked[0]
        lost_s, wait_s = best.safety_loss_s, best.wait_s if page.coupled else 0.0
        without_s = best.expected_s - best.idle_s * (wait_s > 0.0) - lost_s - wait_s
        times_s = {"mean": best.expected_s, "lost": lost_s, "wait": wait_s, "without": without_s}
        values = {"name": best.name, **{name: seconds(each, best.expected_s) for name, each in times_s.items()}}
        return texts("helps.bound_waits" if wait_s > 0.0 else "helps.bound", **values)
    if seen.lost_s is None or not len(seen.duration_s):
        return ""
    wait_s = sum(waited for row, waited in page.waits if row.gate.agent == "robot")
    without = seconds(float(seen.duration_s.mean()) - seen.lost_s - wait_s)
    key = "helps.bound_logged_waits" if wait_s > 0.0 else "helps.bound_logged"
    return texts(key, without=without, lost=seconds(seen.lost_s), wait=seconds(wait_s))


def _order(texts: ReportTexts, ranked: Sequence[CycleEstimate], places: int) -> str:
    """The saving of the order alone among sequences of the same work (fastest first), if it is clear."""
    if len(ranked) < 2:
        return ""
    best, last = ranked[0], ranked[-1]
    if last.expected_low_s <= best.expected_high_s:
        return texts("helps.order_even")
    saved = fixed(difference(last.expected_s, best.expected_s, places), places)
    return texts("helps.order", best=best.name, last=last.name, saved=saved)


def _best(page: PageInputs, before: Mapping[str, CycleEstimate]) -> str:
    """The change with the largest clear saving on one sequence: on the fastest one, where changes of it were tried."""
    texts, tried = page.texts, page.what_if
    names = [each.sequence for each in tried]
    of = next((each.name for each in page.ranked if each.name in names), names[0] if names else None)
    sure = [each for each in tried if each.sequence == of and each.surely_saves(before)]
    if not sure:
        return texts("helps.none_saves") if tried else ""
    best = max(sure, key=lambda each: (each.saves(before) or (0.0,))[0])
    saved, bounds = _saved(best, before, page.decimals)
    values = {"change": best.label, "name": best.sequence, "saved": f"{saved} s"}
    return texts("helps.best", **values, interval=bounds and texts("helps.best_interval", interval=bounds))


def _saved(tried: Tried, before: Mapping[str, CycleEstimate], places: int) -> tuple[str, str]:
    """A saving, as the cycle times shown differ, and its interval; without an interval an empty one."""
    found = tried.saves(before)
    if found is None:
        return UNKNOWN, ""
    mean, low, high = found
    saved = fixed(difference(tried.expected_s + mean, tried.expected_s, places), places)
    return saved, "" if low is None or high is None else interval(low, high, places)


def _what_if(page: PageInputs, before: Mapping[str, CycleEstimate]) -> ReportTable | None:
    texts, tried, places = page.texts, page.what_if, page.decimals
    if not tried:
        return None
    rows = []
    for each in tried:
        saved, range_s = _saved(each, before, places)
        mean, bounds = fixed(each.expected_s, places), interval(each.low_s, each.high_s, places)
        rows.append([each.label, each.sequence, mean, bounds, saved, range_s or UNKNOWN, percent(each.support)])
    names = ("change", "sequence", "expected", "interval", "saved", "saved_interval", "support")
    used = [n for n in range(len(names)) if n < 5 or any(row[n] != UNKNOWN for row in rows)]
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


def _plan_saves(page: PageInputs) -> str:
    """The saving of the best order found, as a sentence."""
    texts, planned, places = page.texts, page.planned, page.decimals
    if planned is None:
        return ""
    if planned.saves_s[1] <= 0:
        return texts("helps.plan_even")
    values = {"saved": _planned_saving(planned, places), "interval": interval(*planned.saves_s[1:], places)}
    return texts("helps.plan_saves", **values, against=_against(texts, planned))


def _planned_saving(planned: OrderPlan, places: int) -> str:
    """The saving of the order found, as the two cycle times shown differ."""
    return fixed(difference(planned.against_s, planned.expected_s, places), places)


def _against(texts: ReportTexts, planned: OrderPlan) -> str:
    return texts("helps.against_logged" if planned.against == LOGGED else "helps.against_random")


def _plan(page: PageInputs) -> ReportTable | None:
    """The order found, its saving and the number of orders and executions compared."""
    texts, planned, places = page.texts, page.planned, page.decimals
    if planned is None:
        return None
    both, against = bool(planned.operator), _against(texts, planned)
    every = texts("helps.every_order" if planned.searched == "all orders" else "helps.some_orders")
    beside = texts("helps.plan_against", against=against)
    rows = [
        [texts("helps.plan_expected"), fixed(planned.expected_s, places)],
        [beside, fixed(planned.against_s, places)],
    ]
    if any(planned.saves_s):
        saved = f"{_planned_saving(planned, places)} ({interval(*planned.saves_s[1:], places)})"
        rows.append([texts("helps.plan_saved"), saved])
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
            percent(each.seconds / whole) if whole else UNKNOWN,
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
