"""Position x_h, task and goal of the operator at every sample of every execution.

Tracks of a session are converted to its time and the base frame. Goals come from the signals that the cell file names
(`goal_signals`), otherwise from the standstills of the operator in all sessions. `tracks` samples a single track.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.alignment.frames import to_base
from cyclekit.dataset.cards import Note, OperatorCard, RecordingCard, note
from cyclekit.dataset.dataset import Place
from cyclekit.people.lost_edges import standstill_times
from cyclekit.people.silence import Silence
from cyclekit.people.tracks import (
    REASONS,
    STILL_S,
    PersonTrack,
    find_operator_places,
    find_operator_standstills,
    gap_reasons,
    goals_from_events,
    ids_are_real,
    link_by_motion,
    nearest_person,
    operator_place,
    without_jumps,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.sessions import Session
    from cyclekit.schema import Bools, Floats, Ints, Points, Vector

    Read = Callable[[str, str], pl.DataFrame | None]

_HUMAN = tuple(f"human_{axis}_m" for axis in "xyz")
HEIGHT_M = 1.5
"""Maximum plausible height range of a person at work, m, over at least ENOUGH positions; if exceeded, the height axis
is probably a floor axis."""
ENOUGH = 100


@dataclass(frozen=True)
class _Log:
    """The tracks in one recording, in session time and base frame."""

    recording: RecordingCard
    tracks: list[PersonTrack]
    silence: Silence
    not_believed: int
    warnings: tuple[Note, ...]


@dataclass(frozen=True)
class OperatorStandstills:
    """Standstills of the operator in one execution.

    Attributes:
        samples: Number of samples of the execution.
        spans: First and last sample of each standstill.
        known_s: Time from which and until which standstills are known, session seconds.
        times_s: Start and end of each standstill, shape (M, 2), session seconds.
        at_m: Position of each standstill, shape (M, 3), m.
        goals: Goal from events in the middle of each standstill; empty if the session has no goal events.
        told: Whether the session has goal events.
    """

    samples: int
    known_s: tuple[float, float]
    spans: list[tuple[int, int]]
    times_s: Floats
    at_m: Points
    goals: list[str | None]
    told: bool

    @property
    def took_s(self) -> Vector:
        """Duration of each standstill, shape (M,), s."""
        return np.asarray(self.times_s[:, 1] - self.times_s[:, 0])

    def only(self, kept: Bools) -> OperatorStandstills:
        """Return some of the standstills: those where `kept`, shape (M,), is true."""
        rows = np.flatnonzero(kept).tolist()
        goals = [self.goals[n] for n in rows] if self.goals else []
        spans = [self.spans[n] for n in rows]
        return replace(self, spans=spans, times_s=self.times_s[rows], at_m=self.at_m[rows], goals=goals)


@dataclass(frozen=True)
class Seen:
    """The operator at the samples of one execution.

    Attributes:
        human_m: x_h, shape (T, 3), m; NaN = unknown.
        reasons: Whether any log of the session sees an operator, or why not, shape (T,), indices into REASONS; None =
            there is no log of people.
        goals: Goal from events at each of the T samples; empty if the session has no goal events.
        standstills: Standstills of the operator.
    """

    human_m: Points
    reasons: NDArray[np.int8] | None
    goals: list[str | None]
    standstills: OperatorStandstills

    def columns(self, rows: slice) -> dict[str, NDArray[Any] | list[str | None]]:
        """Return the operator's columns of table SAMPLES for some samples; NaN = null."""
        human_m = self.human_m[rows]
        columns: dict[str, NDArray[Any] | list[str | None]] = {name: human_m[:, k] for k, name in enumerate(_HUMAN)}
        if self.reasons is not None:
            columns["human_gap"] = _why_unseen(human_m, self.reasons[rows])
        if self.goals:
            columns["human_task"] = self.goals[rows]
        return columns


