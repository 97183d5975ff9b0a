"""Clocks of robots beside each other: each robot's log is a session of its own, and only signals relate them.

The signals of one robot tell what the other does, at one lag for certain; `log_clocks` searches it, as for a PLC's
trace. But a process may take as long as a clock is off. Only where an output of each robot is an input of the other,
edge by edge, at that lag, it is the clock's: a delay of the process would be a lag of the other sign in the other
direction. What is found is named, not used: no session rests on the clock of another.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs
from scipy.special import bdtrc

from cyclekit.alignment.clocks.explained import CHANCE
from cyclekit.alignment.recording_clocks import of_one_kind
from cyclekit.alignment.spans import Beside, robots_beside
from cyclekit.dataset.cards import ClockTest, note
from cyclekit.dataset.signals import OUTPUT, REGISTER
from cyclekit.derive.clock_grids import signals_of
from cyclekit.derive.log_clocks import (
    CONTRADICTED,
    REACTION_S,
    ClockPart,
    SameClock,
    by_signals,
    of_one_robot,
    with_tested_clocks,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit.config import Source
    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read, SignalChanges, Stored
    from cyclekit.derive.log_clocks import Tested
    from cyclekit.derive.over_sessions import Passes
    from cyclekit.schema import Vector
    from cyclekit.segmentation.stored_run import Run

WRONG = "robot-clock-wrong"
"""Code of the note on a robot's clock that is wrong for certain."""
OF_BOTH = "outputs of each robot and inputs of the other"
WIRE_S, WIRED = 0.3, 0.9
"""Maximum time from an output to the input that it is, s, by way of a PLC; and the share of edges that both have, as a
log may begin or end within a pulse: statistical levels. At half of the time no clock of inputs that follow by 0.12 s is
called wrong (eight of eight are), at twice also those of 0.25 s; half and twice of the share left out change nothing.
None of 20 right ones is called wrong by any."""


def with_clocks_tested(
    passes: Passes,
    sessions: Sequence[Session],
    runs: Sequence[Run],
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
    *,
    asked: bool,
) -> list[Session]:
    """Return the sessions, their clocks tested, and robots compared whose logs are of the same time.

    Arguments: see `log_clocks.with_tested_clocks`.
    """
    sessions = with_tested_clocks(passes, sessions, runs, sources, read, stored, asked=asked)
    by_robot = {session.recordings[0].id: session for session in sessions if session.recordings}
    pairs = robots_beside((session.recordings[0] for session in by_robot.values()), sources)
    shared = [_by_shared_logs(by_robot[one.log.id], by_robot[one.robot.id], sources) for one in pairs]
    cards = {card.id: card for some in shared for card in some}
    groups = _groups([one for one, some in zip(pairs, shared, strict=True) if not some], by_robot, runs, sources)
    test = partial(_tested, read=read, stored=stored)
    tested = passes.over(test, groups, "speed", "clocks of robots") if groups else []
    for group, found in zip(groups, tested, strict=True):
        if found is not None and found[0].found.certain:
            for (log,), _, robot in group.sessions:
                cards[log.id] = _told(by_robot[log.id].recordings[0], robot, *found, sources[log.id])
    return [
        replace(session, recordings=tuple(cards.get(one.id, one) for one in session.recordings)) for session in sessions
    ]


def _groups(
    pairs: Sequence[Beside], by_robot: Mapping[str, Session], runs: Sequence[Run], sources: Mapping[str, Source | None]
) -> list[SameClock]:
    """Return the logs to compare: those of two sections of the cell file together, others pair by pair."""
    found: dict[tuple[tuple[str, ...], ...], list[ClockPart]] = {}
    for log, robot, _ in pairs:
        mine, beside = by_robot[log.id].recordings[0], by_robot[robot.id]
        on_its_clock = structs.replace(mine, clock=structs.replace(mine.clock, offset_s=-robot.first_s))
        key = tuple((*of_one_kind(one, sources), "" if sources[one.id] else one.id) for one in (log, robot))
        if beside.runs:
            part = ClockPart((on_its_clock,), tuple(runs[number] for number in beside.runs), beside.recordings[0])
            found.setdefault(key, []).append(part)
    return [group for parts in found.values() for group in of_one_robot(parts)]


def _tested(group: SameClock, *, read: Read, stored: Stored) -> tuple[Tested, bool] | None:
    """Return the lag at which the signals of a robot tell what the other does, and whether it is the clock's."""
    if (found := by_signals(group, read, stored)) is None:
        return None
    mine, theirs, spans = [], [], []
    for (log,), _, robot in group.sessions:
        later = signals_of(log, read, stored)
        mine.append({name: one._replace(t_s=one.t_s + found.lag_s) for name, one in later.items()})
        theirs.append(signals_of(robot, read, stored))
        begin_s, end_s = max(log.span_s[0] + found.lag_s, 0.0), min(log.span_s[1] + found.lag_s, robot.duration_s)
        spans.append((begin_s + WIRE_S, end_s - WIRE_S))
    return found, _wired(mine, theirs, spans) and _wired(theirs, mine, spans)


