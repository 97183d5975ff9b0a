"""Signals that detect people as inputs of models in place of the operator's position.

Bit k is added to coordinate k mod 3 with weight 2^(k div 3): up to three signals have a column each.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import polars as pl

from cyclekit.dataset.cards import note

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from cyclekit.dataset.cards import Note, TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Ints

_AXES = 3


def by_signals(dataset: Dataset) -> bool:
    """Return whether people are known by signals: as set by `Dataset.by_people`, else if these are more frequent."""
    if dataset.people != "auto":
        return dataset.people == "signals"
    if not dataset.card.operator_signals or "people" not in dataset.positions:
        return bool(dataset.card.operator_signals)
    known = _known(dataset)
    return known.signals > known.positions


def mixed(dataset: Dataset) -> list[Note]:
    """Return a note on how many executions a model learns from and leaves out, if positions and signals are mixed."""
    if not dataset.card.operator_signals or "people" not in dataset.positions:
        return []
    known, words = _known(dataset), ("positions", "signals")
    what, other = reversed(words) if by_signals(dataset) else words
    used, left = (known.signals, known.positions) if by_signals(dataset) else (known.positions, known.signals)
    left -= known.both
    return [note("people-learned", what=what, used=used, left=left, other=other)] if left else []


def left_out(model: TrainingCard, dataset: Dataset) -> list[str]:
    """Return a sentence on executions that a model cannot use, as they have only positions, or only signals."""
    return [
        f"estimates use the operators of {one.values['used']} executions with {one.values['what']} of people; "
        f"{one.values['left']} executions with {one.values['other']} only are left out"
        for one in mixed(as_learned_by(model, dataset))
    ]


def as_learned_by(model: TrainingCard, dataset: Dataset) -> Dataset:
    """Return a dataset with people known by what a model was trained on, positions or signals."""
    if not dataset.card.operator_signals or "people" not in dataset.positions:
        return dataset
    return dataset.by_people("signals" if model.operator_signals else "positions")


class _Known(NamedTuple):
    """Number of executions in which a tracker's log, signals, or both detect people."""

    positions: int
    signals: int
    both: int


@lru_cache(maxsize=4)
def _known(dataset: Dataset) -> _Known:
    followed = pl.col("human_x_m").is_not_null() | pl.col("human_gap").is_in(["absent", "occluded"])
    signals = pl.col("human_signals").is_not_null()
    found = dataset.summed_up(
        lambda samples: samples.group_by("execution").agg(positions=followed.any(), signals=signals.any())
    )
    counts = found.select("positions", "signals", both=pl.col("positions") & pl.col("signals")).sum()
    return _Known(*counts.row(0))


def as_inputs(bits: ArrayLike, count: int) -> Floats:
    """Return bit fields (N,) of `count` signals as three numbers each, shape (N, 3)."""
    signals = np.asarray(bits, np.int64)
    found = np.zeros((len(signals), _AXES))
    for k in range(count):
        found[:, k % _AXES] += ((signals >> k) & 1) * 2.0 ** (k // _AXES)
    return found


def from_inputs(numbers: NDArray[np.floating[Any]], count: int) -> Ints:
    """Return the bit fields (N,) of three numbers (N, 3); the inverse of `as_inputs`."""
    whole, found = np.rint(numbers).astype(np.int64), np.zeros(len(numbers), np.int64)
    for k in range(count):
        found |= ((whole[:, k % _AXES] >> (k // _AXES)) & 1) << k
    return found


def learned_rows(dataset: Dataset, frame: pl.DataFrame) -> pl.DataFrame:
    """Return samples as inputs of models: if signals detect people, with these in the operator's columns."""
    if not by_signals(dataset):
        return frame
    known = frame["human_signals"].is_not_null()
    values = as_inputs(frame["human_signals"].fill_null(0).to_numpy(), len(dataset.card.operator_signals))
    columns = [pl.when(known).then(pl.Series(values[:, k])).alias(f"human_{axis}_m") for k, axis in enumerate("xyz")]
    return frame.with_columns(*columns, human_gap=pl.when(~known).then(pl.lit("outside")))
