"""Backtest on logged executions, support, and what to log next: tables of section 5."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.estimate.finding import doubts_of
from cyclekit.estimate.joint.check import JointCheck
from cyclekit.estimate.what_to_log import ENOUGH, WITHIN
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import compact, count, percent, signed_percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.validation.check import Check
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.texts import ReportTexts


def tables(texts: ReportTexts, ranked: Sequence[CycleEstimate], check: Check | None) -> list[ReportTable]:
    """Return the tables that have content."""
    found = (_rollout(texts, check) if check else None, _support(texts, ranked) if ranked else None)
    return [table for table in found if table is not None]


def _rollout(texts: ReportTexts, check: Check) -> ReportTable:
    wanted, both = percent(check.levels[1] - check.levels[0]), isinstance(check, JointCheck)
    unseen = {"rollout_coverage_unseen": check.coverage_held_out} if check.coverage_held_out is not None else {}
    covered = {} if check.coverage is None else {"rollout_coverage": check.coverage, **unseen}
    bias = "trust.rollout_bias_both" if both else "trust.rollout_bias"
    rows = [
        [texts("trust.rollout_count"), count(check.executions)],
        [texts("trust.rollout_unseen"), count(check.held_out)],
        [texts(bias), f"{signed_percent(check.own_bias, 2)} (± {percent(check.own_within, 2)})"],
        [texts("trust.rollout_corrected"), signed_percent(check.factor - 1, 2)],
        *([] if both else [[texts("trust.rollout_crossed"), signed_percent(check.crossed_bias, 2)]]),
        *([texts(f"trust.{key}", wanted=wanted), percent(part)] for key, part in covered.items()),
    ]
    heads, title = [texts("trust.metric"), texts("trust.value")], texts("trust.rollout")
    said = texts("trust.rollout_text")
    return ReportTable(
        title,
        heads,
        rows,
        frozenset({1}),
        silent=True,
        title=title,
        text=said,
        items=doubts_of(check.findings),
    )


def _support(texts: ReportTexts, ranked: Sequence[CycleEstimate]) -> ReportTable:
    rows = [
        [each.name, percent(each.support), count(each.executions), count(each.tracks), each.estimator]
        for each in ranked
    ]
    names = ("answer.sequence", "trust.support_part", "trust.support_executions", "trust.support_tracks")
    title = texts("trust.support")
    heads = [*(texts(name) for name in names), texts("trust.support_how")]
    return ReportTable(
        title, heads, rows, frozenset({1, 2, 3}), silent=True, title=title, text=texts("answer.support_note")
    )


def to_log(page: PageInputs) -> list[ReportTable]:
    """Return what to log next, as a list; none where the robot's tasks are not known."""
    texts, plan = page.texts, page.to_log
    if plan is None:
        return []
    lacking = [f"{text[0].upper()}{text[1:]}." for text in plan.in_words(texts.task)]
    lead = texts("trust.to_log_text" if lacking else "trust.to_log_none", most=ENOUGH, within=compact(100 * WITHIN))
    return [ReportTable(title=texts("trust.to_log"), text=lead, items=lacking)]
