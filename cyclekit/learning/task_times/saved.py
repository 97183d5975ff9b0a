"""A model of task times as a thing to keep: one file, `MODEL/model.json`, data and never code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclekit.dataset.cards import BadCard, checked, plain, read_json
from cyclekit.dataset.cards.task_model import FORMAT, TaskModelCard
from cyclekit.errors import ModelError, command_line
from cyclekit.learning.networks.saved import check_model_output
from cyclekit.storage.atomic import recover, staged
from cyclekit.storage.mistaken import MODEL_CARD
from cyclekit.storage.remote.folders import local, published
from cyclekit.text.plain_json import json_text
from cyclekit.text.plain_text import all_in_one_line
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, repr=False)
class TaskTimesModel(Result):
    """What was learned from task lists: how long tasks take beside each other, and what each waits for.

    Attributes:
        card: All of it, as data.
    """

    card: TaskModelCard

    def to_dict(self) -> dict[str, Any]:
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

    def _said(self) -> list[str]:
        tasks = [f"{task.agent}: {task.task}, waits for {', '.join(task.waits_for)}" for task in self.card.tasks]
        return [f"{len(tasks)} tasks from {self.card.executions} executions", *tasks]


def holds_task_times(place: Path | str) -> bool:
    """Tell whether a place holds a model of task times."""
    try:
        return read_json(local(place) / MODEL_CARD).get("format") == FORMAT
    except (OSError, BadCard):
        return False


def save_task_times(place: Path | str, model: TaskTimesModel) -> None:
    """Write a model as a folder, at a path or a URL.

    Raises:
        ModelError: The path is there already and is no model.
        CyclekitError: The place cannot be written.
    """
    check_model_output(place)
    with published(place) as path:
        recover(path)
        with staged(path) as folder:
            text = json_text(model.to_dict(), ascii_only=True) + "\n"
            (folder / MODEL_CARD).write_text(text, encoding="utf-8", newline="\n")


def load_task_times(place: Path | str) -> TaskTimesModel:
    """Open a model of task times.

    Raises:
        ModelError: It is damaged, or of another version.
    """
    file = local(place) / MODEL_CARD
    try:
        return TaskTimesModel(checked(all_in_one_line(read_json(file)), TaskModelCard))
    except (OSError, BadCard) as cause:
        again = command_line("train", "DATASET", "--out", place)
        raise ModelError(f"{file}: {cause}", cure=f"Train it again: {again}") from cause
