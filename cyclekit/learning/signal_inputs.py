"""Signals that tell of people, where models expect the operator's position: bits in place of coordinates.

Bit k stands in coordinate k mod 3, with the weight 2 to the power of k div 3: up to three signals have a column each.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import polars as pl

from cyclekit.dataset.cards import note

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.dataset.cards import Note, TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Ints

_AXES = 3


def by_signals(dataset: Dataset) -> bool:
    """Tell whether people are known by signals: as `Dataset.by_people` was told, else by what more executions have."""
    if dataset.people != "auto":
        return dataset.people == "signals"
    if not dataset.card.operator_signals or "people" not in dataset.positions:
        return bool(dataset.card.operator_signals)
    known = _known(dataset)
    return known.signals > known.positions


def mixed(dataset: Dataset) -> list[Note]:
    """Say in how many executions people are known by what a model learns from, and how many it leaves out."""
    if not dataset.card.operator_signals or "people" not in dataset.positions:
        return []
    known, words = _known(dataset), ("positions", "signals")
    what, other = reversed(words) if by_signals(dataset) else words
    used, left = (known.signals, known.positions) if by_signals(dataset) else (known.positions, known.signals)
    left -= known.both
    return [note("people-learned", what=what, used=used, left=left, other=other)] if left else []


def left_out(model: TrainingCard, dataset: Dataset) -> list[str]:
    """Say of how many executions the operators are met by estimates, and of how many not; nothing where all are."""
    return [
        f"operators of the {one.values['used']} executions whose logs hold {one.values['what']} of people; the model "
        f"knows nothing of {one.values['other']}, which {one.values['left']} executions hold alone"
        for one in mixed(as_learned_by(model, dataset))
    ]


def as_learned_by(model: TrainingCard, dataset: Dataset) -> Dataset:
    """Return a dataset with people known by what a model was learned from, positions or signals."""
    if not dataset.card.operator_signals or "people" not in dataset.positions:
        return dataset
    return dataset.by_people("signals" if model.operator_signals else "positions")


class _Known(NamedTuple):
    """In how many executions a tracker's log, and signals, tell of people; and both."""

    positions: int
    signals: int
    both: int


@lru_cache(maxsize=4)
def _known(dataset: Dataset) -> _Known:
    followed = pl.col("human_x_m").is_not_null() | pl.col("human_gap").is_in(["absent", "occluded"])
    by = dataset.scan_samples().group_by("execution")
    found = by.agg(followed.any().alias("positions"), pl.col("human_signals").is_not_null().any().alias("signals"))
    counts = found.select("positions", "signals", both=pl.col("positions") & pl.col("signals")).sum().collect()
    return _Known(*counts.row(0))


def as_inputs(signals: Ints, count: int) -> Floats:
    """Return bit fields (N,) of `count` signals as three numbers each, shape (N, 3)."""
    found = np.zeros((len(signals), _AXES))
    for k in range(count):
        found[:, k % _AXES] += ((signals >> k) & 1) * 2.0 ** (k // _AXES)
    return found


def from_inputs(numbers: NDArray[np.floating[Any]], count: int) -> Ints:
    """Return the bit fields (N,) that three numbers (N, 3) stand for; the inverse of `as_inputs`."""
    whole, found = np.rint(numbers).astype(np.int64), np.zeros(len(numbers), np.int64)
    for k in range(count):
        found |= ((whole[:, k % _AXES] >> (k // _AXES)) & 1) << k
    return found


def learned_rows(dataset: Dataset, frame: pl.DataFrame) -> pl.DataFrame:
    """Return samples as models see them: where signals tell of people, with these in the columns of the operator."""
    if not by_signals(dataset):
        return frame
    known = frame["human_signals"].is_not_null()
    values = as_inputs(frame["human_signals"].fill_null(0).to_numpy(), len(dataset.card.operator_signals))
    columns = [pl.when(known).then(pl.Series(values[:, k])).alias(f"human_{axis}_m") for k, axis in enumerate("xyz")]
    return frame.with_columns(*columns, human_gap=pl.when(~known).then(pl.lit("outside")))