class SessionPeople:
    """The people of one session, evaluated execution by execution."""

    def __init__(self, session: Session, sources: Mapping[str, Source | None], read: Read, cell: Cell) -> None:
        """Convert the tracks to session time and base frame.

        Args:
            session: The session.
            sources: Entry of each recording in the cell file, by id.
            read: Returns a native table of a recording (id, table), None if there is none.
            cell: Cell with bridged gap length and sample rate.
        """
        self._logs, self._events = _operator_logs(session, sources, read, cell.goal_signals)
        self._tracks = [track for log in self._logs for track in log.tracks]
        self._several = 0
        self._counts = [np.zeros(len(REASONS), np.int64) for _ in self._logs]
        self._cell, self._nobody_logged = cell, session.nobody_logged

    def during(self, t_s: Vector, tcp_m: Points) -> Seen:
        """Return the operator in one execution.

        Args:
            t_s: Times of its samples, shape (T,), s.
            tcp_m: The TCP at these times, shape (T, 3), m; NaN = unknown.
        """
        bridge_s, width_s = self._cell.bridge_s, 1.0 / self._cell.rate_hz
        found = [gap_reasons(log.tracks, t_s, log.recording.span_s, bridge_s=bridge_s) for log in self._logs]
        for counts, reasons in zip(self._counts, found, strict=True):
            counts += np.bincount(reasons, minlength=len(REASONS))
        human_m, several = nearest_person(self._tracks, t_s, tcp_m, bridge_s=bridge_s, width_s=width_s)
        self._several += int(several.sum())
        goals = goals_from_events(*self._events, t_s) if len(self._events[0]) else []
        if self._nobody_logged and not found:
            found = [np.full(len(t_s), REASONS.index("outside"), np.int8)]
        return Seen(human_m, np.min(found, axis=0) if found else None, goals, _standstills(t_s, human_m, goals))

    def standstills_until(
        self, next_s: float, seen: Seen, t_s: Vector, tcp_m: Points
    ) -> tuple[OperatorStandstills, float]:
        """Return the operator's standstills from the start of an execution to that of the next, and the end time, s.

        Args:
            next_s: Start of the next execution, s; the search beyond the end covers at most the execution's own
                duration.
            seen: The operator in the execution.
            t_s: Times of its samples, shape (T,), s.
            tcp_m: The TCP at these times, shape (T, 3), m; its last position is used afterwards.
        """
        last_s, rate_hz = float(t_s[-1]), self._cell.rate_hz
        count = int(min(next_s - last_s, last_s - float(t_s[0])) * rate_hz)
        if count <= 0:
            return seen.standstills, last_s
        more_s = last_s + np.arange(1, count + 1) / rate_hz
        more_m, _ = nearest_person(
            self._tracks, more_s, np.tile(tcp_m[-1], (count, 1)), bridge_s=self._cell.bridge_s, width_s=1.0 / rate_hz
        )
        whole_s, whole_m = np.concatenate([t_s, more_s]), np.concatenate([seen.human_m, more_m])
        return _standstills(whole_s, whole_m, []), float(whole_s[-1])

    @property
    def silences(self) -> list[Silence]:
        """How each log of people starts, ends and pauses."""
        empty = Silence.of(np.empty(0), np.empty((0, 3)), None)
        return [log.silence for log in self._logs] + [empty] * (self._nobody_logged and not self._logs)

    def cards(self) -> dict[str, OperatorCard]:
        """Return per recording the number of samples with a visible operator, with several, and of the others."""
        return {
            log.recording.id: OperatorCard(
                not_believed=log.not_believed,
                several=self._several,
                warnings=log.warnings,
                **dict(zip(REASONS, counts.tolist(), strict=True)),
            )
            for log, counts in zip(self._logs, self._counts, strict=True)
        }


