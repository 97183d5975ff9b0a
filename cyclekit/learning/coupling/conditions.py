"""What the departures of an agent wait for: candidates, evidence, choice.

A condition is believed if the departures hold to it, if it decided several of them, and if they become so much more
regular by it that neither chance among all candidates nor the same events in another order can have done that.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.coupling import Turns
from cyclekit.errors import UnknownName
from cyclekit.learning.coupling.lags import take_apart
from cyclekit.learning.coupling.passages import SEEN, Condition, Passages, passages_of
from cyclekit.learning.coupling.visits import Event

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from cyclekit.config import Wait
    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.learning.coupling.lags import Causes
    from cyclekit.learning.coupling.visits import ExecutionVisits
    from cyclekit.schema import Floats, Ints, Vector

HELD = 0.98
"""Part of the departures that must come after a condition's event, if all of them need it."""
NEEDED, LEAST_PART = 0.15, 2.0
"""Of others at least so many departures must need the event; such a condition must gain so many times as much."""
EARLY_S, EARLY_LEAVING_S = 0.25, 1.0
"""A departure may come so much before it: clocks of two agents; who leaves is done before he is seen to move."""
LEAST_DECIDED = 5
"""So many departures must have been decided by it."""
GAIN, GAIN_PER_DEPARTURE = 8.0, 0.05
"""By so much the log-likelihood of the departures must rise, in all and for each of them."""
AS_GOOD, AS_GOOD_PART = 3.0, 0.1
"""Of events whose gains differ by no more than this, or this part of it, the one just before the departure is taken."""
SAME = 0.7
"""Two gates are passed by the same departures if so many of those of either pass the other."""
FOLLOWS = 0.8
"""An event that is as near to so many of the departures that own work decided follows own work, and is no condition."""
PULSE_S = 1.0
"""Whoever presses a button sets a signal; that it is cleared so soon afterwards says the same."""
PAIRED = 0.9
"""Part of the executions in which a gate is passed exactly twice as often as an event comes, or the other way round."""
SHUFFLES = 6
MOST = 2
"""Conditions of one gate."""
KEPT = 400
"""Departures by which their lags are learned."""
Times = dict[Event, "Floats"]
"""Of each kind of event when it came in each execution; see `times_of`."""


def find_conditions(
    courses: Sequence[ExecutionVisits], agent: Agent, told: Sequence[Wait] = (), barred: Collection[Event] = ()
) -> list[Passages]:
    """Return the passages of an agent's gates with the conditions that were found, or told.

    Args:
        courses: The executions.
        agent: Whose gates.
        told: By the cell file.
        barred: Events that the agent does not wait for.

    Raises:
        UnknownName: The cell file tells of a place or event that the logs do not show.
    """
    gates, times = passages_of(courses, agent), times_of(courses)
    told = [wait for wait in told if wait.agent == agent]
    for wait in told:
        chosen = gate_of(gates, wait)
        if not wait.never:
            condition = _told(times, chosen, wait)
            _attach(gates, chosen, condition, since_event(times, chosen, condition))
    allowed = [
        [one for one in _candidates(times, gate, agent) if one.event not in barred and not _forbidden(told, gate, one)]
        for gate in gates
    ]
    open_to = [_best(times, gate, some) for gate, some in zip(gates, allowed, strict=True)]
    while any(open_to):
        number = max((n for n, found in enumerate(open_to) if found), key=lambda n: open_to[n][2])  # type: ignore[index]
        number = _natural(gates, open_to, number)
        condition, since, _ = open_to[number]  # type: ignore[misc]  # there is one
        for other in _attach(gates, gates[number], condition, since):
            open_to[other] = _best(times, gates[other], allowed[other]) if len(gates[other].found) < MOST else None
    return gates


def _candidates(times: Times, gate: Passages, agent: Agent) -> list[Condition]:
    """Return what the passages of a gate may wait for; twice as many of one as of the other go in pairs."""
    found = []
    passages = np.zeros(len(next(iter(times.values()), ())), np.int64)
    np.maximum.at(passages, gate.course, gate.nth + 1)
    for event, at in times.items():
        if event.agent == agent:
            continue
        some, events = passages > 0, np.isfinite(at).sum(axis=1)
        pairs = [Turns()]
        if np.mean(passages[some] == 2 * events[some]) >= PAIRED:
            pairs += [Turns(every=2, first=first) for first in (0, 1)]
        elif np.mean(events[some] == 2 * passages[some]) >= PAIRED:
            pairs += [Turns(event_every=2, event_first=first) for first in (0, 1)]
        found += [Condition(event, back, turns) for turns in pairs for back in (0, 1)]
    return found


