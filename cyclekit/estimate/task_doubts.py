"""Doubts about the cycle time of a plan that was estimated from task lists, and what in it was never logged."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from cyclekit.estimate.finding import Finding
from cyclekit.estimate.soundness import unproven_found
from cyclekit.learning.task_times.prepared import agent_of, prepared
from cyclekit.text.numbers import percent, signed_percent

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.cards.task_model import HeldOutCard, TaskModelCard

MAX_ERROR = 0.1
"""Maximum bias, and spread of errors over orders, on held-out orders, above which a number cannot be trusted."""
SHOWN = 3
"""Maximum number of examples in a sentence."""


NOT_JUDGED = "too few executions to validate on held-out orders: the intervals are those of the rollout alone"


def findings_of_plan(model: TaskModelCard, sequence: TaskSequence) -> tuple[Finding, ...]:
    """Return what is known about the basis of the cycle time of a plan.

    Args:
        model: Task times learned from task lists, which know all tasks of the plan.
        sequence: The plan.
    """
    found: list[Finding] = []
    names = [(agent_of(model, task, sequence.shown), task.name) for task in sequence.plan]
    joint = [(card, card.joint) for card in model.tasks if card.joint]
    alone = [
        f"{card.task} with {other.task}"
        for card, other in joint
        if names.count((card.agent, card.task)) > names.count((other.agent, other.task))
    ]
    if alone:
        text = f"{sequence.shown}: logged only as a joint task, and here not as often: {_some(alone)}"
        found.append(Finding("joint-tasks", "amber", text))
    waits = (Finding("waits-left-out", "amber", text) for text in _waits_without_task(model, sequence, names))
    return (_judged(model.held_out), *unproven_found(model.warnings), *found, *waits)


def _judged(judged: HeldOutCard | None) -> Finding:
    if judged is None:
        return Finding("backtest", "amber", NOT_JUDGED, covered=False)
    text = (
        f"held-out orders were {signed_percent(judged.bias)} off on average, with a spread of "
        f"{percent(judged.order_error)}"
    )
    if max(abs(judged.bias), judged.order_error) <= MAX_ERROR:
        return Finding("backtest", "green", text)
    return Finding("backtest", "red", text, "something that decides the times was not learned")


def _waits_without_task(
    model: TaskModelCard, sequence: TaskSequence, names: Sequence[tuple[str, str]]
) -> Iterator[str]:
    """Yield a sentence for each kind of wait that is left out, as the plan lacks the task that is waited for."""
    cards = {(card.agent, card.task): card for card in model.tasks}
    turns, lacking = Counter[tuple[str, str]](), Counter[str]()
    for task, name in zip(sequence.plan, names, strict=True):
        for need in cards[name].needs:
            other = need.agent, need.task
            if need.needed == 1.0 and other[0] != name[0] and turns[name] - need.back >= names.count(other):
                lacking[f"wait of {task.shown} for {need.agent}: {need.task}"] += 1
        turns[name] += 1
    for wait, count in lacking.items():
        times = {1: "once", 2: "twice"}.get(count, f"{count} times")
        yield f"{wait}: left out {times}, the plan has no such task then"


def never_in_a_row(model: TaskModelCard, sequence: TaskSequence) -> list[str]:
    """Return a sentence on tasks of a plan that their agent never did in a row in the logs; none if there are none.

    Args:
        model: Task times learned from task lists, which know all tasks of the plan.
        sequence: The plan.
    """
    cards = {(card.agent, card.task): card for card in model.tasks}
    before: dict[str, str] = {}
    found = []
    for task in sequence.plan:
        agent = agent_of(model, task, sequence.shown)
        last = before.get(agent)
        if last is not None and last not in cards[agent, task.name].after:
            found.append(f"{task.name} after {last}")
        before[agent] = task.name
    return [f"never logged in a row: {_some(found)}"] if found else []


def planned_starts_not_kept(model: TaskModelCard, sequence: TaskSequence) -> list[str]:
    """Return a sentence on each agent whom the plan's starts do not hold, as it did not keep to planned starts.

    Args:
        model: Task times learned from task lists, which know all tasks of the plan.
        sequence: The plan.
    """
    plan = prepared(model, sequence.plan, sequence.shown)
    told = zip(sequence.plan, plan.cards, plan.not_before_s, strict=True)
    free = {card.agent for task, card, held_s in told if (task.not_before_s or 0.0) > held_s}
    return [
        f"planned starts do not hold {agent}: where it was free before one in the logs, it began before it in "
        f"{percent(model.before_plan[agent])} of the cases. To hold it all the same, give not_before_s only "
        "to single tasks"
        for agent in sorted(free)
    ]


def _some(names: Sequence[str]) -> str:
    several = list(dict.fromkeys(names))
    more = f" and {len(several) - SHOWN} more" if len(several) > SHOWN else ""
    return ", ".join(several[:SHOWN]) + more
