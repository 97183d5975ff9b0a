"""What the script needs to roll out plans of task lists: what was learned of each task, and what corrects results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.estimate.statistics.conformal import OUTSIDE, PRIOR, most_outside
from cyclekit.estimate.statistics.resample import Z95
from cyclekit.estimate.task_times import CYCLES, LEVELS, SURE_BIAS, widening
from cyclekit.learning.task_times.prepared import agent_of, prepared
from cyclekit.report.play.tables import SEED, interludes_told

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards.task_model import NeedCard, PartsCard, TaskModelCard
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.play.tables import Arrays, Tables

FIELDS = (
    "agent", "task", "usual_s", "rates", "later", "waiting", "nth", "nth_waiting", "position", "position_waiting",
    "at_start", "after", "turns", "own_position",
    "lag_after_s",
)  # fmt: skip
PACES = (0.8, 1.5)
"""Minimum and maximum factor on the speed of an agent."""


def tables_of_lists(card: TaskModelCard, shown: Sequence[CycleEstimate], takt_s: float | None) -> Tables:
    """Return facts (plain JSON values) and arrays of plans.

    Args:
        card: What was learned from task lists.
        shown: Estimates of plans.
        takt_s: Takt time, s.
    """
    judged, first = card.held_out, 0
    tasks, values = [], list[float]()
    for task in card.tasks:
        fields = {name: getattr(task, name) for name in FIELDS}
        fields["joint"] = task.joint and {name: getattr(task.joint, name) for name in ("agent", "task", "starts")}
        found = {**fields, "needs": [_need(need) for need in task.needs], "first": first, "work": len(task.work_s)}
        counts = {"lags": len(task.lags_s), "need_lags": len(task.need_lags_s)}
        tasks.append({**found, **counts, "parts": task.parts and _parts(task.parts)})
        parts = (task.parts.first_s, task.parts.gap_s) if task.parts else ()
        values += [value for some in (task.work_s, task.lags_s, task.need_lags_s, *parts) for value in sorted(some)]
        first = len(values)
    arrays: Arrays = {"values": np.array(values, np.float32)}
    if judged is not None:
        arrays["deviations"] = np.array(judged.deviations, np.float32)
    names = ("bias", "within", "order_error", "learning_error")
    facts = {
        "kind": "list",
        "seed": SEED,
        "cycles": CYCLES,
        "levels": LEVELS.tolist(),
        "widening": widening(judged),
        "prior": PRIOR,
        "outside": OUTSIDE,
        "most_outside": 0 if judged is None else most_outside(len(judged.deviations)),
        "pace_errors": {agent: pace.error for agent, pace in card.pace.items()},
        "sure": Z95,
        "sure_bias": SURE_BIAS,
        "takt_s": takt_s,
        "labels": {},
        "agents": dict(card.agents),
        "tasks": tasks,
        "sequences": [_plan(card, each) for each in shown],
        "executions": card.executions,
        "check": None if judged is None else {name: getattr(judged, name) for name in names},
        "paces": PACES,
        "interludes": interludes_told(card.interludes),
    }
    return facts, arrays


def _need(need: NeedCard) -> dict[str, Any]:
    return {name: getattr(need, name) for name in ("agent", "task", "back", "after_s", "needed", "together")}


def _parts(parts: PartsCard) -> dict[str, int]:
    return {"first": len(parts.first_s), "gaps": len(parts.gap_s), "buffer": parts.buffer}


def _plan(card: TaskModelCard, each: CycleEstimate) -> dict[str, Any]:
    """Return the tasks of a plan, each with its agent as named in the logs and in the plan.

    Planned starts that hold nobody are left out.
    """
    earliest_s = prepared(card, each.asked, each.name).not_before_s.tolist()
    tasks = [
        {"agent": agent_of(card, task, each.name), "asked": task.agent, "name": task.name, "after": task.after}
        | ({"not_before_s": start_s} if start_s else {})
        for task, start_s in zip(each.asked, earliest_s, strict=True)
    ]
    return {"name": each.name, "tasks": tasks}