def _attach(gates: Sequence[Passages], to: Passages, condition: Condition, since: Vector) -> list[int]:
    """Have all gates know a condition of one; return the numbers of those that it concerns."""
    by_row = dict(zip(to.rows.tolist(), since.tolist(), strict=True))
    concerned = []
    for number, gate in enumerate(gates):
        shared = np.array([by_row.get(row, np.nan) for row in gate.rows.tolist()])
        if gate.gate.short == to.gate.short and (gate is to or np.isfinite(shared).any()):  # else another instant
            gate.since_s[to.gate, condition] = shared
            concerned.append(number)
    return concerned


def gate_of(gates: Sequence[Passages], wait: Wait) -> Passages:
    """Return the gate that the cell file means; of two before one place that short of it.

    Raises:
        UnknownName: There is none.
    """
    at, place = ("approach", wait.before) if wait.before is not None else ("leave", wait.leaving)
    found = [gate for gate in gates if (gate.gate.at, gate.gate.place) == (at, place)]
    if not found:
        known = sorted({gate.gate.place for gate in gates if gate.gate.at == at})
        raise UnknownName(f"cell.toml [[waits]] of the {wait.agent}", "place", str(place), known)
    return max(found, key=lambda gate: gate.gate.short)


def _told(times: Times, gate: Passages, wait: Wait) -> Condition:
    """Return the condition that the cell file tells, with the number that the logs agree with best."""
    found = [event for event in times if _means(wait, event)]
    if not found:
        known = sorted({told_event(event) for event in times if event.agent != wait.agent})
        raise UnknownName(f"cell.toml [[waits]] of the {wait.agent}", "event", str(wait.until), known)
    numbers = (0, 1) if wait.back is None else (wait.back,)
    conditions = [Condition(found[0], back) for back in numbers]

    def likelihood(condition: Condition) -> float:
        since = since_event(times, gate, condition)
        held = np.where(since >= -early_s(condition), since, np.nan)
        late = float((held != since).mean()) if len(since) else 0.0
        return float(gate.causes(held).log_likelihood.sum()) * (1.0 + late) if np.isfinite(held).any() else -np.inf

    return max(conditions, key=likelihood) if len(conditions) > 1 else conditions[0]


def told_event(event: Event) -> str:
    """Return an event as the cell file names it."""
    if event.signal is not None:
        return event.signal
    return f"{event.place} {event.event}" if event.agent == "signal" else f"{event.agent} {event.event} {event.place}"


def _means(wait: Wait, event: Event) -> bool:
    return wait.until is None or wait.until == told_event(event)


def _forbidden(told: Sequence[Wait], gate: Passages, condition: Condition) -> bool:
    def concerns(wait: Wait) -> bool:
        return wait.never and wait.place(gate.gate.at) == gate.gate.place and _means(wait, condition.event)

    return any(concerns(wait) for wait in told)


_Found = tuple[Condition, "Vector", float]


def _natural(gates: Sequence[Passages], open_to: Sequence[_Found | None], number: int) -> int:
    """Return the gate that a condition belongs to, of all that the same departures pass and that it explains.

    Who waits until another has left may not approach; who waits until he came, or something is set, may not leave.
    """
    event = open_to[number][0].event  # type: ignore[index]  # there is one
    at = "approach" if event.event == "leaves" else "leave"
    mine = gates[number]
    for other, (gate, found) in enumerate(zip(gates, open_to, strict=True)):
        both = len(np.intersect1d(gate.rows, mine.rows)) if gate.gate.short == mine.gate.short else 0
        same = both >= SAME * max(len(gate.rows), len(mine.rows))
        if same and gate.gate.at == at and found is not None and found[0].event[:2] == event[:2]:
            return other
    return number


