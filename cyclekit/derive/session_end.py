"""The rest of one session's samples, when all sessions are known: levels, goals of the operator; how levels change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.derive.sample_file import AT_ONCE, write_samples
from cyclekit.people.activity import Stays, with_goals
from cyclekit.people.tracks import goals_from_stays
from cyclekit.scaling.response import Changes, LevelChange, changes_of
from cyclekit.segmentation.stored_run import Run, pieces
from cyclekit.storage.parquet import parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Place
    from cyclekit.people.silence import Absence
    from cyclekit.schema import Vector


@dataclass(frozen=True)
class Left:
    """What is left to be done for one session.

    Attributes:
        part: The name of its file of samples.
        runs: Runs of its robot.
        label: Index of the level in force at each sample, shape (N,), -1 = none.
        stays: Where the operator stayed, of each execution.
        absence: When a silent tracker says that nobody was there.
    """

    part: str
    runs: Sequence[Run]
    label: NDArray[np.int32]
    stays: Sequence[Stays]
    absence: Absence

    @property
    def told(self) -> bool:
        """Whether events tell the goals."""
        return any(mine.told for mine in self.stays)


def finish(
    left: Sequence[Left], *, spots: Mapping[str, Place], levels: Sequence[float], most_changes: int, folder: Path
) -> list[Changes]:
    """Complete the samples of sessions that share a file; return how the level of each changed at the log's own rate.

    Args:
        left: The sessions.
        spots: Places of the operator.
        levels: Of the scaling, ascending.
        most_changes: Of so many changes of one session the distances are told at most.
        folder: Where the files of samples lie.
    """
    times: list[Vector] = [np.empty(0)]
    places: list[Vector] = [np.empty((0, 6))]
    counts = [len(one.label) for one in left]
    if sum(counts):
        file = folder / f"{left[0].part}.parquet"
        made = file.with_suffix(".part")
        write_samples(_completed(file, left, spots, times, places), made)
        made.replace(file)  # whoever does this again finds the one or the other
    ends = np.cumsum(counts)[:-1]
    each = zip(left, np.split(np.concatenate(times), ends), np.split(np.concatenate(places), ends), strict=True)
    return [Changes.of(_changes(one, levels), t_s, at[:, :3], at[:, 3:], most_changes) for one, t_s, at in each]


def _changes(left: Left, levels: Sequence[float]) -> list[LevelChange]:
    if len(levels) < 2:
        return []  # and nothing is read
    parts = (part for run in left.runs for _, part in pieces(run))
    return [change for part in parts for change in changes_of(part.t_s, part.scaling, levels)]


def _completed(
    file: Path, left: Sequence[Left], spots: Mapping[str, Place], times: list[Vector], places: list[Vector]
) -> Iterator[pl.DataFrame]:
    """Yield the samples with goals and levels, in parts; add their times and where TCP and operator are, (N, 6)."""
    goals = [goal for one in left for goal in _goals(one, spots)]
    labels = np.concatenate([one.label for one in left])
    ends = np.cumsum([len(one.label) for one in left])
    told = np.array([one.told for one in left])
    until_s, from_s = np.array([(one.absence.until_s, one.absence.from_s) for one in left]).T
    first = 0
    for samples in (some for part in parts_of(file) for some in part.iter_slices(AT_ONCE)):
        rows = slice(first, first + samples.height)
        first += samples.height
        whose = np.searchsorted(ends, np.arange(rows.start, rows.stop), side="right")
        known = samples["human_task"].to_list() if told.any() else []
        mine = [known[i] if told[n] else goals[rows.start + i] for i, n in enumerate(whose.tolist())]
        step = pl.Series("step", labels[rows], dtype=pl.Int32)
        samples = _with_absence(samples, until_s[whose], from_s[whose])
        done = with_goals(samples, mine, spots)
        done = schema.conform(done.with_columns(step=pl.when(step >= 0).then(step)), schema.SAMPLES)
        times.append(done["t_s"].to_numpy())
        places.append(done.select(f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz").to_numpy())
        yield done


def _goals(left: Left, spots: Mapping[str, Place]) -> list[str | None]:
    """Return the goal at each sample of a session by where the operator stayed; none where events tell it."""
    if left.told:
        return [None] * len(left.label)
    return [goal for s in left.stays for goal in goals_from_stays(s.spans, s.at_m, s.samples, spots)]


def _with_absence(samples: pl.DataFrame, until_s: Vector, from_s: Vector) -> pl.DataFrame:
    """Return samples with the operator marked absent where a tracker's silence proves it; before, it counted as off.

    Args:
        samples: N of them.
        until_s: Until when nobody was there, in the time of each sample, shape (N,).
        from_s: From when on, likewise.
    """
    silent = (pl.col("t_s") < pl.Series(until_s)) | (pl.col("t_s") > pl.Series(from_s))
    gap = pl.col("human_gap")
    return samples.with_columns(human_gap=pl.when((gap == "outside") & silent).then(pl.lit("absent")).otherwise(gap))
