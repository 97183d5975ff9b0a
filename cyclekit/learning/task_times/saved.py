"""Reads and writes a model of task times: the file `MODEL/model.json`, data without code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.dataset.cards import plain
from cyclekit.dataset.cards.task_model import FORMAT, TaskModelCard
from cyclekit.learning import card_file
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


@dataclass(frozen=True, repr=False)
class TaskTimesModel(Result):
    """A model learned from task lists: task times, mutual slowing, and wait conditions.

    Attributes:
        card: The model as data.
    """

    card: TaskModelCard

    def to_dict(self) -> dict[str, object]:
        """Return the card as plain JSON values."""
        return plain(self.card, nulls=True)

    def _frame_rows(self) -> Sequence[dict[str, object]]:
        return [
            {
                "agent": task.agent,
                "task": task.task,
                "repetitions": len(task.work_s),
                "usual_s": task.usual_s,
                "waits_for": "; ".join(task.waits_for),
            }
            for task in self.card.tasks
        ]

    def _lines(self) -> list[str]:
        tasks = [f"{task.agent}: {task.task}, waits for {', '.join(task.waits_for)}" for task in self.card.tasks]
        return [f"{len(tasks)} tasks from {self.card.executions} executions", *tasks]


def holds_task_times(place: Path | str) -> bool:
    """Return whether a path or URL holds a model of task times."""
    return card_file.holds(place, FORMAT)


def save_task_times(place: Path | str, model: TaskTimesModel) -> None:
    """Write a model as a folder; see `card_file.save`."""
    card_file.save(place, model.card)


def load_task_times(place: Path | str) -> TaskTimesModel:
    """Load a model of task times; see `card_file.load`."""
    return TaskTimesModel(card_file.load(place, TaskModelCard))