def _standstills(t_s: Vector, human_m: Points, goals: Sequence[str | None]) -> OperatorStandstills:
    spans = find_operator_standstills(t_s, human_m)
    seen = np.asarray(np.isfinite(human_m[:, :2]).all(axis=1))  # he may be lost for a while in between
    at_m = np.array([np.median(human_m[a : b + 1][seen[a : b + 1]], axis=0) for a, b in spans]).reshape(-1, 3)
    # The middle sample decides, because at the end the next button is pressed before the operator is seen to walk.
    middles = [goals[(a + b) // 2] for a, b in spans] if goals else []
    times_s = standstill_times(t_s, human_m[:, :2], spans)
    known_s = (float(t_s[0]), float(t_s[-1])) if len(t_s) else (0.0, 0.0)
    return OperatorStandstills(len(t_s), known_s, spans, times_s, at_m, middles, told=bool(goals))


def operator_places(standstills: Sequence[OperatorStandstills], cell: Cell) -> dict[str, Place]:
    """Return the operator's places: those of the cell file, and those of goals known only from buttons.

    Without goal events and places in the cell file, they are clusters of the operator's standstills.

    Args:
        standstills: Standstills of every execution of every session; short ones found no place.
        cell: Cell with its places.
    """
    standstills = [mine.only(mine.took_s >= STILL_S) for mine in standstills]
    places = {name: Place(name, p.xyz_m, p.radius_m, inferred=False) for name, p in cell.human_places.items()}
    if not any(mine.told for mine in standstills):
        places = places or find_operator_places(
            np.concatenate([np.empty((0, 3)), *(mine.at_m for mine in standstills)])
        )
    at: dict[str, list[Vector]] = {}
    for mine in standstills:
        for name, xyz_m in zip(mine.goals, mine.at_m, strict=False):  # empty without goal events
            if name is not None and name not in places:
                at.setdefault(name, []).append(xyz_m)
    return places | {name: operator_place(name, np.array(points)) for name, points in sorted(at.items())}


def with_goals(samples: pl.DataFrame, goals: Sequence[str | None], places: Mapping[str, Place]) -> pl.DataFrame:
    """Return samples with the operator's task and g_h.

    Args:
        samples: Rows of table SAMPLES, from `Seen`.
        goals: Name of the goal at each sample.
        places: All places of the operator.
    """
    nowhere = (np.nan, np.nan, np.nan)
    at = np.array([places[name].xyz_m if name and name in places else nowhere for name in goals]).reshape(-1, 3)
    columns = (pl.Series(f"human_goal_{axis}_m", at[:, k], nan_to_null=True) for k, axis in enumerate("xyz"))
    return samples.with_columns(*columns, pl.Series("human_task", goals, dtype=pl.String))


def person_tracks(
    recordings: Sequence[RecordingCard], sources: Mapping[str, Source | None], read: Read
) -> list[PersonTrack]:
    """Return the tracks of all people in the logs of a session, in session time and base frame."""
    logs = [_log(entry, read, sources[entry.id]) for entry in recordings if "people" in entry.tables]
    return [track for log in logs for track in log.tracks]


def _operator_logs(
    session: Session, sources: Mapping[str, Source | None], read: Read, goal_signals: Sequence[str]
) -> tuple[list[_Log], tuple[Vector, list[str]]]:
    logs: list[_Log] = []
    times, values = [np.empty(0)], []
    for entry in session.recordings:
        if "people" in entry.tables:
            logs.append(_log(entry, read, sources[entry.id]))
        said = read(entry.id, "events") if goal_signals and "events" in entry.tables else None
        if said is not None:
            said = said.filter(pl.col("signal").is_in(goal_signals)).sort("t_s")
            times.append(said["t_s"].to_numpy() * entry.clock.rate + entry.clock.offset_s)
            values += said["value"].to_list()
    t_event = np.concatenate(times)
    order = np.argsort(t_event, kind="stable")
    return logs, (t_event[order], [values[i] for i in order.tolist()])


def _log(entry: RecordingCard, read: Read, source: Source | None) -> _Log:
    """Return the tracks of the people in a recording, without implausible positions.

    A tracked body on the robot's flange is not a person. Ids that do not persist are replaced by tracks linked by
    motion.
    """
    warnings: list[Note] = []
    t, xyz, numbers, names = _positions(entry, read, source)
    if not ids_are_real(numbers):
        ids, frames = len(names), len(np.unique(t))
        numbers = link_by_motion(t, xyz)
        names = [f"linked_{number + 1}" for number in range(int(numbers.max(initial=-1)) + 1)]
        warnings.append(note("tracks-linked", ids=ids, frames=frames, tracks=len(names)))
    tracks: list[PersonTrack] = []
    disbelieved = 0
    for rows in _rows_of_each(numbers):
        alone = len(rows) == len(t)  # avoids a copy of many hours
        own = (t, xyz) if alone else (t[rows], xyz[rows])
        parts, dropped = without_jumps(PersonTrack(names[numbers[rows[0]]], *own))
        tracks += parts
        disbelieved += dropped
    if disbelieved:
        warnings.append(note("positions-too-fast", count=disbelieved))
    if (height_m := _height_range(tracks)) > HEIGHT_M:
        warnings.append(note("height-changes", height_m=height_m))
    if tracks and all(np.isnan(track.xyz_m[:, 2]).all() for track in tracks):
        warnings.append(note("heights-unknown"))
    silence = Silence.of(t, xyz, None if source is None else source.silence)
    return _Log(entry, tracks, silence, disbelieved, tuple(warnings))


def _height_range(tracks: Sequence[PersonTrack]) -> float:
    """Return the largest height range of a track, from its 5 % to its 95 % quantile, m."""
    heights = [height[np.isfinite(height)] for track in tracks for height in [track.xyz_m[:, 2]]]
    ranges = [float(np.subtract(*np.quantile(height, [0.95, 0.05]))) for height in heights if len(height) >= ENOUGH]
    return max(ranges, default=0.0)


def _positions(entry: RecordingCard, read: Read, source: Source | None) -> tuple[Vector, Points, Ints, list[str]]:
    """Return the people in a recording ordered by time: times (N,), positions (N, 3), person numbers (N,), names."""
    people = read(entry.id, "people")
    people = schema.empty(schema.PEOPLE) if people is None else people
    people = people.select("t_s", "x_m", "y_m", "z_m", pl.col("person").fill_null(""))
    if source is not None and source.sees is not None:
        rides = pl.col("person") == source.sees_as if source.sees_as is not None else pl.lit(value=True)
        people = people.filter(~rides)
    if not people["t_s"].is_sorted():
        people = people.sort("t_s", maintain_order=True)
    t_s, xyz = people["t_s"].to_numpy(), people.select("x_m", "y_m", "z_m").to_numpy()
    whose = people["person"]
    del people  # saves memory: parts of it are copied several times below
    names = whose.unique().sort().to_list()
    one = len(names) == 1
    numbers = np.zeros(len(whose), np.int64) if one else whose.rank("dense").cast(pl.Int64).to_numpy() - 1
    xyz = to_base(xyz, source.frame if source else None, up=entry.up)
    return t_s * entry.clock.rate + entry.clock.offset_s, xyz, numbers, names


def _rows_of_each(numbers: Ints) -> list[Ints]:
    """Return the rows of each number (N,) that is not negative, ordered by first row."""
    order = np.argsort(numbers, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1) if len(order) else []
    return sorted((rows for rows in parts if numbers[rows[0]] >= 0), key=lambda rows: int(rows[0]))


def _why_unseen(human_m: Points, reasons: NDArray[np.int8]) -> list[str | None]:
    """Return why x_h is unknown at each sample; None if it is known."""
    unseen = np.isnan(human_m[:, 0])
    least = np.maximum(reasons, REASONS.index("occluded"))  # an implausible position counts as occluded
    return [REASONS[reason] if hidden else None for reason, hidden in zip(least, unseen, strict=True)]
