"""The rest of one session's samples, when all sessions are known: levels, goals of the operator; how levels change."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.activity import with_goals
from cyclekit.atomic import write_parquet
from cyclekit.dynamics import Changes, changes_of
from cyclekit.motion import pieces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.activity import Stays
    from cyclekit.dataset import Place
    from cyclekit.motion import Run


@dataclass(frozen=True)
class Left:
    """What is left to be done for one session.

    Attributes:
        session: Its name, that of its file of samples too.
        runs: Runs of its robot.
        label: Index of the level in force at each sample, shape (N,), -1 = none.
        stays: Where the operator stayed, of each execution.
    """

    session: str
    runs: Sequence[Run]
    label: NDArray[np.int32]
    stays: Sequence[Stays]


def finish(
    left: Left, *, spots: Mapping[str, Place], levels: Sequence[float], most_changes: int, folder: Path
) -> Changes:
    """Complete the samples of one session in their file; return how the level changed at the log's own rate.

    Args:
        left: The session.
        spots: Places of the operator.
        levels: Of the scaling, ascending.
        most_changes: Of so many changes the distances are told at most.
        folder: Where the files of samples lie.
    """
    file = folder / f"{left.session}.parquet"
    samples = pl.read_parquet(BytesIO(file.read_bytes()))  # a file that is mapped cannot be replaced on Windows
    step = pl.Series("step", left.label, dtype=pl.Int32)
    samples = with_goals(samples, left.stays, spots).with_columns(step=pl.when(step >= 0).then(step))
    made = file.with_suffix(".part")
    write_parquet(schema.conform(samples, schema.SAMPLES), made)
    made.replace(file)  # whoever does this again finds the one or the other
    changes = [
        change for run in left.runs for _, part in pieces(run) for change in changes_of(part.t_s, part.scaling, levels)
    ]
    robot, human = ([f"{who}_{axis}_m" for axis in "xyz"] for who in ("robot", "human"))
    apart = samples.select(robot).to_numpy() - samples.select(human).to_numpy()
    return Changes.seen(changes, samples["t_s"].to_numpy(), np.linalg.norm(apart, axis=1), most_changes)
