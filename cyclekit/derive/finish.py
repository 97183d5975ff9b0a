"""The rest of one session's samples, when all sessions are known: levels, goals of the operator; how levels change."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.activity import with_goals
from cyclekit.derive.sample_file import AT_ONCE, write_samples
from cyclekit.dynamics import Changes, changes_of
from cyclekit.height import in_plane
from cyclekit.motion import pieces
from cyclekit.people import goals_from_stays
from cyclekit.tables import parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.activity import Stays
    from cyclekit.dataset import Place
    from cyclekit.motion import Run
    from cyclekit.silence import Absence

    Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Left:
    """What is left to be done for one session.

    Attributes:
        session: Its name, that of its file of samples too.
        runs: Runs of its robot.
        label: Index of the level in force at each sample, shape (N,), -1 = none.
        stays: Where the operator stayed, of each execution.
        absence: When a silent tracker says that nobody was there.
    """

    session: str
    runs: Sequence[Run]
    label: NDArray[np.int32]
    stays: Sequence[Stays]
    absence: Absence


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
    made = file.with_suffix(".part")
    times: list[Vector] = []
    apart: list[Vector] = []
    write_samples(_completed(file, left, spots, times, apart), made)
    made.replace(file)  # whoever does this again finds the one or the other
    changes = [
        change for run in left.runs for _, part in pieces(run) for change in changes_of(part.t_s, part.scaling, levels)
    ]
    return Changes.seen(changes, np.concatenate(times), np.concatenate(apart), most_changes)


def _completed(
    file: Path, left: Left, spots: Mapping[str, Place], times: list[Vector], apart: list[Vector]
) -> Iterator[pl.DataFrame]:
    """Yield the samples with goals and levels, in parts; add their times and how far operator and TCP are apart."""
    told = any(mine.told for mine in left.stays)
    stays = [] if told else left.stays
    goals = list(chain.from_iterable(goals_from_stays(s.spans, s.at_m, s.samples, spots) for s in stays))
    first = 0
    for samples in (some for part in parts_of(file) for some in part.iter_slices(AT_ONCE)):
        rows = slice(first, first + samples.height)
        first += samples.height
        step = pl.Series("step", left.label[rows], dtype=pl.Int32)
        samples = _with_absence(samples, left.absence)
        done = with_goals(samples, samples["human_task"].to_list() if told else goals[rows], spots)
        done = schema.conform(done.with_columns(step=pl.when(step >= 0).then(step)), schema.SAMPLES)
        robot, human = (done.select(f"{who}_{axis}_m" for axis in "xyz").to_numpy() for who in ("robot", "human"))
        times.append(done["t_s"].to_numpy())
        apart.append(np.linalg.norm(robot - in_plane(robot, human), axis=1))
        yield done


def _with_absence(samples: pl.DataFrame, absence: Absence) -> pl.DataFrame:
    """Return samples in which nobody is there where a tracker's silence says so; it was taken not to be running."""
    silent = (pl.col("t_s") < absence.until_s) | (pl.col("t_s") > absence.from_s)
    gap = pl.col("human_gap")
    return samples.with_columns(human_gap=pl.when((gap == "outside") & silent).then(pl.lit("absent")).otherwise(gap))
