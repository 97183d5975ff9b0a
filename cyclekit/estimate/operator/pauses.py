"""Pauses between executions: whether the operator's tracks run on, and with which scaling a cycle starts.

With a recovery of 5 %/s, a level of 25 % takes 15 s to become 100 %, and the next cycle starts meanwhile: a track
starts at the scaling with which its execution did.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Vector

RUN_ON_S = 5.0
"""Maximum pause, s, before the next execution of a session for the operator's track to run on into it."""


def runs_on(dataset: Dataset) -> bool:
    """Return whether most executions are followed by the next one of their session without a longer pause."""
    order = dataset.executions.sort("session", "start_s")
    pause_s = order.select(pl.col("start_s") - pl.col("end_s").shift().over("session"))["start_s"].drop_nulls()
    return bool((pause_s <= RUN_ON_S).sum() >= 0.8 * max(len(pause_s), 1))


def starting_scaling(dataset: Dataset, executions: Sequence[str], up_per_s: float | None) -> Vector | None:
    """Return the scaling with which executions started, shape (K,); NaN = unknown; None without a slow recovery.

    Args:
        dataset: The logs.
        executions: Names of K executions.
        up_per_s: Rate of the recovery.
    """
    if not up_per_s:
        return None
    samples = dataset.samples(columns=["execution", "scaling"])
    first = samples.group_by("execution", maintain_order=True).first()
    scaling = dict(first.select("execution", pl.col("scaling").cast(pl.Float64).fill_null(np.nan)).iter_rows())
    return np.array([scaling[name] for name in executions])
