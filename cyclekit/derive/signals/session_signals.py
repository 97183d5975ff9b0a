"""Collect the signals of all sessions, to find those that show people (`operator_signals`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate, compress, pairwise, product
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.alignment.recording_clocks import RESTART_S
from cyclekit.dataset.cards import note
from cyclekit.dataset.signals import INPUT, OUTPUT, SignalChanges, constant_bits, values_of
from cyclekit.derive.causes.cause_samples import MARGIN_S, TwoStateSignal
from cyclekit.derive.concatenated import APART_S, commanded_samples, shifts_apart
from cyclekit.derive.signals.latched_signals import ON, begins_of, latched
from cyclekit.derive.signals.operator_signals import FoundSignals, find_signals
from cyclekit.derive.signals.signal_evidence import SignalEvidence
from cyclekit.scaling.response import LevelChange, SafetyResponse, at_speed, changes_of, rate_of
from cyclekit.segmentation.stored_run import pieces

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from cyclekit.config import Cell
    from cyclekit.dataset.cards import ExecutionCard, Note
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.derive.second_pass import SecondPassResult
    from cyclekit.schema import Ints, Vector
    from cyclekit.segmentation.stored_run import Run

EVIDENCE_SAMPLES = 200_000
"""Approximate maximum number of samples, from evenly spread executions, to find causes of lost time and signals."""
_ALWAYS_S = np.array([-APART_S / 2])
"""Time before all of a session, and after all of the session before it."""
_NUMBERS = ["robot_x_m", "robot_y_m"]


@dataclass(frozen=True)
class PresenceSignals:
    """Signals that show people.

    Attributes:
        found: The signals.
        switches: State of each signal by name, on while a person is present, for each session; may be empty.
        restarted: Number of sessions whose signals were not used, as the robot's clock was restarted in the log.
    """

    found: FoundSignals
    switches: Sequence[Mapping[str, TwoStateSignal]]
    restarted: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals, in the order of their bits."""
        return tuple(one.name for one in self.found.cards)

    def response(self, seen: SafetyResponse) -> SafetyResponse:
        """Return a response with the reaction time to the signals, unless positions gave one."""
        if not self.found.cards or seen.latency_s is not None:
            return seen
        return replace(seen, latency_s=self.found.latency_s, hold_s=self.found.hold_s)


def find_presence_signals(
    sessions: Sequence[SecondPassResult],
    runs: Mapping[str, Sequence[Run]],
    cell: Cell,
    levels: Sequence[float],
    folder: Path,
    read: Read,
    stored: Stored,
) -> PresenceSignals:
    """Return the signals that show people: those of the cell file, else those found in sessions without a tracker.

    If a tracker logs people in every session, no signals are searched for.

    Args:
        sessions: The sessions.
        runs: Runs of the robot, by session.
        cell: Signals named in the cell file.
        levels: Levels of the scaling, ascending.
        folder: Folder of the files of samples.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns) for reading by row ranges.
    """
    without = [not is_tracked(mine) and any(not card.reference for card in mine.cards) for mine in sessions]
    among = sessions if cell.operator_signals or not any(map(is_tracked, sessions)) else [*compress(sessions, without)]
    if len(levels) < 2 or not among:
        return PresenceSignals(FoundSignals(), [{}] * len(sessions))
    values = {mine.session: _values(mine, runs[mine.session], read, stored) for mine in sessions}
    for mine, goal in product(values.values(), cell.goal_signals):
        mine.pop(goal, None)
    restarted = {name for name, mine in values.items() if mine and _restarts(runs[name])}
    values |= {name: {} for name in restarted}
    if not (among := [mine for mine in among if mine.session not in restarted]):
        return PresenceSignals(FoundSignals(), [{}] * len(sessions), len(restarted))
    if not any(values.values()) and not cell.operator_signals:  # nothing to look for in the logs
        return PresenceSignals(FoundSignals(), [{}] * len(sessions), len(restarted))
    _add_held([mine for mine in sessions if mine.session not in restarted], values, stored)
    evidence = _evidence(among, [values[mine.session] for mine in among], runs, levels, folder)
    found = find_signals(evidence, cell.operator_signals)
    switches = [_switches(values[mine.session], found, _begins(runs[mine.session])) for mine in sessions]
    return PresenceSignals(found, switches, len(restarted))


