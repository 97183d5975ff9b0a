"""Read from a dataset: arrivals and departures of robot and operator at their places, and changes of signals."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.cards.dataset import begun
from cyclekit.dataset.signals import INPUT, OUTPUT, switches
from cyclekit.learning.coupling.events.givers import with_givers
from cyclekit.learning.coupling.events.repeated import without_repeats
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.dataset.cards.dataset import ExecutionCard
    from cyclekit.dataset.cards.recording import RecordingCard
    from cyclekit.dataset.signals import Read, SignalChanges
    from cyclekit.schema import Bools, Vector

    Bits = Callable[[RecordingCard], Mapping[str, SignalChanges]]
    Logged = Mapping[str, Mapping[str, SignalChanges]]

ANSWER_S, ANSWERS, RARE = 0.5, 0.9, 0.3
"""An input answers an output (a gripper reports that it is closed) if at least this share (second value) of its changes
follow a change of the output within this time, s (first), and these times cover at most this share of the log
(third)."""
WITHIN, MIN_VISITS = 0.95, 10
"""Minimum share of the visits to a place in which a signal is cleared and then set; fewer visits tell nothing."""
COPY_S = 0.15
"""Maximum time, s, between a change of the robot's input or output and that of its copy in a PLC's log."""
SAMPLED = 0.5
"""Maximum range of the intervals between the rows of a sampled state, as a share of their median."""
_STATES = (("set", "1"), ("cleared", "0"))


def courses_of(
    executions: Sequence[ExecutionCard],
    tasks: pl.DataFrame,
    recordings: Sequence[RecordingCard],
    read: Read,
    bits: Bits,
    fields: Collection[str] = (),
    goals: Collection[str] = (),
) -> list[ExecutionVisits]:
    """Return the begun executions in which both agents were seen; of logs without operators those of the robot.

    An input of the robot counts where the operator gives it: most inputs tell of grippers, conveyors and doors. Where
    no operator was logged every signal counts; what it waits for is then judged by `conditions` and `answers`.

    Args:
        executions: Cards of the executions.
        tasks: Table TASKS.
        recordings: Recordings of their sessions.
        read: Returns a native table of a recording (id, table), None if there is none.
        bits: Returns the inputs and outputs of a recording, in its own clock.
        fields: Signals that show people: their cost is safety loss, not a wait.
        goals: Signals that name the operator's next place: nobody waits for them.
    """
    cards = {card.execution: card for card in begun(executions)}
    mine = tasks.filter(pl.col("agent_name").is_null(), pl.col("execution").is_in(list(cards)))
    people = "operator" in mine["agent"]
    sessions = {card.session for card in cards.values()}
    of_session: dict[str, list[RecordingCard]] = {session: [] for session in sessions}
    for one in recordings:
        if one.session in sessions:
            of_session[one.session].append(one)
    by_session = {session: _signals(some, read, goals) for session, some in of_session.items()}
    logged = {one.id: bits(one) for one in recordings if one.session in sessions and one.rows.get("robot")}
    copied = copies(recordings, by_session, logged, (OUTPUT,) if people else (OUTPUT, INPUT))
    uncopied = {one: {key: at for key, at in some.items() if key[0] not in copied} for one, some in by_session.items()}
    answers = _answers(list(logged.values()))
    by_session = without_repeats(uncopied)
    inputs = without_repeats({session: _inputs(some, logged, answers) for session, some in of_session.items()})
    states = {} if people else {session: _states(some, logged) for session, some in of_session.items()}
    known = {name for some in (*inputs.values(), *by_session.values()) for name, state in some if state == "set"}
    ends_s = _until(executions)
    numbers = {card.execution: number for number, card in enumerate(executions)}
    found: list[ExecutionVisits] = []
    logged_states: dict[str, Mapping[tuple[str, str], Vector]] = {}
    for (name,), rows in mine.sort("execution", "index").group_by(["execution"], maintain_order=True):
        card = cards[str(name)]
        robot = _of_robot(rows.filter(pl.col("agent") == "robot"))
        operator = _of_operator(rows.filter(pl.col("agent") == "operator"), card.start_s)
        if not robot or bool(operator) is not people:
            continue
        end_s = float(np.nanmax([card.end_s, *(s for one in operator for s in (one.arrived_s, one.left_s))]))
        every = inputs[card.session] | by_session[card.session]
        changes = {key: _within(at, card.start_s, end_s) for key, at in every.items()}
        if not people:
            every = {key: at for key, at in every.items() if key[0] not in fields}
            changes = {key: at for key, at in changes.items() if key in every}
            logged_states[card.execution] = every | states[card.session]
        events = {Event("signal", *key): at for key, at in changes.items()}
        visits: dict[Agent, Sequence[PlaceVisit]] = {"robot": robot, "operator": operator}
        until_s = ends_s[card.execution]
        until = {} if people else {key: at[: np.searchsorted(at, until_s)] for key, at in every.items()}
        after = {key: at[np.searchsorted(at, end_s, side="right") :] for key, at in until.items()}
        later = {Event("signal", *key): at for key, at in after.items() if len(at)}
        events, number = events_of(visits) | events, numbers[card.execution]
        found.append(ExecutionVisits(card.execution, visits, events, card.session, number=number, later=later))
    if not people:
        waited = known - set(fields) - _within_visits(found, logged_states)
        begins = {card.execution: card.start_s for card in executions}
        return [_with_states(one, logged_states[one.name], begins[one.name], waited) for one in found]
    doubtful = {key for some in inputs.values() for key in some} - {key for some in by_session.values() for key in some}
    return with_givers(found, {Event("signal", *key) for key in doubtful})


def _until(executions: Sequence[ExecutionCard]) -> dict[str, float]:
    """Return when the next execution of its session starts, by execution, s; inf after the last one."""
    starts_s: dict[str, list[float]] = {}
    for one in executions:
        starts_s.setdefault(one.session, []).append(one.start_s)
    ascending = {session: [*sorted(times), np.inf] for session, times in starts_s.items()}
    return {
        one.execution: ascending[one.session][bisect_right(ascending[one.session], one.start_s)] for one in executions
    }


def _within(at: Vector, first_s: float, last_s: float) -> Vector:
    """Return the times from `first_s` to `last_s`, inclusive, of ascending ones."""
    return at[np.searchsorted(at, first_s) : np.searchsorted(at, last_s, side="right")]


def _with_states(
    course: ExecutionVisits, every: Mapping[tuple[str, str], Vector], start_s: float, known: Collection[str]
) -> ExecutionVisits:
    """Return an execution; a part or a release that is there when it begins has come before.

    Args:
        course: The execution.
        every: Changes in its session, also those that answer an output.
        start_s: Start of the execution, s.
        known: Signals that are set in some execution, and not within visits.
    """
    events = dict(course.events)
    for name in known:
        on, off = (every.get((name, state), np.empty(0)) for state in ("set", "cleared"))
        last = [float(np.append(-np.inf, at)[np.searchsorted(at, start_s)]) for at in (on, off)]
        if last[0] > last[1]:
            key = Event("signal", name, "set")
            events[key] = np.concatenate([[last[0]], events.get(key, np.empty(0))])
    return replace(course, events=events)


def _within_visits(
    courses: Sequence[ExecutionVisits], logged: Mapping[str, Mapping[tuple[str, str], Vector]]
) -> set[str]:
    """Return the signals that are cleared, then set, in nearly all of the robot's visits to some place.

    A machine closes its door when it was given a part, and opens it when it is done: the robot waits for that, not for
    a door that is open when the execution begins.

    Args:
        courses: The executions.
        logged: Changes in the session of each execution, by its name, also those that answer an output.
    """
    names = {key.place for course in courses for key in course.events if key.agent == "signal" and key.event == "set"}
    within: dict[tuple[str, str], list[bool]] = {}
    for course in courses:
        for name in names:
            off, on = (logged[course.name].get((name, state), np.empty(0)) for state in ("cleared", "set"))
            for visit in course.visits["robot"][1:-1]:
                cleared = off[np.searchsorted(off, visit.arrived_s) :][:1]
                set_s = on[np.searchsorted(on, cleared[0], side="right") :][:1] if len(cleared) else cleared
                within.setdefault((name, visit.place), []).append(bool((set_s <= visit.left_s).all() and len(set_s)))
    return {name for (name, _), each in within.items() if len(each) >= MIN_VISITS and np.mean(each) >= WITHIN}


def _of_robot(rows: pl.DataFrame) -> list[PlaceVisit]:
    if rows.is_empty():
        return []
    names = ("goal_place", "arrival_s", "start_s", "reached_s", "went_on_s")
    goals, *times = (rows[name].to_list() for name in names)
    arrived, started, reached, went_on = (np.array(column, float) for column in times)
    cut = rows["cut"].fill_null(value=True)[-1]
    left = [*started[1:].tolist(), np.nan if cut else rows["end_s"][-1]]
    first = PlaceVisit(rows["start_place"][0], float(started[0]), float(started[0]))
    visits = [first, *map(PlaceVisit, goals, arrived.tolist(), left, reached.tolist(), went_on.tolist())]
    return visits if np.isfinite(arrived[-1]) else visits[:-1]  # short of a place when the log ended


def _of_operator(rows: pl.DataFrame, begin_s: float) -> list[PlaceVisit]:
    arrived = rows["arrival_s"].fill_null(begin_s).to_list()
    left = rows["end_s"].fill_null(np.nan).to_list()
    every = zip(rows["goal_place"].to_list(), arrived, left, rows["index"].to_list(), strict=True)
    return [PlaceVisit(place, arrived_s, left_s, task=task) for place, arrived_s, left_s, task in every]


def _signals(recordings: Sequence[RecordingCard], read: Read, goals: Collection[str]) -> dict[tuple[str, str], Vector]:
    """Return when each signal was `set` and `cleared`, session seconds; a signal without two states is only set."""
    found: dict[tuple[str, str], Vector] = {}
    for record in recordings:
        events = read(record.id, "events") if record.rows.get("events") else None
        if events is None:
            continue
        both = switches(record, read)
        for (signal,), rows in events.sort("t_s").group_by(["signal"], maintain_order=True):
            name, at = str(signal), rows["t_s"].to_numpy() * record.clock.rate + record.clock.offset_s
            if name in goals:
                continue
            rises, falls = presses(at, both[name][1] if name in both else None)
            found |= {(name, "set"): at[rises], (name, "cleared"): at[falls]}
    return found


def copies(
    recordings: Sequence[RecordingCard],
    by_session: Mapping[str, Mapping[tuple[str, str], Vector]],
    logged: Logged,
    kinds: tuple[str, ...],
) -> set[str]:
    """Return the signals of other logs that repeat an input or output of the robot: nearly all changes coincide.

    A PLC logs what the robot sets, too. As it scans slowly and has its own clock, its change may seem to come first.

    Args:
        recordings: Recordings of the sessions.
        by_session: When each signal was set and cleared, by session, session seconds.
        logged: Inputs and outputs of the recordings, in their own clocks.
        kinds: Beginnings of the names of the inputs and outputs that count.
    """
    pairs: dict[tuple[str, str], list[tuple[Vector, Vector]]] = {}
    for record in recordings:
        for bit, changes in logged.get(record.id, {}).items():
            own = changes.t_s[1:] * record.clock.rate + record.clock.offset_s
            others = by_session.get(record.session, {})
            for name in {name for name, _ in others if not name.startswith((INPUT, OUTPUT))}:
                states = (at for (other, _), at in others.items() if other == name)
                both = np.sort(np.concatenate([np.empty(0), *states]))
                inside = both[(both >= own[0] - 1.0) & (both <= own[-1] + 1.0)] if len(own) else both[:0]
                if bit.startswith(kinds):
                    pairs.setdefault((name, bit), []).append((own, inside))
    return {name for (name, _), each in pairs.items() if _coincide(each)}


def _coincide(pairs: Sequence[tuple[Vector, Vector]]) -> bool:
    """Return whether nearly all times of two lists are near one of the other, in several logs, and not by chance."""
    near: list[Vector] = []
    covered_s = lasted_s = 0.0
    for one, other in pairs:
        near += [_apart(one, other), _apart(other, one)]
        covered_s += 2.0 * COPY_S * max(len(one), len(other))
        lasted_s += float(np.ptp(np.concatenate([one, other]))) if len(one) and len(other) else 0.0
    every = np.concatenate(near)
    return len(every) > 0 and covered_s <= RARE * lasted_s and bool(np.mean(every <= COPY_S) >= ANSWERS)


def _apart(times: Vector, others: Vector) -> Vector:
    """Return the distance of each time, shape (N,), to the nearest of others, s."""
    if not len(others):
        return np.full(len(times), np.inf)
    after = np.clip(np.searchsorted(others, times), 1, max(len(others) - 1, 1))
    return np.asarray(np.minimum(np.abs(times - others[after - 1]), np.abs(times - others[after % len(others)])))


def presses(at: Vector, on: Bools | None) -> tuple[Bools, Bools]:
    """Return which rows of a signal set and which clear it.

    Every row of a signal without two states sets it; so does that of one which is only ever on, as some logs hold the
    presses of a button and not its releases. If all rows are as far from each other, they are samples of its state.

    Args:
        at: Time of each row, shape (N,), s.
        on: Whether it is on from each row, shape (N,); None: it has no two states.
    """
    between_s = np.diff(at)
    sampled = len(between_s) > 1 and bool(np.ptp(between_s) <= SAMPLED * np.median(between_s))
    if on is None or (on.all() and not sampled):
        return np.ones(len(at), np.bool_), np.zeros(len(at), np.bool_)
    return _edges(on)


def _edges(on: Bools) -> tuple[Bools, Bools]:
    before = np.concatenate([[False], on[:-1]])
    return on & ~before, ~on & before


def _inputs(
    recordings: Sequence[RecordingCard], logged: Logged, answers: Collection[tuple[str, str]]
) -> dict[tuple[str, str], Vector]:
    """Return when each digital input was `set` and `cleared`, session seconds, without inputs that answer an output."""
    found: dict[tuple[str, str], Vector] = {}
    for record in recordings:
        for name, each in logged.get(record.id, {}).items():
            for state, value in _STATES:
                at = each.to(value) if name.startswith(INPUT) else np.empty(0)
                if len(at) and (name, state) not in answers:
                    found[name, state] = at * record.clock.rate + record.clock.offset_s
    return found


def _states(recordings: Sequence[RecordingCard], logged: Logged) -> dict[tuple[str, str], Vector]:
    """Return when each digital input turned on and off, session seconds; one that is on at first turned on then."""
    found: dict[tuple[str, str], Vector] = {}
    for record in recordings:
        for name, each in logged.get(record.id, {}).items():
            if name.startswith(INPUT):
                edges_of = dict(zip(("set", "cleared"), _edges(each.value == "1"), strict=True))
                for state, edges in edges_of.items():
                    found[name, state] = each.t_s[edges] * record.clock.rate + record.clock.offset_s
    return found


def _answers(logs: Sequence[Mapping[str, SignalChanges]]) -> set[tuple[str, str]]:
    """Return the changes of inputs that closely follow those of an output that is rare enough to exclude chance.

    All logs count together: one of a single execution holds too few changes to judge by.
    """
    names = {name for log in logs for name in log}
    outputs = [name for name in names if name.startswith(OUTPUT)]
    inputs = [(name, *state) for name in names if name.startswith(INPUT) for state in _STATES]
    return {
        (name, state)
        for name, state, value in inputs
        if any(_follows([(log[name], log.get(output)) for log in logs if name in log], value) for output in outputs)
    }


def _follows(pairs: Sequence[tuple[SignalChanges, SignalChanges | None]], value: str) -> bool:
    """Return whether changes of an input to a value follow an output in several logs; None = no change of it there."""
    since_s, covered_s, lasted_s = list[float](), 0.0, 0.0
    for changes, of_output in pairs:
        at, output = changes.to(value), np.empty(0) if of_output is None else of_output.t_s[1:]
        last = np.searchsorted(output, at, side="right") - 1
        since_s += np.where(last >= 0, at - np.append(output, np.inf)[np.maximum(last, 0)], np.inf).tolist()
        covered_s += len(output) * ANSWER_S
        lasted_s += max(float(np.ptp(np.concatenate([changes.t_s, output]))), ANSWER_S)
    if not since_s or not covered_s or covered_s > RARE * lasted_s:
        return False
    return bool(np.mean(np.array(since_s) <= ANSWER_S) >= ANSWERS)