def _best(times: Times, gate: Passages, candidates: Sequence[Condition]) -> _Found | None:
    """Return the best condition that passes all tests, from its event to each departure, and its gain."""
    if len(gate.left_s) < LEAST_DECIDED:
        return None
    before = float(gate.causes().log_likelihood.sum())
    taken = {one.event[:2] for (_, one), at in gate.since_s.items() if 2 * np.isfinite(at).sum() > len(at)}
    free = [one for one in candidates if one.event[:2] not in taken]
    least = least_gain(min(len(gate.left_s), SEEN)) + np.log(max(len(candidates), 1))
    always = _best_of(times, gate, free, before, least)
    rival = 0.0 if always is None else (1.0 + AS_GOOD_PART) * always[2] / gate.step  # one that all need is likelier
    partly = [one._replace(partly=True) for one in free]
    return _best_of(times, gate, partly, before, max(rival, LEAST_PART * least)) or always


def _best_of(
    times: Times, gate: Passages, candidates: Sequence[Condition], before: float, least: float
) -> _Found | None:
    """Return the best of some conditions that raise the log-likelihood from `before` by at least so much."""
    tried: list[_Found] = []
    for condition in candidates:
        since = since_event(times, gate, condition)
        if not _holds(gate, condition, since):
            continue
        since = _later(condition, since)
        causes = gate.causes(since)
        decided = causes.share[-1].sum() * gate.step >= LEAST_DECIDED
        if decided and not _follows(causes, since[:: gate.step]) and not _ahead(gate, causes, since[:: gate.step]):
            tried.append((condition, since, float(causes.log_likelihood.sum()) - before))
    tried.sort(key=lambda each: -each[2])
    good = [each for each in tried if each[2] >= least]
    if not good or good[0][2] - _by_chance(gate, times, good[0][0]) + before < least:
        return None
    as_good = [each for each in good if each[2] >= good[0][2] - max(AS_GOOD, AS_GOOD_PART * good[0][2])]
    found = min(as_good, key=lambda each: _before(*each[:2]))
    return found[0], found[1], found[2] * gate.step


def least_gain(departures: int) -> float:
    """Return by how much the log-likelihood of some departures must rise for a cause to be believed."""
    return GAIN + GAIN_PER_DEPARTURE * departures


def _follows(causes: Causes, since: Vector) -> bool:
    """Tell whether an event is a consequence of the agent's own work: where that decided it is just as near."""
    decided = causes.share.argmax(axis=0)
    own, by_event = since[decided == 0], since[decided == len(causes.share) - 1]
    own = own[np.isfinite(own)]
    if len(own) < LEAST_DECIDED or not len(by_event):
        return False
    return bool(np.mean(own <= by_event.max() + EARLY_S) > FOLLOWS)


def _ahead(gate: Passages, causes: Causes, since: Vector) -> bool:
    """Tell whether an operator goes before most of the events that he would react to: nobody does."""
    by_event = since[causes.share.argmax(axis=0) == len(causes.share) - 1]
    return gate.gate.agent == "operator" and len(by_event) > 0 and float(np.median(by_event)) < 0.0


def _before(condition: Condition, since: Vector) -> float:
    """Return how far before the departures an event comes, s; the end of a button's pulse counts as later."""
    known = since[np.isfinite(since)]
    if not len(known):
        return float("inf")
    return abs(float(np.quantile(known, 0.1))) + (PULSE_S if "cleared" in str(condition.event) else 0.0)


def since_event(times: Times, gate: Passages, condition: Condition) -> Vector:
    """Return the time from a condition's event to each passage, shape (N,), s; NaN where none is needed."""
    at, turns = times[condition.event], condition.turns
    turn, rest = np.divmod(gate.nth, turns.every)
    number = (turn - condition.back) * turns.event_every + turns.event_first
    there = (rest == turns.first) & (turn >= condition.back) & (number < at.shape[1])
    return np.asarray(np.where(there, gate.left_s - at[gate.course, np.where(there, number, 0)], np.nan))


def times_of(courses: Sequence[ExecutionVisits]) -> Times:
    """Return when each kind of event came in each execution, shape (executions, at least 1), NaN behind the last."""
    found: Times = {}
    for event in sorted({event for course in courses for event in course.events}, key=str):
        every = [course.events.get(event, np.empty(0)) for course in courses]
        found[event] = np.full((len(courses), max(1, *map(len, every))), np.nan)
        for row, mine in zip(found[event], every, strict=True):
            row[: len(mine)] = mine
    return found


