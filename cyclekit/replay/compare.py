"""Compares executions as text: total time, the tasks that differ, and the safety loss of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.replay.phase import common_order, repetitions
from cyclekit.text.numbers import fixed, signed
from cyclekit.text.plain_text import markdown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.replay.execution import ReplayedExecution

MAX_ROWS = 8


def task_times(run: ReplayedExecution) -> dict[tuple[str, int], tuple[float, float | None]]:
    """Return seconds and safety loss (None = unknown) of each task and repetition."""
    rows = run.tasks.iter_rows(named=True)
    return {
        key: (row["end_s"] - row["start_s"], row["safety_loss_s"])
        for key, row in zip(repetitions(run), rows, strict=True)
    }


def most_different(runs: Sequence[ReplayedExecution]) -> list[tuple[str, int]]:
    """Return the tasks that all executions have, by descending difference of their times."""
    times = [task_times(run) for run in runs]
    shared = [key for key in common_order(runs) if all(key in each for each in times)]

    def spread(key: tuple[str, int]) -> float:
        took = [each[key][0] for each in times]
        return max(took) - min(took)

    return sorted(shared, key=lambda key: -spread(key))


def comparison(runs: Sequence[ReplayedExecution]) -> str:
    """Return the panel's text, Markdown."""
    lost = [float(run.tasks["safety_loss_s"].sum() or 0.0) for run in runs]
    quickest = min(range(len(runs)), key=lambda number: runs[number].duration_s)
    lines = [f"## {markdown(runs[quickest].name)} is the quickest: {fixed(runs[quickest].duration_s, 1)} s", ""]
    for number, run in enumerate(runs):
        if number != quickest:
            longer, more = run.duration_s - runs[quickest].duration_s, lost[number] - lost[quickest]
            name = markdown(run.name)
            lines.append(
                f"- **{name}** took **{fixed(longer, 1)} s longer**; safety slow-down differs by {signed(more, 1)} s."
            )
    keys = most_different(runs)[:MAX_ROWS]
    if not keys:
        return "\n".join([*lines, "", "The executions have no task in common."])
    heads = "".join(f" {markdown(run.name)} |" for run in runs)
    lines += ["", "Seconds per task (slow-down in brackets), the greatest difference first", ""]
    lines += [f"| task |{heads}", "|---|" + "---|" * len(runs)]
    times = [task_times(run) for run in runs]
    for task, repetition in keys:
        cells = [_cell(*each[task, repetition]) for each in times]
        again = f" ({repetition}.)" if repetition > 1 else ""
        lines.append(f"| {markdown(runs[0].shown(task))}{again} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(seconds: float, lost: float | None) -> str:
    return fixed(seconds, 1) if lost is None else f"{fixed(seconds, 1)} ({fixed(lost, 1)})"
