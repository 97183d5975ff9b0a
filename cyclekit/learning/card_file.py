"""Reads and writes a model that is a single card: the file `MODEL/model.json`, data without code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from cyclekit.dataset.cards import BadCard, checked, plain, read_json
from cyclekit.errors import ModelError, command_line
from cyclekit.learning.networks.saved import check_model_output
from cyclekit.storage.atomic import recover, staged
from cyclekit.storage.identify import MODEL_CARD
from cyclekit.storage.remote.folders import local, published
from cyclekit.text.plain_json import json_text
from cyclekit.text.plain_text import all_in_one_line

if TYPE_CHECKING:
    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.dataset.cards.unseen import UnseenModelCard

Saved = TypeVar("Saved", "TaskModelCard", "UnseenModelCard")


def holds(place: Path | str, kind: str) -> bool:
    """Return whether a path or URL holds a model of this format."""
    try:
        return read_json(local(place) / MODEL_CARD).get("format") == kind
    except (OSError, BadCard):
        return False


def save(place: Path | str, card: TaskModelCard | UnseenModelCard) -> None:
    """Write a model as a folder, at a path or a URL.

    Raises:
        ModelError: The path exists and is no model.
        CyclekitError: The path cannot be written.
    """
    check_model_output(place)
    with published(place) as path:
        recover(path)
        with staged(path) as folder:
            text = json_text(plain(card, nulls=True), ascii_only=True) + "\n"
            (folder / MODEL_CARD).write_text(text, encoding="utf-8", newline="\n")


def load(place: Path | str, kind: type[Saved]) -> Saved:
    """Load a model.

    Raises:
        ModelError: It is damaged, or of another version.
    """
    file = local(place) / MODEL_CARD
    try:
        return checked(all_in_one_line(read_json(file)), kind)
    except (OSError, BadCard) as cause:
        again = command_line("train", "DATASET", "--out", place)
        raise ModelError(f"{file}: {cause}", cure=f"Train it again: {again}") from cause