def _holds(gate: Passages, condition: Condition, since: Vector) -> bool:
    """Tell whether the passages come after the events, and several events so late that they can have decided."""
    known = np.isfinite(since)
    if np.count_nonzero(known) < LEAST_DECIDED:
        return False
    late = since < gate.left_s - gate.own_s  # later than where own work began
    held = known & (since >= -early_s(condition))
    share = np.count_nonzero(held) / np.count_nonzero(known)
    enough = NEEDED <= share < HELD if condition.partly else share >= HELD
    return bool(enough and np.count_nonzero(late & (held if condition.partly else known)) >= LEAST_DECIDED)


def _later(condition: Condition, since: Vector) -> Vector:
    """Return the time from an event to each passage; -inf where it came later, if not all passages need it."""
    return np.where(since < -early_s(condition), -np.inf, since) if condition.partly else since


def early_s(condition: Condition) -> float:
    """Return how much before a condition's event a departure may come, s."""
    of_leaving = condition.event[::2] == ("operator", "leaves") and condition.event.signal is None
    return EARLY_LEAVING_S if of_leaving else EARLY_S


def decided_by(since_s: Floats) -> Ints:
    """Return which cause decided each departure, shape (N,); 0 = own work, where that makes them likelier."""
    causes = take_apart(since_s)
    if len(since_s) > 1:
        waits = take_apart(since_s[1:])
        if float((causes.log_likelihood - waits.log_likelihood).sum()) < least_gain(since_s.shape[1]):
            return np.asarray(1 + waits.share.argmax(axis=0))
    return np.asarray(causes.share.argmax(axis=0))


def _by_chance(gate: Passages, times: Times, condition: Condition) -> float:
    """Return the best log-likelihood with the same events in another order among the departures."""
    rng, since = np.random.default_rng(0), since_event(times, gate, condition)
    known = np.flatnonzero(np.isfinite(since))
    ahead = (gate.left_s - gate.own_s) - since  # of the event since own work began
    found = [-np.inf]
    for _ in range(SHUFFLES):
        other = np.full(len(since), np.nan)
        other[known] = (gate.left_s - gate.own_s)[known] - rng.permutation(ahead[known])
        other = _later(condition, other) if condition.partly else np.where(other >= -EARLY_S, other, np.nan)
        found.append(float(gate.causes(other).log_likelihood.sum()))
    return max(found)


def in_circles(robot: Sequence[Passages], operator: Sequence[Passages]) -> Iterator[tuple[Agent, Event]]:
    """Yield of each two conditions by which each agent waits for the other's next step the one that explains less."""
    for mine in robot:
        for his in operator:
            for a in mine.found:
                for b in his.found:
                    if _meets(mine, a, his, b):
                        drop_mine = _gain(mine, a) < _gain(his, b)
                        yield ("robot", a.event) if drop_mine else ("operator", b.event)


def _meets(mine: Passages, a: Condition, his: Passages, b: Condition) -> bool:
    """Tell whether most of his passages need my passages, which need what he does on or before his."""
    needed = his.left_s - his.since_s[his.gate, b]
    at = {key: row for row, key in enumerate(zip(mine.course.tolist(), mine.left_s.round(6).tolist(), strict=True))}
    rows = [at.get(key, -1) for key in zip(his.course.tolist(), needed.round(6).tolist(), strict=True)]
    met = np.array(rows) >= 0
    began = (mine.left_s - mine.since_s[mine.gate, a])[rows]
    within = met & (began <= his.left_s + EARLY_LEAVING_S) & (began >= his.own_s)
    return bool(within.sum() > 0.5 * np.isfinite(needed).sum() > 0)


def _gain(gate: Passages, condition: Condition) -> float:
    """Return by how much a condition raises the log-likelihood of a gate's passages."""
    without = replace(gate, since_s={key: at for key, at in gate.since_s.items() if key != (gate.gate, condition)})
    return float((gate.causes().log_likelihood - without.causes().log_likelihood).sum()) * gate.step
