"""The cell that a model was trained in, stored in its card, and the test whether a dataset is of the same cell.

The learned function uses positions in the base frame of one robot; for another cell its predictions are wrong. A
dataset is of the same cell if it contains a log that the model was trained on, in the same frame; it may have grown, or
have been ingested again or at another rate. Without a common log, places and levels are compared.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import TYPE_CHECKING

from cyclekit.dataset.cards import CellCard, FrameCard, TrainingCard, plain
from cyclekit.errors import ModelError
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset

    _Spot = tuple[float, float, float, float, bool]
    """x, y, z and radius of a place, m, and whether it was inferred from the logs."""

PLACE_M = 0.05
"""Maximum displacement, m, in addition to both radii, at which two places count as one."""
LEVEL = 0.05
"""Maximum difference at which two levels count as one."""
SAME = 0.5
"""Minimum share of the places, and of the levels, that must match."""
FRAME_M, FRAME_TURN = 0.05, 0.05
"""Maximum displacement of a frame, m, and maximum difference of an entry of its rotation matrix."""


def fingerprint(dataset: Dataset) -> str:
    """Return the SHA-256 of the dataset's card: same fingerprint, same data."""
    text = json.dumps(plain(dataset.card), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def cell_of(dataset: Dataset) -> CellCard:
    """Return the card of a dataset's cell."""
    return CellCard(
        name=dataset.card.name or dataset.path.name,
        places={name: (*place.xyz_m, place.radius_m, place.inferred) for name, place in dataset.places.items()},
        levels=dataset.levels,
        logs={
            checksum: _frame(record.frame)
            for record in dataset.recordings
            for source in record.sources
            if (checksum := source.checksum) is not None
        },
    )


def refuse_other_cell(card: TrainingCard, dataset: Dataset, *, other_cell: bool = False) -> None:
    """Refuse a model that was trained in another cell than the dataset's, unless `other_cell`.

    A model whose card names no cell was written by hand (`load_model` reads no other) and is accepted.

    Raises:
        ModelError: The model was trained in another cell.
        DatasetError: The dataset has no positions.
    """
    dataset.require_positions()
    reason = None if other_cell else other_cell_of(card, dataset)
    if reason is not None and card.cell is not None:
        raise ModelError(
            f"{dataset.path}: not the cell {card.cell.name!r} that the model was trained on: {reason}",
            cure="Train a model of this cell: cyclekit train DATASET --out MODEL; or add --other-cell to use it for "
            "another cell (from Python other_cell=True).",
        )


def other_cell_of(card: TrainingCard, dataset: Dataset) -> str | None:
    """Return how the dataset's cell differs from the model's; None if it is the same."""
    learned = card.cell
    if learned is None or card.dataset_sha256 == fingerprint(dataset):
        return None
    here = cell_of(dataset)
    common = sorted(set(learned.logs) & set(here.logs))
    for log in common:
        if _moved(learned.logs[log], here.logs[log]):
            return "the same logs are in another frame"
    if common:
        return None
    return _other_places(learned.places, here.places) or _other_levels(learned.levels, here.levels)


def trained_on(card: TrainingCard, dataset: Dataset) -> bool:
    """Return whether most logs of the dataset were among those that the model was trained on."""
    if card.dataset_sha256 == fingerprint(dataset):
        return True
    here = cell_of(dataset).logs
    return card.cell is not None and 2 * len(set(card.cell.logs) & set(here)) > len(here)


def may_share_logs(card: TrainingCard, dataset: Dataset) -> bool:
    """Return whether the dataset may hold logs that the model was trained on: certain by their checksums.

    Without checksums on one side nothing shows the opposite.
    """
    if card.dataset_sha256 == fingerprint(dataset):
        return True
    here = cell_of(dataset).logs
    return card.cell is not None and (not here or not card.cell.logs or not here.keys().isdisjoint(card.cell.logs))


def _other_places(learned: Mapping[str, _Spot], here: Mapping[str, _Spot]) -> str | None:
    """Return how the places differ; the cell with fewer places may be a subset of the other."""
    if not learned or not here:
        return None
    lost = [name for name in here if not _found(name, here[name], learned)]
    gone = [name for name in learned if not _found(name, learned[name], here)]
    if min(len(lost) / len(here), len(gone) / len(learned)) <= 1 - SAME:
        return None
    first = lost[0]
    shown = ", ".join(fixed(value + 0.0, 2) for value in here[first][:3])
    was = (
        f", and was at ({', '.join(f'{fixed(value + 0.0, 2)}' for value in learned[first][:3])})"
        if first in learned
        else ""
    )
    return f"{len(lost)} of {len(here)} places are not where they were in training, such as {first} at ({shown}) m{was}"


def _found(name: str, place: _Spot, others: Mapping[str, _Spot]) -> bool:
    """Return whether a place is among others: by name if both were given by people, otherwise by position."""
    there = others.get(name)
    named = there is not None and not there[4] and not place[4]
    candidates = [there] if there is not None and named else list(others.values())
    return any(math.dist(place[:3], other[:3]) <= PLACE_M + place[3] + other[3] for other in candidates)


def _other_levels(learned: Sequence[float], here: Sequence[float]) -> str | None:
    if not learned or not here:
        return None
    known = [level for level in here if any(abs(level - other) <= LEVEL for other in learned)]
    if len(known) >= SAME * len(here):
        return None
    trained, seen = (", ".join(fixed(level, 2) for level in levels) for levels in (learned, here))
    return f"the speed scaling has the levels {seen}, in training {trained}"


def _frame(frame: FrameCard) -> tuple[float, ...] | None:
    if frame.xyz_m is None or frame.rotation is None:
        return None
    return tuple(round(value, 4) for row in (frame.xyz_m, *frame.rotation) for value in row)


def _moved(before: Sequence[float] | None, after: Sequence[float] | None) -> bool:
    if before is None or after is None:
        return (before is None) != (after is None)
    turned = max(abs(a - b) for a, b in zip(before[3:], after[3:], strict=True))
    return math.dist(before[:3], after[:3]) > FRAME_M or turned > FRAME_TURN
