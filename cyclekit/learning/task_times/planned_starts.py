"""Tells agents who keep to planned starts from those who begin as soon as they can.

A planner writes a start for every task. Some cells hold a task until then; in others the plan tells only the order, and
what is done sooner lets the next task begin sooner: there, planned starts taken as earliest ones make cycles too long.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.task_times.starts import EARLY_PLAN_S, MAJORITY, MIN_DECIDED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.dataset.cards.task_model import TaskModelCard, TaskTimesCard
    from cyclekit.learning.task_times.runs import Run
    from cyclekit.schema import Vector

MIN_GIVEN = 3
"""Minimum number of planned starts in a plan of a planner."""


def starts_before_plan(runs: Sequence[Run]) -> dict[str, float]:
    """Return the agents who do not keep to planned starts, each with the share of its starts that came before.

    Only starts count whose agent was free before the planned start: the others tell nothing.

    Args:
        runs: Executions.
    """
    early: dict[str, list[bool]] = {}
    for run in runs:
        for agent, some in run.tasks.items():
            free_s = 0.0
            for done in some:
                least_s = done.planned_s - EARLY_PLAN_S
                if free_s < least_s:  # false where no plan is logged
                    early.setdefault(agent, []).append(done.start_s < least_s)
                free_s = done.end_s
    shares = {agent: float(np.mean(some)) for agent, some in early.items() if len(some) >= MIN_DECIDED}
    return {agent: round(share, 4) for agent, share in shares.items() if share > MAJORITY}


def earliest_s(
    model: TaskModelCard, tasks: Sequence[PlannedTask], cards: Sequence[TaskTimesCard], before: Sequence[int]
) -> Vector:
    """Return the earliest start of each task of a plan, shape (tasks,), s; 0 = none.

    A plan that gives every task a start, but for the first of an agent, is that of a planner. Its starts do not hold
    agents who do not keep to planned starts in the logs, except at tasks that do.

    Args:
        model: Learned task times.
        tasks: Tasks of all agents, in order for each agent.
        cards: What is known of each task.
        before: Number of the agent's previous task for each task; -1: it is the agent's first.
    """
    given = [task.not_before_s is not None for task in tasks]
    whole = sum(given) >= MIN_GIVEN and all(told or last < 0 for told, last in zip(given, before, strict=True))
    return np.array(
        [
            0.0 if whole and card.agent in model.before_plan and not card.planned else task.not_before_s or 0.0
            for task, card in zip(tasks, cards, strict=True)
        ]
    )
