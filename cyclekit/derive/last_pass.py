"""Last pass over a session, when all sessions are known: levels, the operator's goals, changes of level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.derive.causes.cause_samples import TwoStateSignal, rows_of
from cyclekit.derive.causes.causes import Evidence, lost_shares
from cyclekit.derive.sample_file import AT_ONCE, write_samples
from cyclekit.people.activity import OperatorStandstills, with_goals
from cyclekit.people.tracks import goals_from_standstills
from cyclekit.scaling.response import Changes, LevelChange, changes_of
from cyclekit.segmentation.stored_run import Run, pieces
from cyclekit.storage.parquet import parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Place
    from cyclekit.people.silence import Absence
    from cyclekit.schema import Floats, Vector

_MIN_SHARE = 0.03
"""Minimum share of a sample's time that must be lost for its cause to be named."""


@dataclass(frozen=True)
class LastPassInput:
    """Input of the last pass for one session.

    Attributes:
        part: Name of its file of samples.
        runs: Runs of its robot.
        label: Index of the level at each sample, shape (N,), -1 = none.
        operator_standstills: The operator's standstills in each execution.
        absence: When a silent tracker means that no operator was present.
        switches: Two-state signals, session time; if any show people, only those, on while a person is present.
        task_times: Start, arrival, end of dwell, end, and start and end of a wait short of the goal, for each task of
            the robot, shape (L, 6), session seconds.
    """

    part: str
    runs: Sequence[Run]
    label: NDArray[np.int32]
    operator_standstills: Sequence[OperatorStandstills]
    absence: Absence
    switches: Mapping[str, TwoStateSignal]
    task_times: Floats

    @property
    def goals_logged(self) -> bool:
        """Whether logged events give the goals."""
        return any(mine.told for mine in self.operator_standstills)


class LastPassResult(NamedTuple):
    """Changes of level in a session, at the log's rate; time lost per task to each of SCALING_CAUSES, (L, 5), s.

    `unseen`: number of samples in which a signal shows a person whom the tracker misses.
    """

    changes: Changes
    lost_s: Floats
    unseen: int = 0


def last_pass(
    sessions: Sequence[LastPassInput],
    *,
    human_places: Mapping[str, Place],
    levels: Sequence[float],
    evidence: Evidence,
    signals: Sequence[str],
    most_changes: int,
    folder: Path,
) -> list[LastPassResult]:
    """Complete the samples of sessions that share a file; return the changes of level and the lost time of each.

    Args:
        sessions: The sessions.
        human_places: Places of the operator.
        levels: Levels of the scaling, ascending.
        evidence: Evidence on causes of lost time.
        signals: Names of the signals that show people, in the order of their bits.
        most_changes: Maximum number of changes per session for which distances are returned.
        folder: Folder of the files of samples.
    """
    times: list[Vector] = [np.empty(0)]
    places: list[Vector] = [np.empty((0, 6))]
    lost = [np.zeros((len(one.task_times), len(schema.SCALING_CAUSES))) for one in sessions]
    counts, unseen = [len(one.label) for one in sessions], [0] * len(sessions)
    if sum(counts):
        file = folder / f"{sessions[0].part}.parquet"
        written = file.with_suffix(".part")
        frames = _completed(file, sessions, human_places, times, places)
        write_samples(_with_causes(frames, sessions, evidence, signals, lost, unseen), written)
        written.replace(file)  # a repetition after a crash finds either file
    ends = np.cumsum(counts)[:-1]
    apart = (np.split(np.concatenate(parts), ends) for parts in (times, places))
    return [
        LastPassResult(Changes.of(_changes(one, levels), t_s, at[:, :3], at[:, 3:], most_changes), mine, count)
        for one, t_s, at, mine, count in zip(sessions, *apart, lost, unseen, strict=True)
    ]


def _with_causes(
    frames: Iterator[pl.DataFrame],
    sessions: Sequence[LastPassInput],
    evidence: Evidence,
    signals: Sequence[str],
    lost: Sequence[Floats],
    unseen: list[int],
) -> Iterator[pl.DataFrame]:
    """Yield the samples with the cause of lost time and the presence signals; add the lost time per task to `lost`.

    A person whom a signal shows and the tracker misses is marked `occluded` and counted in `unseen`.
    """
    ends = np.cumsum([len(one.label) for one in sessions])
    first = 0
    for frame in frames:
        causes, gaps, bits = list[pl.Series](), list[pl.Series](), list[pl.Series]()
        begin = first
        while begin < first + frame.height:
            number = int(np.searchsorted(ends, begin, side="right"))
            end = min(int(ends[number]), first + frame.height)
            bits.append(_bits(frame[begin - first : end - first], sessions[number].switches, signals))
            some, hidden = _with_unseen(frame[begin - first : end - first], sessions[number].switches, signals)
            gaps.append(some["human_gap"])
            unseen[number] += hidden
            causes.append(_lost_to(some, sessions[number], evidence, lost[number]))
            begin = end
        first += frame.height
        yield frame.with_columns(lost_to=pl.concat(causes), human_gap=pl.concat(gaps), human_signals=pl.concat(bits))


def _with_unseen(
    samples: pl.DataFrame, switches: Mapping[str, TwoStateSignal], signals: Sequence[str]
) -> tuple[pl.DataFrame, int]:
    """Return samples of one session, `occluded` instead of `absent` where a signal shows a person; and their number."""
    absent = (samples["human_gap"] == "absent").fill_null(value=False).to_numpy()
    known = [name for name in signals if name in switches]
    if not absent.any() or not known:
        return samples, 0
    t_s = samples["t_s"].to_numpy()
    hidden = absent & np.logical_or.reduce([switches[name].at(t_s) for name in known])
    gap = pl.when(pl.Series(hidden)).then(pl.lit("occluded")).otherwise(pl.col("human_gap"))
    return samples.with_columns(gap.cast(samples["human_gap"].dtype).alias("human_gap")), int(hidden.sum())