def _wired(
    sent: Sequence[Mapping[str, SignalChanges]],
    got: Sequence[Mapping[str, SignalChanges]],
    spans: Sequence[tuple[float, float]],
) -> bool:
    """Return whether an output of one robot is an input of the other: both edges agree, more often than by chance."""
    outputs = {name for one in sent for name in one if name.startswith(OUTPUT)}
    inputs = {name for one in got for name in one if not name.startswith((OUTPUT, REGISTER))}
    level = CHANCE / max(len(outputs) * len(inputs), 1)
    whole_s = sum(max(end - begin, 0.0) for begin, end in spans)
    for output in outputs:
        for name in inputs:
            edges = [
                pair
                for one, other, span in zip(sent, got, spans, strict=True)
                if output in one and name in other
                for pair in _edges(one[output], other[name], span)
            ]
            count = sum(max(len(mine), len(theirs)) for mine, theirs in edges)
            hits = sum(_near(mine, theirs) for mine, theirs in edges)
            chance = min(2.0 * WIRE_S * sum(len(theirs) for _, theirs in edges) / max(whole_s, 1e-9), 1.0)
            if count and hits >= WIRED * count and bdtrc(hits - 1, count, chance) < level:
                return True
    return False


def _edges(sent: SignalChanges, got: SignalChanges, span: tuple[float, float]) -> Iterator[tuple[Vector, Vector]]:
    """Yield the times at which two signals fall, and rise, within a span."""
    for value in ("0", "1"):
        mine, theirs = sent.to(value), got.to(value)
        first, second = (times[(times >= span[0]) & (times <= span[1])] for times in (mine, theirs))
        yield first, second


def _near(times: Vector, others: Vector) -> int:
    """Return the number of times that have another within WIRE_S."""
    padded = np.concatenate([[-np.inf], others, [np.inf]])
    after = np.searchsorted(padded, times)
    return int((np.minimum(padded[after] - times, times - padded[after - 1]) <= WIRE_S).sum())


def _told(
    log: RecordingCard, robot: RecordingCard, tested: Tested, is_clock: bool, source: Source | None
) -> RecordingCard:
    """Return a robot's log with what was found for certain about its clock beside another robot's."""
    best, lag_s = tested.found, tested.lag_s
    test = ClockTest(lag_s=lag_s, explained=best.explained, next_best=best.next_best, here=best.here, certain=is_clock)
    log = structs.replace(log, clock=structs.replace(log.clock, test=test))
    if is_clock and abs(lag_s) > WIRE_S + tested.error_s:
        return _noted(log, WRONG, robot, lag_s, source, by=OF_BOTH, error_s=tested.error_s)
    if not is_clock and tested.apart_s > 0.0:
        return _noted(log, "robot-clock-or-process", robot, lag_s, source)
    return log


def _by_shared_logs(mine: Session, theirs: Session, sources: Mapping[str, Source | None]) -> list[RecordingCard]:
    """Return recordings with what a log that two robots share tells of their clocks; nothing if there is none.

    If it fits each robot at another lag, it is not its own clock that is wrong, but that of the robot farther away.
    """
    robots = {session.recordings[0].session: session.recordings[0] for session in (mine, theirs)}
    logs: dict[str, list[tuple[float, RecordingCard]]] = {}
    for log in (*mine.recordings[1:], *theirs.recordings[1:]):
        if log.clock.test is not None and log.clock.test.certain:
            logs.setdefault(log.shown, []).append((log.clock.test.lag_s, log))
    for both in logs.values():
        if len(both) < 2:
            continue
        (right_s, right), (wrong_s, wrong) = sorted(both, key=lambda one: abs(one[0]))
        said = {one.code: one for one in wrong.clock.warnings}
        error_s = 2.0 * float(said.pop(CONTRADICTED).values["error_s"]) if CONTRADICTED in said else np.inf
        if abs(right_s - wrong_s) <= error_s + REACTION_S[1] - REACTION_S[0]:
            return [right]
        robot, beside = robots[wrong.session], robots[right.session]
        wrong = structs.replace(wrong, clock=structs.replace(wrong.clock, warnings=tuple(said.values())))
        by, off_s = f"the signals of {wrong.shown}", right_s - wrong_s
        return [wrong, _noted(robot, WRONG, beside, off_s, sources[robot.id], by=by, error_s=error_s)]
    return []


def _noted(
    log: RecordingCard, code: str, robot: RecordingCard, lag_s: float, source: Source | None, **values: str | float
) -> RecordingCard:
    """Return a robot's log with a note on its clock."""
    offset_s = ((source and source.clock_offset_s) or 0.0) + lag_s
    said = note(code, robot=robot.shown, lag_s=lag_s, offset_s=offset_s, **values)
    return structs.replace(log, clock=structs.replace(log.clock, warnings=(*log.clock.warnings, said)))
