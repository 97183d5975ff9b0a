"""A model of an unseen operator as a thing to keep: one file, `MODEL/model.json`, data and never code."""

from __future__ import annotations

from pathlib import Path

from cyclekit.dataset.cards import BadCard, checked, plain, read_json
from cyclekit.dataset.cards.unseen import FORMAT, UnseenModelCard
from cyclekit.errors import ModelError, command_line
from cyclekit.learning.networks.saved import check_model_output
from cyclekit.learning.unseen.model import UnseenOperator
from cyclekit.storage.atomic import recover, staged
from cyclekit.storage.mistaken import MODEL_CARD
from cyclekit.storage.remote.folders import local, published
from cyclekit.text.plain_json import json_text
from cyclekit.text.plain_text import all_in_one_line


def holds_unseen(place: Path | str) -> bool:
    """Tell whether a place holds a model of an unseen operator."""
    try:
        return read_json(local(place) / MODEL_CARD).get("format") == FORMAT
    except (OSError, BadCard):
        return False


def save_unseen(place: Path | str, model: UnseenOperator) -> None:
    """Write a model as a folder, at a path or a URL.

    Raises:
        ModelError: The path is there already and is no model.
        CyclekitError: The place cannot be written.
    """
    check_model_output(place)
    kept = UnseenModelCard(format=FORMAT, levels=model.levels, unseen=model.unseen, card=model.card)
    with published(place) as path:
        recover(path)
        with staged(path) as folder:
            text = json_text(plain(kept, nulls=True), ascii_only=True) + "\n"
            (folder / MODEL_CARD).write_text(text, encoding="utf-8", newline="\n")


def load_unseen(place: Path | str) -> UnseenOperator:
    """Open a model of an unseen operator.

    Raises:
        ModelError: It is damaged, or of another version.
    """
    file = local(place) / MODEL_CARD
    try:
        card = checked(all_in_one_line(read_json(file)), UnseenModelCard)
    except (OSError, BadCard) as cause:
        again = command_line("train", "DATASET", "--out", place)
        raise ModelError(f"{file}: {cause}", cure=f"Train it again: {again}") from cause
    return UnseenOperator(card.levels, card.unseen, card.card)
