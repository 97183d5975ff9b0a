"""Pauses between executions: whether the operator's tracks run on, and with which scaling a cycle starts.

With a recovery of 5 %/s, a level of 25 % takes 15 s to become 100 %, and the next cycle starts meanwhile. A track that
starts with its execution starts at the logged scaling. For a track that starts at another instant, the logs show
whether the safety system keeps its scaling between executions: then it starts at the scaling of that instant, raised
by the recovery in a usual pause. The scaling commanded for the first positions is the upper limit (`Follower`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Ints, Vector

RUN_ON_S = 5.0
"""Maximum pause, s, before the next execution of a session for the operator's track to run on into it."""
MAX_RESETS = 0.05
"""Maximum share of pauses after which the scaling is higher than its recovery allows, if the scaling is kept."""
MIN_PAUSES = 5
"""Minimum number of pauses that show whether the scaling is kept."""
TOLERANCE = 0.02
"""Difference of scalings that counts as none."""


def _pauses(dataset: Dataset) -> pl.DataFrame:
    """Return each execution that follows another one of its session, that one, and the pause between them, s."""
    order = dataset.executions.sort("session", "start_s")
    before = pl.col("execution").shift().over("session").alias("before")
    pause = (pl.col("start_s") - pl.col("end_s").shift().over("session")).alias("pause_s")
    return order.select("execution", before, pause).drop_nulls()


def runs_on(dataset: Dataset) -> bool:
    """Return whether most executions are followed by the next one of their session without a longer pause."""
    pause_s = _pauses(dataset)["pause_s"]
    return bool((pause_s <= RUN_ON_S).sum() >= 0.8 * max(len(pause_s), 1))


def starting_scaling(
    dataset: Dataset, executions: Sequence[str], instants: Ints, up_per_s: float | None
) -> Vector | None:
    """Return the scaling at which tracks start, shape (K,); NaN = what is commanded; None without a slow recovery.

    Args:
        dataset: The logs.
        executions: Execution of each of K tracks.
        instants: Sample of that execution with which the track starts, shape (K,); later ones are in the pause.
        up_per_s: Rate of the recovery.
    """
    if not up_per_s:
        return None
    samples = dataset.samples(columns=["execution", "scaling"])
    logged = {
        str(name): rows["scaling"].cast(pl.Float64).fill_null(np.nan).to_numpy()
        for (name,), rows in samples.group_by(["execution"], maintain_order=True)
    }
    pairs = zip(executions, instants.tolist(), strict=True)
    scaling = np.array([logged[name][min(at, len(logged[name]) - 1)] for name, at in pairs])
    return np.where(instants == 0, scaling, scaling + up_per_s * _kept_s(dataset, logged, up_per_s))


def _kept_s(dataset: Dataset, logged: Mapping[str, Vector], up_per_s: float) -> float:
    """Return the median pause between executions, s; NaN if the scaling is not kept in it, or too few show that."""
    pauses = _pauses(dataset).filter(pl.col("execution").is_in(list(logged)) & pl.col("before").is_in(list(logged)))
    ends = np.array([logged[name][-1] for name in pauses["before"]])
    begins = np.array([logged[name][0] for name in pauses["execution"]])
    pause_s = pauses["pause_s"].to_numpy()
    known = np.isfinite(ends + begins)
    if known.sum() < MIN_PAUSES:
        return float("nan")
    resets = begins[known] > ends[known] + up_per_s * pause_s[known] + TOLERANCE
    return float(np.median(pause_s)) if resets.mean() <= MAX_RESETS else float("nan")
