"""Reads and writes a model of an unseen operator: the file `MODEL/model.json`, data without code."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.dataset.cards.unseen import FORMAT, UnseenModelCard
from cyclekit.learning import card_file
from cyclekit.learning.unseen.model import UnseenOperator

if TYPE_CHECKING:
    from pathlib import Path


def holds_unseen(place: Path | str) -> bool:
    """Return whether a path or URL holds a model of an unseen operator."""
    return card_file.holds(place, FORMAT)


def save_unseen(place: Path | str, model: UnseenOperator) -> None:
    """Write a model as a folder; see `card_file.save`."""
    card = UnseenModelCard(format=FORMAT, levels=model.levels, unseen=model.unseen, card=model.card)
    card_file.save(place, card)


def load_unseen(place: Path | str) -> UnseenOperator:
    """Load a model of an unseen operator; see `card_file.load`."""
    card = card_file.load(place, UnseenModelCard)
    return UnseenOperator(card.levels, card.unseen, card.card)