def is_tracked(session: SecondPassResult) -> bool:
    """Return whether a tracker covered a session, also if it saw no one."""
    return bool(session.silences) or any("people" in one.tables for one in session.recordings)


def mixed_sources(sessions: Sequence[SecondPassResult], presence: PresenceSignals) -> list[Note]:
    """Return a note: executions with positions, with signals, and with neither, if they are not all alike."""
    positions = signals = neither = 0
    for mine, switches in zip(sessions, presence.switches, strict=True):
        count = sum(not card.reference for card in mine.cards)
        by_signals = bool(presence.names) and all(name in switches for name in presence.names)
        positions += count * is_tracked(mine)
        signals += count * by_signals
        neither += count * (not is_tracked(mine) and not by_signals)
    if not positions or not (neither or presence.names):
        return []
    return [note("people-mixed", positions=positions, signals=signals, neither=neither)]


def some_executions(sessions: Sequence[SecondPassResult]) -> list[str]:
    """Return the executions used as evidence: all, or every k-th of long logs."""
    every = max(1, round(sum(one.samples for one in sessions) / EVIDENCE_SAMPLES))
    return [card.execution for one in sessions for card in one.cards][::every]


def _values(session: SecondPassResult, runs: Sequence[Run], read: Read, stored: Stored) -> dict[str, SignalChanges]:
    """Return all signals of a session in session time, during its robot log: an event log may be of many sessions."""
    found: dict[str, SignalChanges] = {}
    first_s = min((run.time_at(0) for run in runs), default=-np.inf) - MARGIN_S
    last_s = max((run.time_at(run.rows - 1) for run in runs), default=np.inf) + MARGIN_S
    for entry in session.recordings:
        for name, changes in values_of(entry, read, stored).items():
            at_s = changes.t_s * entry.clock.rate + entry.clock.offset_s
            found.setdefault(name, _within(SignalChanges(at_s, changes.value), first_s, last_s))
    return {name: changes for name, changes in found.items() if len(changes.t_s)}


def _within(changes: SignalChanges, first_s: float, last_s: float) -> SignalChanges:
    """Return the changes in a time, with the state at its beginning."""
    begin = max(int(np.searchsorted(changes.t_s, first_s, side="right")) - 1, 0)
    kept = slice(begin, int(np.searchsorted(changes.t_s, last_s, side="right")))
    return SignalChanges(np.maximum(changes.t_s[kept], first_s), changes.value[kept])


def _add_held(
    sessions: Sequence[SecondPassResult], values: dict[str, dict[str, SignalChanges]], stored: Stored
) -> None:
    """Add to each session the signals that change only in other sessions.

    A field without a change means that no one entered it. A bit gets its logged value. An event log has no row for an
    unchanged signal: it gets the final state of the session before, provided the next session starts in that state.
    If a tracker logs people and no input ever changes, the fields may not be wired: nothing is added.
    """
    names = dict.fromkeys(name for mine in values.values() for name in mine)
    bits = {name for name in names if name.startswith((INPUT, OUTPUT))}
    for mine in sessions:
        wired = not is_tracked(mine) or any(name.startswith(INPUT) for name in values[mine.session])
        if wired and (lacks := bits.difference(values[mine.session])):
            for entry in mine.recordings:
                for name, held in constant_bits(entry, stored, lacks).items():
                    values[mine.session].setdefault(name, held._replace(t_s=_ALWAYS_S))
    for name in names:
        states = {mine.session: values[mine.session].get(name) for mine in sessions}
        for mine, kept in zip(sessions, _held_events(sessions, [*states.values()]), strict=True):
            if kept is not None:
                values[mine.session][name] = kept


