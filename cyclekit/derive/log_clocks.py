"""Clocks tested by the logs: the place of anybody tells the robot's level of speed, but only at the true lag.

The clock of every tracker is tested, assumed or stated. An assumed one is aligned if the logs leave no doubt; a stated
one is contradicted, and aligned on request. Logs that share one offset are tested together. So are the clocks of traces
and events: the states of their signals tell the robot's speed, motion and own signals. Those that are wrong are named,
not aligned: places and executions rest on their signals already.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import structs

from cyclekit.alignment.clocks import ASSUMED, ClockFit
from cyclekit.alignment.clocks.explained import CELL_M, STEP_S, FoundLag, Instants, cells_of, find_lag, numbered
from cyclekit.alignment.clocks.response_lag import (
    AROUND_S,
    FINE_CELL_M,
    FINE_S,
    PlacesAndLevel,
    RefinedLag,
    refine_lag,
    refine_states,
)
from cyclekit.alignment.recording_clocks import of_one_kind
from cyclekit.dataset.cards import ClockTest, note
from cyclekit.dataset.signals import REGISTER
from cyclekit.derive.clock_grids import (
    MAX_PEOPLE,
    motion_of,
    on_grid,
    signals_of,
    states_of,
    where_people_are,
    with_equal_rows,
)
from cyclekit.people.activity import person_tracks

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import Source
    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read, SignalChanges, Stored
    from cyclekit.derive.over_sessions import Passes
    from cyclekit.segmentation.stored_run import Run

REACTION_S = (-0.3, 0.8)
"""A lag between these may be the reaction time of the safety function (0.5 s in UR's reduced mode, and a scanner's),
and contradicts no clock, s. Half calls the right clock of a function that reacts in 0.5 s wrong; twice
keeps one that is 1.5 s off."""
CONTRADICTED = "clock-contradicted"
"""Code of the note on a clock that is wrong for certain."""
GRIDS = ((0.0, 0.0), (0.25, 0.5), (0.5, 0.25), (0.75, 0.75))
"""By how many widths of a cell the grids of the refinement are moved along the axes of the floor: a lattice."""


class ClockPart(NamedTuple):
    """What one session has of a clock: logs, the runs of its robot, and the robot's log."""

    logs: tuple[RecordingCard, ...]
    runs: tuple[Run, ...]
    robot: RecordingCard


@dataclass(frozen=True)
class SameClock:
    """Logs of people, or of signals, that share one unknown offset."""

    sessions: tuple[ClockPart, ...]

    @property
    def logs(self) -> list[RecordingCard]:
        """The logs."""
        return [log for part in self.sessions for log in part.logs]

    @property
    def of_people(self) -> bool:
        """Whether they are of people."""
        return "people" in self.logs[0].tables


class Tested(NamedTuple):
    """What the logs say about a clock.

    `delay_s`: How much later than a reaction what is tested may come in the process, s: nobody can tell such a delay
    from a clock.
    """

    found: FoundLag
    refined: RefinedLag | None
    delay_s: float = 0.0

    @property
    def lag_s(self) -> float:
        """The lag, s."""
        return self.found.lag_s if self.refined is None else self.refined.lag_s

    @property
    def error_s(self) -> float:
        """Maximum error of the lag, s."""
        return STEP_S if self.refined is None else self.refined.bound_s

    @property
    def apart_s(self) -> float:
        """How far the lag is from every reaction time, its error taken off, s."""
        return max(REACTION_S[0] - self.lag_s, self.lag_s - REACTION_S[1]) - self.error_s

    @property
    def contradicts(self) -> bool:
        """Whether the clock is wrong for certain: no reaction time lies within the error of the lag."""
        return (self.found.certain or self.found.contradicts) and self.apart_s > self.delay_s


