"""Interrupted executions: a lunch break, a fault or a jam in the middle of a cycle is no part of its cycle time.

An execution is interrupted if one of its tasks takes longer than a usual execution, safety slow-down excluded, because
its program was paused or stopped, or for no reason that the logs show while the other repetitions of the task are far
shorter. What keeps the robot away often, or in all lengths, is part of the work: a wait for parts or the operator.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from msgspec.structs import replace

from cyclekit.dataset.cards import note

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import ExecutionCard, Note
    from cyclekit.schema import Bools, Vector

SHORTEST_S = 30.0
"""Minimum time of an interruption, s: shorter stops are part of the work."""
FEW = 0.1
"""Maximum share of the repetitions of a task that are interrupted, if no program state tells."""
ENOUGH = 5
"""Minimum number of repetitions of which one may be interrupted; a task that was logged once may be, too."""
APART = 3.0
"""Minimum ratio of an interrupted repetition to the longest other one: waits of all lengths are no interruptions."""


def with_interruptions(cards: Sequence[ExecutionCard], tasks: pl.DataFrame) -> list[ExecutionCard]:
    """Return the executions with the time for which each was interrupted.

    Args:
        cards: All executions.
        tasks: Table TASKS.
    """
    robot = tasks.filter(pl.col("start_place").is_not_null() & pl.col("end_s").is_not_null())
    lost = pl.col("safety_loss_s").fill_null(0.0)
    rows = robot.select(
        "execution", "task", pl.col("lost_pause_s").fill_null(0.0), free_s=pl.col("end_s") - pl.col("start_s") - lost
    )
    whole = [card.execution for card in cards if card.complete]
    per = rows.filter(pl.col("execution").is_in(whole)).group_by("execution").agg(pl.col("free_s").sum())
    if not per.height:
        return list(cards)
    longest_s = max(SHORTEST_S, float(np.median(per["free_s"].to_numpy())))
    found: dict[str, float] = {}
    for mine in rows.partition_by("task", maintain_order=True):
        free_s, paused_s = mine["free_s"].to_numpy(), mine["lost_pause_s"].to_numpy()
        stopped = (paused_s > longest_s) | _apart(free_s - paused_s, longest_s)
        usual_s = float(np.median(free_s[~stopped])) if not stopped.all() else 0.0
        for name, took_s in zip(mine["execution"].to_numpy()[stopped], free_s[stopped].tolist(), strict=True):
            found[name] = found.get(name, 0.0) + took_s - usual_s
    return [replace(card, interrupted_s=found.get(card.execution, 0.0)) for card in cards]


def _apart(free_s: Vector, longest_s: float) -> Bools:
    """Return which repetitions of a task, shape (N,), are few, longer than this and far longer than all others."""
    order = np.sort(free_s)[::-1]
    few = max(int(FEW * len(order)), int(len(order) == 1 or len(order) >= ENOUGH))
    for count in range(few, 0, -1):
        usual_s = order[count] if count < len(order) else 0.0
        if order[count - 1] > max(longest_s, APART * usual_s):
            return np.asarray(free_s >= order[count - 1])
    return np.zeros(len(free_s), np.bool_)


def interruption_notes(cards: Sequence[ExecutionCard]) -> list[Note]:
    """Return a note on the interrupted executions, if there are any."""
    some = [card for card in cards if card.interrupted_s]
    if not some:
        return []
    most = max(some, key=lambda card: card.interrupted_s)
    mean_s = sum(card.interrupted_s for card in some) / len(cards)
    longest_s, name = most.interrupted_s, most.execution
    return [
        note(
            "executions-interrupted",
            count=len(some),
            all=len(cards),
            longest_s=longest_s,
            execution=name,
            mean_s=mean_s,
        )
    ]