def _held_events(
    sessions: Sequence[SecondPassResult], states: Sequence[SignalChanges | None]
) -> list[SignalChanges | None]:
    """Return the state of a two-state signal in each session whose events lack it; None if logged or unknown."""
    known = [one for one in states if one is not None]
    two = sorted({str(value) for one in known for value in one.value})
    found: list[SignalChanges | None] = [None] * len(sessions)
    if len(two) != 2:
        return found
    ends = accumulate((None if one is None else str(one.value[-1]) for one in states), _latest)
    begins = (None if one is None else two[str(one.value[0]) == two[0]] for one in reversed(states))
    later = reversed([*accumulate(begins, _latest)])
    for k, (mine, before, after) in enumerate(zip(sessions, ends, later, strict=True)):
        if states[k] is not None or is_tracked(mine) or not any("events" in one.tables for one in mine.recordings):
            continue
        agreed = {before, after} - {None}
        if len(agreed) == 1:
            found[k] = SignalChanges(_ALWAYS_S, np.array([agreed.pop()]))
    return found


def _latest(before: str | None, now: str | None) -> str | None:
    return before if now is None else now


def _switches(values: Mapping[str, SignalChanges], found: FoundSignals, begins_s: Vector) -> dict[str, TwoStateSignal]:
    switches = {}
    for one in found.cards:
        if one.signal not in values or (one.reset is not None and one.reset not in values):
            continue
        changes, on = values[one.signal], one.occupied
        if one.reset is not None:
            begins = begins_of(one.signal, begins_s)
            changes, on = latched(changes, on, values[one.reset], one.reset_at, begins), ON
        state = TwoStateSignal(changes.t_s, changes.value == on)
        more_s = (one.hold_s or 0.0) - (found.hold_s or 0.0)
        switches[one.name] = state.held(more_s) if more_s > 0.0 else state
    return switches


def _restarts(runs: Sequence[Run]) -> bool:
    """Return whether a robot log's clock was set back often: times of its signals then belong to several of its parts.

    A log whose clock was restarted is divided (`ingest.restarts`), unless that seems to have happened too often.
    """
    return any(after.time_at(0) < before.time_at(before.rows - 1) - RESTART_S for before, after in pairwise(runs))


def restart_notes(presence: PresenceSignals) -> list[Note]:
    """Return a note: in how many sessions signals were not used, as the robot's clock was restarted."""
    return [note("signals-restarted", sessions=presence.restarted)] if presence.restarted else []


def _begins(runs: Sequence[Run]) -> Vector:
    """Return the times at which a robot log begins, or goes on after a gap, session time, s."""
    return np.array([run.time_at(0) for run in runs])


def _evidence(
    sessions: Sequence[SecondPassResult],
    values: Sequence[Mapping[str, SignalChanges]],
    runs: Mapping[str, Sequence[Run]],
    levels: Sequence[float],
    folder: Path,
) -> SignalEvidence:
    """Return the data of some executions, with sessions shifted so that their times do not overlap."""
    chosen = set(some_executions(sessions))
    shifts = shifts_apart((0.0, max((card.end_s for card in mine.cards), default=0.0)) for mine in sessions)
    changes = [_changes(mine, chosen, runs[mine.session], levels) for mine in sessions]
    every = [change for mine in changes for change in mine]
    down, up = (rate_of([change for change in every if change.rises is rises]) for rises in (False, True))
    response = SafetyResponse(None, down, up, None, len(every), None)
    parts = list(_samples(sessions, chosen, levels, response, shifts, folder))
    t_s, level, x_m, y_m, task, execution = (np.concatenate([part[i] for part in parts]) for i in range(6))
    falls, rises = (
        np.array([c.t_s + at for mine, at in zip(changes, shifts, strict=True) for c in mine if c.rises is up])
        for up in (False, True)
    )
    return SignalEvidence(
        t_s=t_s,
        level=level,
        place=np.column_stack([x_m, y_m]),
        task=task,
        execution=execution,
        falls_s=np.sort(falls),
        rises_s=np.sort(rises),
        signals=_joined(values, shifts),
        levels=levels,
        period_s=float(np.median([run.period_s for mine in sessions for run in runs[mine.session]])),
        begins_s=np.concatenate(
            [_begins(runs[mine.session]) + at for mine, at in zip(sessions, shifts, strict=True)] or [np.empty(0)]
        ),
    )