def with_tested_clocks(
    passes: Passes,
    sessions: Sequence[Session],
    runs: Sequence[Run],
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
    *,
    asked: bool,
) -> list[Session]:
    """Return the sessions, their clocks tested by the logs, and those that are wrong aligned or named.

    Args:
        passes: Runs the work on the sessions.
        sessions: The sessions.
        runs: All runs of the robot, with logged or inferred scaling.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table).
        stored: Opens the robot table of a recording (id, columns).
        asked: Use the lag of every assumed clock, certain or not, and of stated clocks that the logs contradict.
    """
    test = partial(_tested, sources=sources, read=read, stored=stored)
    groups = _groups(sessions, runs, sources)
    tested = passes.over(test, groups, "speed", "clocks") if groups else []
    together = _assumed_together(groups, tested, sources)
    again = passes.over(test, together, "speed", "clocks") if together else []
    own = [log for session in sessions for log in session.recordings if log.clock.method == "own"]
    began_s = {log.session: log.first_s for log in own}
    fits: dict[str, ClockFit] = {}
    for group, found in zip([*groups, *together], [*tested, *again], strict=True):
        if group in together and not (found is not None and found.found.certain):
            continue
        fits |= {log.id: _fit(log, found, began_s[log.session], asked=asked) for log in group.logs}
    fits |= _in_other_parts(sessions, fits)
    return [_with_clocks(session, fits) for session in sessions]


def _in_other_parts(sessions: Sequence[Session], fits: Mapping[str, ClockFit]) -> dict[str, ClockFit]:
    """Return clocks that put a log of several parts of a robot's log outside of those to which nothing relates it.

    Only the first part may be assumed to start with the log: nobody knows how long a restart took.
    """
    first: set[str] = set()
    away: dict[str, ClockFit] = {}
    for session in sessions:
        for log in session.recordings:
            if log.id in fits and log.shown in first and fits[log.id].method == ASSUMED:
                end_s = max(one.span_s[1] for one in session.recordings if "people" not in one.tables)
                said = (note("clock-part-unknown"), *fits[log.id].warnings[1:])
                away[log.id] = replace(fits[log.id], offset_s=end_s + 1.0 - log.first_s, warnings=said)
        first |= {log.shown for log in session.recordings}
    return away


def _groups(sessions: Sequence[Session], runs: Sequence[Run], sources: Mapping[str, Source | None]) -> list[SameClock]:
    """Return the logs of people and signals to test: stated clocks by source, assumed ones by session and clock."""
    stated: dict[tuple[tuple[str, ...], ...], list[ClockPart]] = {}
    alone: list[SameClock] = []
    for session in sessions:
        mine = tuple(runs[number] for number in session.runs)
        kinds: dict[tuple[str, ...], list[RecordingCard]] = {}
        for log in session.recordings:
            known = log.clock.method in ("own", "same-log") or log.clock.same_as is not None
            if mine and not known and not {"people", "events"}.isdisjoint(log.tables):
                kinds.setdefault((log.clock.method, *of_one_kind(log, sources)), []).append(log)
        robot = next((log for log in session.recordings if log.clock.method == "own"), session.recordings[0])
        for kind, logs in kinds.items():
            spans = sorted(log.span_s for log in logs)
            if kind[0] != ASSUMED:
                stated.setdefault((kind, of_one_kind(robot, sources)), []).append(ClockPart(tuple(logs), mine, robot))
            elif all(before[1] <= after[0] for before, after in pairwise(spans)):
                alone.append(SameClock((ClockPart(tuple(logs), mine, robot),)))
            else:
                alone += [SameClock((ClockPart((log,), mine, robot),)) for log in logs]
    return [*(group for parts in stated.values() for group in of_one_robot(parts)), *alone]


def of_one_robot(parts: Sequence[ClockPart]) -> list[SameClock]:
    """Return parts of sessions as of one clock; alone where robots' logs overlap, which are of several robots."""
    spans = sorted((part.robot.first_s, part.robot.last_s) for part in parts)
    apart = all(before[1] <= after[0] for before, after in pairwise(spans))
    return [SameClock(tuple(parts))] if apart else [SameClock((part,)) for part in parts]


