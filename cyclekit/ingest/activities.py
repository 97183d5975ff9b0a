"""States of signals to a task list: what a PLC's trace tells where there is neither a robot's log nor a task list.

A state that lasts is a task: a step of a sequence chain, a word, a bit that says at which station the robot is. The
time between two states is the way, which belongs to no task: who makes a task list by hand writes the same rows. A
state lasts until the next row of its signal, as a log of changes has no others. Nothing after this module knows that
the tasks were no list.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.adapter import is_person
from cyclekit.dataset.signals import state_of
from cyclekit.errors import LogError, nearest
from cyclekit.schema import TASK_LIST, conform, empty

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from cyclekit.adapter import Recording
    from cyclekit.config.cells import Activity
    from cyclekit.schema import Vector

WHERE = "[[sources.activities]]"


class Stay(NamedTuple):
    """A state from one change to the next. `end_s` is NaN if the log ends within it."""

    name: str
    begin_s: float
    end_s: float
    row: int


def with_activities(parts: Iterable[Recording], activities: Sequence[Activity], path: Path) -> Iterator[Recording]:
    """Yield the parts of a log, the last one with the task list that its states make.

    Raises:
        LogError: The log holds no such signal.
    """
    if not activities:
        yield from parts
        return
    events, last = list[pl.DataFrame](), None
    for part in parts:
        if last is not None:
            yield replace(last, task_list=empty(TASK_LIST))
        events += [] if part.events is None else [part.events]
        last = part
    if last is None:
        return
    if not events:
        cure = "Give them to a log of signals: a mapped table with tags, or with signal and value."
        raise LogError(path, f"holds no signals, and {WHERE} makes tasks of them", cure=cure)
    tasks, said = tasks_of(SignalLog(pl.concat(events), path), activities)
    yield replace(last, task_list=tasks, warnings=(*last.warnings, *said))


@dataclass(frozen=True)
class SignalLog:
    """The changes of the signals of a log."""

    events: pl.DataFrame
    path: Path

    def names(self, patterns: Iterable[str]) -> list[str]:
        """Return the signals that patterns mean, in their order.

        Raises:
            LogError: One of them means none.
        """
        known, found = self.events["signal"].unique(maintain_order=True).to_list(), dict[str, None]()
        for pattern in patterns:
            mine = [name for name in known if name == pattern] or [n for n in known if fnmatchcase(n, pattern)]
            if not mine:
                cause, cure = f"no signal {pattern!r}, which {WHERE} names", f"It has: {', '.join(known[:40])}."
                raise LogError(self.path, cause, nearest=nearest(pattern, known), cure=cure)
            found |= dict.fromkeys(mine)
        return list(found)

    def stays(self, signal: str) -> list[Stay]:
        """Return the states of a signal, in order of time; those of one that is on or off as 1 and 0."""
        mine = self.events.filter(pl.col("signal") == signal).drop_nulls(["t_s", "value"])
        rows = mine.sort("t_s", maintain_order=True).select("t_s", "value", "source_row").rows()
        states = [value.strip() for _, value, _ in rows]
        if is_bit(map(state_of, states)):
            states = list(map(state_of, states))
        found = list[Stay]()
        for (at_s, _, row), state in zip(rows, states, strict=True):
            if found and found[-1].name == state:
                continue
            if found:
                found[-1] = found[-1]._replace(end_s=at_s)
            found.append(Stay(state, at_s, np.nan, row))
        return found


def is_bit(states: Iterable[str]) -> bool:
    """Return whether states are 1 and 0 alone."""
    return set(states) <= {"0", "1"}


def tasks_of(changes: SignalLog, activities: Sequence[Activity]) -> tuple[pl.DataFrame, list[str]]:
    """Return table TASK_LIST of the states of signals, in order of start, and warnings.

    A task belongs to the cycle that began last before it; the first one of the agent whose cycles they are lasts from
    the begin of the cycle, as the way to it is part of the cycle. If cycles begin with the return to a state, the way
    back is the last task, `to STATE`. Tasks before the first cycle, and a last cycle that is not over, belong to none.
    """
    cycle = next((one.cycle for one in activities if one.cycle), None)
    begins, back = _begins(changes, cycle, activities) if cycle else (np.empty(0), None)
    rows, whole, digits = list[tuple[object, ...]](), set(range(max(len(begins), 1))), len(str(len(begins)))
    for one in sorted(activities, key=lambda one: one.cycle != cycle):
        mine = [_active(changes, one)]
        if cycle is not None:
            mine = _in_cycles(mine[0], begins)
        if one.cycle is not None:
            mine = _whole(mine, begins, back)
            whole = {number for number, some in enumerate(mine) if some}
        kind = "operator" if is_person(one.agent) else "robot"
        for number in sorted(whole):
            name = f"{changes.path.stem}-{number + 1:0{digits}d}" if cycle else None
            rows += [
                (stay.begin_s, None if np.isnan(stay.end_s) else stay.end_s, kind, one.agent, stay.name, name, stay.row)
                for stay in mine[number]
            ]
    said = [f"{cycle!r} begins no cycle that is over: no task belongs to one"] if cycle and not rows else []
    columns = ("t_s", "end_s", "agent", "agent_name", "task", "execution", "source_row")
    frame = pl.DataFrame(rows, schema={name: TASK_LIST[name].dtype for name in columns}, orient="row")
    return conform(frame, TASK_LIST).sort("t_s", maintain_order=True), said


def _active(changes: SignalLog, one: Activity) -> list[Stay]:
    """Return the states that are activities, in order of time: those of one signal, or bits by their names."""
    signals, found = changes.names(one.column), list[Stay]()
    for signal in signals:
        stays = changes.stays(signal)
        if is_bit(stay.name for stay in stays):
            found += [stay._replace(name=signal) for stay in stays if stay.name == "1" and signal not in one.idle]
        else:
            known = [stay for stay in stays if stay.name and stay.name not in one.idle]
            found += [stay._replace(name=_named(signal, stay.name)) for stay in known]
    return sorted(found, key=lambda stay: stay.begin_s)


def _named(signal: str, state: str) -> str:
    """Return the name of a task: a word is one, the number of a step gets the name of its column."""
    return f"{signal} {state}" if state.replace(",", "").replace(".", "").lstrip("-").isdigit() else state


def _begins(changes: SignalLog, cycle: str, activities: Sequence[Activity]) -> tuple[Vector, list[Stay] | None]:
    """Return when cycles begin, ascending, s, and the stays in the state that begins them, if it is one of an agent."""
    name, _, value = cycle.partition("=")
    (signal, *_) = changes.names([name])
    stays = changes.stays(signal)
    bit = is_bit(stay.name for stay in stays)
    wanted = [
        stay for stay in stays if stay.name == (state_of(value) if bit else value) or not (value or stay.name == "0")
    ]
    states = next((one for one in activities if signal in changes.names(one.column)), None)
    if states is None:
        first_s = changes.events["t_s"].min()  # what is on in the first row did not come on then
        return np.array([stay.begin_s for stay in wanted if stay.begin_s != first_s]), None
    named = [stay._replace(name=signal if bit else _named(signal, stay.name)) for stay in wanted]
    left = (signal if bit else value) in states.idle
    at_s = [stay.end_s if left else stay.begin_s for stay in named]
    return np.array([each for each in at_s if not np.isnan(each)]), named


def _in_cycles(stays: Sequence[Stay], begins: Vector) -> list[list[Stay]]:
    """Return the stays, in order of time, of each cycle, by their begins, ascending, s."""
    cycles = [list[Stay]() for _ in begins]
    for stay in stays:
        number = int(np.searchsorted(begins, stay.begin_s, side="right")) - 1
        last = int(np.searchsorted(begins, stay.end_s, side="left")) - 1 if stay.end_s == stay.end_s else number
        if number >= 0:
            whole = last <= number
            cycles[number].append(stay if whole else stay._replace(end_s=float(begins[number + 1])))
        if last > number:  # it goes on within the next cycle, as at a station where the robot waits for the start
            cycles[last].append(stay._replace(begin_s=float(begins[last])))
    return cycles


def _whole(cycles: list[list[Stay]], begins: Vector, back: Sequence[Stay] | None) -> list[list[Stay]]:
    """Return the cycles of the agent whose cycles they are: the first stay has the way to it; empty if not over.

    The last one is over when the agent has come back, or has been at as many places as in another one.

    Args:
        cycles: Stays of each.
        begins: Begins of the cycles, ascending, s.
        back: Stays in the state with whose return a cycle is over; None: a signal begins cycles.
    """
    for number, some in enumerate(cycles):
        if some:
            some[0] = some[0]._replace(begin_s=float(begins[number]))
    if back is None:
        most = min((len(some) for some in cycles[:-1] if some), default=0)
        return [some if number + 1 < len(cycles) or len(some) >= most else [] for number, some in enumerate(cycles)]
    return _with_ways_back(cycles, back)


def _with_ways_back(cycles: Sequence[list[Stay]], back: Sequence[Stay]) -> list[list[Stay]]:
    """Return cycles with the way back to the state that begins them; without the last one if it does not come to it."""
    returns = np.array([stay.begin_s for stay in back])
    ways = list[Stay | None]()
    for some in cycles:
        at = int(np.searchsorted(returns, some[-1].end_s - 1e-9)) if some else len(back)
        over = some and at < len(back)
        ways.append(Stay(f"to {back[at].name}", some[-1].end_s, back[at].begin_s, back[at].row) if over else None)
    usual_s = np.median([way.end_s - way.begin_s for way in ways if way] or [0.0])
    found = list[list[Stay]]()
    for some, way in zip(cycles, ways, strict=True):
        unended = bool(some) and np.isnan(some[-1].end_s)
        found.append([*some, *([way] if usual_s > 0.0 else [])] if way else some if unended else [])
    return found