def _joined(values: Sequence[Mapping[str, SignalChanges]], shifts: Sequence[float]) -> dict[str, SignalChanges]:
    """Return each signal over all sessions; unknown in sessions without it."""
    names = dict.fromkeys(name for mine in values for name in mine)
    unknown = SignalChanges(_ALWAYS_S, np.array([""]))
    found = {}
    for name in names:
        each = [mine.get(name, unknown) for mine in values]
        times = [one.t_s + at for one, at in zip(each, shifts, strict=True)]
        found[name] = SignalChanges(np.concatenate(times), np.concatenate([one.value for one in each]))
    return found


def _changes(
    session: SecondPassResult, chosen: Collection[str], runs: Sequence[Run], levels: Sequence[float]
) -> list[LevelChange]:
    """Return the changes of level in the chosen executions of a session, at the log's rate."""
    begins_s = np.minimum.accumulate(_begins(runs)[::-1])[::-1]  # ascending, also where a clock was set back a little
    ends_s = np.maximum.accumulate([run.time_at(run.rows - 1) for run in runs])
    cards = [card for card in session.cards if card.execution in chosen]
    first = np.searchsorted(ends_s, [card.start_s for card in cards]).tolist()
    after = np.searchsorted(begins_s, [card.end_s for card in cards], side="right").tolist()
    spans = zip(cards, first, after, strict=True)
    return [change for card, i, j in spans for run in runs[i:j] for change in _changes_during(run, card, levels)]


def _changes_during(run: Run, card: ExecutionCard, levels: Sequence[float]) -> Iterator[LevelChange]:
    first, last = run.row_at(np.array([card.start_s, card.end_s])).tolist()
    if last > first and run.time_at(first) <= card.end_s and run.time_at(last) >= card.start_s:
        for _, part in pieces(run, first, last):
            scaling = at_speed(part.scaling, part.speed_m_s) if run.is_inferred else part.scaling
            yield from changes_of(part.t_s, scaling, levels)


def _samples(
    sessions: Sequence[SecondPassResult],
    chosen: Collection[str],
    levels: Sequence[float],
    response: SafetyResponse,
    shifts: Sequence[float],
    folder: Path,
) -> Iterator[tuple[Vector, Ints, Vector, Vector, Ints, Ints]]:
    """Yield time, commanded level, place (x, y) and task of the robot, and execution of the samples of each file."""
    shift_s = {card.execution: at for one, at in zip(sessions, shifts, strict=True) for card in one.cards}
    numbers = {name: number for number, name in enumerate(shift_s)}
    tasks = dict[str | None, int]()
    for part in dict.fromkeys(one.part for one in sessions if one.samples):
        file = folder / f"{part}.parquet"
        found = commanded_samples(file, [*chosen], [*_NUMBERS, "robot_task"], _NUMBERS, levels, response)
        if found is None:
            continue
        frame, t_s, _, level = found
        level[~np.isfinite(frame["robot_x_m"].to_numpy())] = -1
        of = frame["execution"]
        at = of.replace_strict(shift_s, return_dtype=pl.Float64).to_numpy()
        number = of.replace_strict(numbers, return_dtype=pl.Int64).to_numpy()
        task = np.array([tasks.setdefault(name, len(tasks)) for name in frame["robot_task"].to_list()])
        yield t_s + at, level, frame["robot_x_m"].to_numpy(), frame["robot_y_m"].to_numpy(), task, number


__all__ = [
    "PresenceSignals",
    "find_presence_signals",
    "is_tracked",
    "mixed_sources",
    "restart_notes",
    "some_executions",
]