def _assumed_together(
    groups: Sequence[SameClock], tested: Sequence[Tested | None], sources: Mapping[str, Source | None]
) -> list[SameClock]:
    """Return the assumed clocks of each source that are not certain alone, as one: devices may be started together."""
    left: dict[tuple[str, ...], list[SameClock]] = {}
    for group, found in zip(groups, tested, strict=True):
        if group.logs[0].clock.method == ASSUMED and not (found is not None and found.found.certain):
            left.setdefault(of_one_kind(group.logs[0], sources), []).append(group)
    return [SameClock(tuple(part for one in some for part in one.sessions)) for some in left.values() if len(some) > 1]


def _tested(group: SameClock, *, sources: Mapping[str, Source | None], read: Read, stored: Stored) -> Tested | None:
    """Return what the logs say about a clock; None if they say nothing."""
    return _by_people(group, sources, read) if group.of_people else by_signals(group, read, stored)


def by_signals(group: SameClock, read: Read, stored: Stored) -> Tested | None:
    """Return what the states of signals say about their clock."""
    parts = []
    for logs, runs, robot in group.sessions:
        told = [(log.span_s, signals_of(log, read, stored)) for log in logs]
        t_s, tcp_m, level = motion_of(runs)
        if len(t_s) > 1:
            parts.append((told, t_s, tcp_m, level, signals_of(robot, read, stored)))
    values = {
        (name, value) for told, *_ in parts for _, mine in told for name, one in mine.items() for value in one.value
    }
    codes = {pair: number for number, pair in enumerate(sorted(values))}
    own = sorted({name for *_, mine in parts for name in mine if name != REGISTER})

    def instants(step_s: float, lag_s: float | None = None) -> list[Instants]:
        made = []
        for told, t_s, tcp_m, level, mine in parts:
            met = told if lag_s is None else _met_by(told, t_s[0] - lag_s - AROUND_S, t_s[-1] - lag_s + AROUND_S)
            if not met:
                continue
            label, label_at = states_of(met, codes, step_s)
            way_m, apart_s = np.linalg.norm(np.gradient(tcp_m, axis=0), axis=1), np.gradient(t_s)
            speed = np.divide(way_m, apart_s, out=np.full(len(t_s), np.nan), where=apart_s > 0.0)
            bits = [mine[name].at(t_s) == "1" if name in mine else np.full(len(t_s), np.nan) for name in own]
            robot, robot_at = on_grid(t_s, np.column_stack([level, speed, *bits]), step_s)
            made.append(Instants(label, label_at, robot.T, robot_at))
        return made

    if not codes or (found := find_lag(instants(STEP_S))) is None:
        return None
    between = [_usual_interval_s(one) for told, *_ in parts for _, mine in told for one in mine.values()]
    return Tested(found, refine_states(instants(FINE_S, found.lag_s), found.lag_s), min(between))


def _met_by(
    told: Sequence[tuple[tuple[float, float], Mapping[str, SignalChanges]]], first_s: float, last_s: float
) -> list[tuple[tuple[float, float], Mapping[str, SignalChanges]]]:
    """Return logs of signals with the part of their spans between two times, s; none that has no such part."""
    cut = [((max(span[0], first_s), min(span[1], last_s)), mine) for span, mine in told]
    return [(span, mine) for span, mine in cut if span[1] - span[0] >= STEP_S]


def _usual_interval_s(one: SignalChanges) -> float:
    """Return the least median time from a value of a signal to the next time it has it, s; inf if none comes again."""
    apart = [np.diff(one.t_s[one.value == value]) for value in np.unique(one.value)]
    return min((float(np.median(times)) for times in apart if len(times)), default=np.inf)