def _bits(samples: pl.DataFrame, switches: Mapping[str, TwoStateSignal], signals: Sequence[str]) -> pl.Series:
    """Return the states of the presence signals as a bit field; null unless all were logged."""
    if not signals or not all(name in switches for name in signals):
        return pl.Series([None], dtype=pl.Int64).new_from_index(0, samples.height)
    t_s, found = samples["t_s"].to_numpy(), np.zeros(samples.height, np.int64)
    for k, name in enumerate(signals):
        found |= switches[name].at(t_s).astype(np.int64) << k
    return pl.Series(found)


def _lost_to(samples: pl.DataFrame, session: LastPassInput, evidence: Evidence, lost: Floats) -> pl.Series:
    """Return the main cause of lost time for each sample of one session; add the lost time per task to `lost`."""
    shares = lost_shares(rows_of(samples, session.switches), evidence)
    t_s, moving = samples["t_s"].to_numpy(), samples["robot_moving"].fill_null(value=False).to_numpy()
    slider = (samples["slider"].fill_null(1.0) * -1 + 1) * samples["scaling"].fill_null(0.0)
    paused = samples["scaling_gap"].is_in(["paused", "stopped"]).fill_null(value=False).to_numpy()
    every = dict(zip(schema.SCALING_CAUSES, shares.T, strict=True))
    every |= {"slider": slider.to_numpy() * moving, "pause": paused * 1.0, "wait": np.zeros(len(t_s))}
    if len(session.task_times):
        leg = np.clip(np.searchsorted(session.task_times[:, 0], t_s + 1e-9, side="right") - 1, 0, None)
        within = (t_s >= session.task_times[leg, 0] - 1e-9) & (t_s < session.task_times[leg, 3])
        short = within & (t_s >= session.task_times[leg, 4]) & (t_s < session.task_times[leg, 5]) & ~paused
        np.add.at(lost, leg[within & ~short], shares[within & ~short])
        every["wait"] = (short | (within & (t_s >= session.task_times[leg, 2]) & ~moving & ~paused)) * 1.0
    parts = np.column_stack([every[name] for name in schema.LOST_CAUSES])
    main = parts.argmax(axis=1)
    names = pl.Series(schema.LOST_CAUSES)[main]
    return pl.select(pl.when(pl.Series(parts.max(axis=1) > _MIN_SHARE)).then(names)).to_series().alias("lost_to")


def _changes(session: LastPassInput, levels: Sequence[float]) -> list[LevelChange]:
    if len(levels) < 2:
        return []  # without reading the log
    parts = (part for run in session.runs for _, part in pieces(run))
    return [change for part in parts for change in changes_of(part.t_s, part.scaling, levels)]


def _completed(
    file: Path,
    sessions: Sequence[LastPassInput],
    human_places: Mapping[str, Place],
    times: list[Vector],
    places: list[Vector],
) -> Iterator[pl.DataFrame]:
    """Yield the samples with goals and levels, in parts; append times and positions of TCP and operator, (N, 6)."""
    goals = [goal for one in sessions for goal in _goals(one, human_places)]
    labels = np.concatenate([one.label for one in sessions])
    ends = np.cumsum([len(one.label) for one in sessions])
    logged = np.array([one.goals_logged for one in sessions])
    until_s, from_s = np.array([(one.absence.until_s, one.absence.from_s) for one in sessions]).T
    first = 0
    for samples in (some for part in parts_of(file) for some in part.iter_slices(AT_ONCE)):
        rows = slice(first, first + samples.height)
        first += samples.height
        whose = np.searchsorted(ends, np.arange(rows.start, rows.stop), side="right")
        known = samples["human_task"].to_list() if logged.any() else []
        goal_of_row = [known[i] if logged[n] else goals[rows.start + i] for i, n in enumerate(whose.tolist())]
        step = pl.Series("step", labels[rows], dtype=pl.Int32)
        samples = _with_absence(samples, until_s[whose], from_s[whose])
        done = with_goals(samples, goal_of_row, human_places)
        done = schema.conform(done.with_columns(step=pl.when(step >= 0).then(step)), schema.SAMPLES)
        times.append(done["t_s"].to_numpy())
        places.append(done.select(f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz").to_numpy())
        yield done


def _goals(session: LastPassInput, human_places: Mapping[str, Place]) -> list[str | None]:
    """Return the operator's goal at each sample, from standstills; None where logged events give it."""
    if session.goals_logged:
        return [None] * len(session.label)
    return [
        goal
        for s in session.operator_standstills
        for goal in goals_from_standstills(s.spans, s.at_m, s.samples, human_places)
    ]


def _with_absence(samples: pl.DataFrame, until_s: Vector, from_s: Vector) -> pl.DataFrame:
    """Return samples with gap `outside` replaced by `absent` where the tracker's silence proves it.

    Args:
        samples: N samples.
        until_s: Time until which no operator was present, session seconds, for each sample, shape (N,).
        from_s: Time from which no operator was present, likewise.
    """
    silent = (pl.col("t_s") < pl.Series(until_s)) | (pl.col("t_s") > pl.Series(from_s))
    gap = pl.col("human_gap")
    return samples.with_columns(human_gap=pl.when((gap == "outside") & silent).then(pl.lit("absent")).otherwise(gap))
