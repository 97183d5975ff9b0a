"""Changes of a cell known only by task lists: a faster agent, a removed wait, parts in advance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.errors import EstimateError, UnknownName
from cyclekit.estimate.statistics.resample import Z95
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.estimate.whatif.answer import WhatIf

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.cards.task_model import TaskModelCard, TaskTimesCard
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.whatif.change import Change
    from cyclekit.schema import Progress

PART = "part"
"""What a task waits for whose parts come by themselves, in `no_wait`."""


def what_if_tasks(
    model: TaskModelCard,
    sequences: Sequence[TaskSequence],
    changes: Sequence[Change],
    *,
    seed: int = 0,
    refused: Callable[[TaskSequence | Change, EstimateError], None],
    progress: Progress | None = None,
) -> list[WhatIf]:
    """Estimate every plan in the unchanged cell and under every change.

    Args:
        model: Task times learned from task lists.
        sequences: Plans for both agents.
        changes: Changes, each applied alone.
        seed: Seed of the draws; the same before and after.
        refused: Called with each plan that has no answer in the unchanged cell, and each change that has none, and the
            reason.
        progress: Called with the fraction done and a text.
    """
    before = _estimates(model, sequences, seed, refused)
    answered = [plan for plan in sequences if plan.name in before]
    answers = []
    for number, change in enumerate(changes if answered else (), 1):
        if progress:
            progress(number / (len(changes) + 1), change.name)

        def refuse(_: TaskSequence, error: EstimateError, change: Change = change) -> None:
            refused(change, error)

        try:
            after = _estimates(altered_times(model, change), answered, seed, refuse)
        except UnknownName as error:
            refused(change, EstimateError(error.seen, nearest=error.nearest, cure=error.cure))
        except EstimateError as error:
            refused(change, error)
        else:
            answers += [
                WhatIf(change.name, before[name], after[name], _saved(before[name], after[name])) for name in after
            ]
    return answers


def altered_times(model: TaskModelCard, change: Change) -> TaskModelCard:
    """Return the model after a change.

    Raises:
        EstimateError: The change is of positions or of the safety function, which task lists do not hold.
        UnknownName: An agent, a task or a wait is not in the model.
    """
    where = f"change {change.name!r}"
    if change.more_places or change.without_waits:
        cure = 'Give buffer = { TASK = 1 } for a second fixture, no_wait = [["TASK", "OTHER"]] for a removed wait.'
        raise EstimateError(f"{where}: more_places and without_waits are for cells with positions", cure=cure)
    if not change.of_tasks:
        msg = f"{where}: changes positions or the safety function, and task lists hold neither"
        raise EstimateError(msg, cure="Ask for faster, no_wait or buffer; or ingest the robot's log and the positions.")
    for agent in change.faster:
        if agent not in {*model.agents, *model.agents.values()}:
            raise UnknownName(where, "agent in faster", agent, {*model.agents, *model.agents.values()})
    waits = {(task.task, need.task) for task in model.tasks for need in task.needs}
    every = waits | {(task.task, PART) for task in model.tasks if task.parts}
    for task, other in change.no_wait:
        if (task, other) not in every:
            raise UnknownName(where, "wait", f"{task} for {other}", [f"{one} for {two}" for one, two in sorted(every)])
    for name in change.buffer:
        if name not in {task for task, _ in waits}:
            raise UnknownName(where, "task in buffer that waits for another", name, {task for task, _ in waits})
    return structs.replace(model, tasks=tuple(_altered(model, task, change) for task in model.tasks))


def _altered(model: TaskModelCard, task: TaskTimesCard, change: Change) -> TaskTimesCard:
    factor = change.faster.get(task.agent, change.faster.get(model.agents[task.agent], 1.0))
    needs = tuple(need for need in task.needs if (task.task, need.task) not in change.no_wait)
    ahead = change.buffer.get(task.task, 0)
    return structs.replace(
        task,
        usual_s=task.usual_s / factor,
        work_s=tuple(work / factor for work in task.work_s),
        needs=tuple(structs.replace(need, back=need.back + ahead) for need in needs),
        parts=None if (task.task, PART) in change.no_wait else task.parts,
    )


def _estimates(
    model: TaskModelCard,
    sequences: Sequence[TaskSequence],
    seed: int,
    refused: Callable[[TaskSequence, EstimateError], None],
) -> dict[str, CycleEstimate]:
    return {each.name: each for each in estimate_plans(model, sequences, seed=seed, refused=refused)}


def _saved(before: CycleEstimate, after: CycleEstimate) -> tuple[float, float, float]:
    """Return the saving of a change, s, with its 95 % interval; both estimates have the same relative error."""
    saved = before.expected_s - after.expected_s
    part = (before.expected_high_s - before.expected_low_s) / (2 * Z95) / before.expected_s
    noise = float(np.std(np.array(before.durations_s))) / np.sqrt(len(before.durations_s))
    error = Z95 * float(np.hypot(part * abs(saved), noise))
    return saved, saved - error, saved + error