def _by_people(group: SameClock, sources: Mapping[str, Source | None], read: Read) -> Tested | None:
    """Return what the place of people says about their clock."""
    seen, coarse = [], []
    for logs, runs, _ in group.sessions:
        tracks, (t_s, tcp_m, level) = person_tracks(logs, sources, read), motion_of(runs)
        if not tracks or len(t_s) < 2:
            continue
        seen.append((tracks, [log.span_s for log in logs], t_s, tcp_m, level))
        label, label_at = where_people_are(*seen[-1][:2], STEP_S, CELL_M)
        robot, robot_at = on_grid(t_s, level[:, None], STEP_S)
        coarse.append(Instants(label, label_at, robot.T, robot_at))
    if not coarse or any(len(one.label) > MAX_PEOPLE for one in coarse):
        return None
    if (found := find_lag(with_equal_rows(coarse))) is None:
        return None
    robots = [on_grid(t_s, np.column_stack([tcp_m[:, :2], level]), FINE_S) for _, _, t_s, tcp_m, level in seen]

    def in_cells(moved: tuple[float, float]) -> list[PlacesAndLevel]:
        people = [where_people_are(*one[:2], FINE_S, FINE_CELL_M, moved) for one in seen]
        places = [cells_of(rows[:, :2], FINE_CELL_M, moved) for rows, _ in robots]
        labels = numbered([*(label for label, _ in people), *places])
        return [
            PlacesAndLevel(labels[number], people[number][1], labels[len(people) + number], rows[:, 2], at)
            for number, (rows, at) in enumerate(robots)
        ]

    return Tested(found, refine_lag([in_cells(moved) for moved in GRIDS], found.lag_s))


def _fit(log: RecordingCard, tested: Tested | None, began_s: float, *, asked: bool) -> ClockFit:
    """Return the clock of a log, with what the logs say about it; the robot's time begins at `began_s`."""
    clock, assumed = ClockFit.of(log.clock), log.clock.method == ASSUMED
    of_people = "people" in log.tables
    if tested is None or not (of_people or tested.found.certain):
        clock = _warned(clock, "clock-not-by-logs") if asked and assumed else clock
    if tested is None:
        return clock
    found, lag_s = tested.found, tested.lag_s
    test = ClockTest(
        lag_s=lag_s, explained=found.explained, next_best=found.next_best, here=found.here, certain=found.certain
    )
    clock = replace(clock, test=test)
    if not (tested.contradicts or (asked and assumed and of_people)):
        return clock
    values = {"lag_s": lag_s, "error_s": tested.error_s, "explained": found.explained, "next_best": found.next_best}
    line = _line(clock, tested)
    if not found.certain and not (assumed or asked):
        return _warned(clock, CONTRADICTED, **values, other_s=found.next_s, here=found.here or 0.0)
    if not of_people:
        return _warned(clock, CONTRADICTED, offset_s=line.offset_s + began_s, signals=1.0, **values)
    if not (assumed or asked):
        rate = {} if line.rate == 1.0 else {"rate": line.rate}
        here = {} if found.here is None else {"here": found.here}
        return _warned(clock, CONTRADICTED, offset_s=line.offset_s + began_s, **values, **rate, **here)
    code = "clock-by-logs" if found.certain else "clock-by-logs-unsure"
    return replace(line, warnings=(note(code, **values, away_s=found.next_s - found.lag_s),))


def _line(clock: ClockFit, tested: Tested) -> ClockFit:
    """Return the clock with the lag that the logs show."""
    refined = tested.refined or RefinedLag(tested.lag_s, 0.0, 0.0, STEP_S)
    return replace(
        clock,
        method="logs",
        offset_s=clock.offset_s * (1.0 + refined.drift) + refined.lag_s - refined.drift * refined.about_s,
        rate=clock.rate * (1.0 + refined.drift),
        residual_s=refined.residual_s,
    )


def _warned(clock: ClockFit, code: str, **values: float) -> ClockFit:
    return replace(clock, warnings=(note(code, **values), *clock.warnings))


def _with_clocks(session: Session, fits: Mapping[str, ClockFit]) -> Session:
    """Return a session with other clocks of some logs, and of those that share them."""
    fits = dict(fits)
    for log in session.recordings:
        if log.clock.same_as in fits:
            fits[log.id] = replace(fits[log.clock.same_as], same_as=log.clock.same_as)
    if not any(log.id in fits for log in session.recordings):
        return session
    logs = tuple(
        structs.replace(log, clock=fits[log.id].card(log.clock.kind)) if log.id in fits else log
        for log in session.recordings
    )
    starts, ends = zip(*(log.span_s for log in logs), strict=True)
    return replace(session, recordings=logs, span_s=(min(starts), max(ends)))
