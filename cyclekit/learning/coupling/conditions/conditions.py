"""Finds the events that the departures of an agent wait for: candidates, tests, selection.

A condition is accepted if the departures respect it, if it decides several of them, and if its gain in log-likelihood
exceeds what multiple testing and the same events in random order can produce.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import UnknownName
from cyclekit.learning.coupling.conditions.candidates import (
    EARLY_S,
    HELD,
    candidates_of,
    early_s,
    since_event,
    times_of,
    with_room,
)
from cyclekit.learning.coupling.conditions.departures import SEEN, Condition, Departures, departures_of, least_gain
from cyclekit.learning.coupling.conditions.lags import deciding_causes
from cyclekit.learning.coupling.conditions.machines import is_steady

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from cyclekit.config import Wait
    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.learning.coupling.conditions.candidates import Times
    from cyclekit.learning.coupling.conditions.lags import Causes
    from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
    from cyclekit.schema import Floats, Ints, Vector

NEEDED, MIN_PART = 0.15, 2.0
"""For a condition that only some departures need: minimum share that need it, and factor on the required gain."""
MIN_DECIDED, FEW_DECIDED, FEW_LATE, SURE = 5, 3, 2, 2.0
"""Minimum number of departures that a condition must decide; the second value suffices if its gain in log-likelihood is
SURE times the required one: where few passages need the event, a few long waits that end with it tell enough. In
FEW_LATE of them the event must come after all else."""
GAIN_TOLERANCE, GAIN_TOLERANCE_SHARE = 3.0, 0.1
"""Maximum difference in gain, absolute and relative, at which two conditions count as equally good; then the one whose
event is nearest to the departures is chosen."""
SIMILAR_GAIN = 0.8
"""Minimum gain of a condition at its usual gate, relative to that at the gate where it was found."""
SAME = 0.7
"""Minimum overlap (share of departures) at which two gates count as one."""
FOLLOWS, USUALLY_FOLLOWS, CLOSE = 0.8, 0.5, 0.75
"""Maximum share of departures that own work decided and that follow the event as closely as all those it decided, and
as the share CLOSE of those; above both, the event is a consequence of own work."""
PULSE_S = 1.0
"""Penalty, s, on the end of a button's pulse, so that the press is chosen as the event."""
SHUFFLES = 6
"""Number of random orders of the events."""
MAX_CONDITIONS = 2
"""Maximum number of conditions per gate."""
KEPT = 1200
"""Maximum number of departures from which lags are learned."""


def find_conditions(
    courses: Sequence[ExecutionVisits], agent: Agent, given: Sequence[Wait] = (), barred: Collection[Event] = ()
) -> list[Departures]:
    """Return the departures of an agent's gates with the conditions that were found or given.

    Args:
        courses: The executions.
        agent: The agent that waits.
        given: Waits given in the cell file.
        barred: Events to exclude.

    Raises:
        UnknownName: The cell file names a place or event that the logs do not contain.
    """
    gates, times = departures_of(courses, agent), times_of(courses)
    given = [wait for wait in given if wait.agent == agent]
    for wait in given:
        chosen = gate_of(gates, wait)
        if not wait.never:
            condition = _given_condition(times, chosen, wait)
            attach(gates, chosen, condition, since_event(times, chosen, condition))
    allowed = [
        [
            one
            for one in candidates_of(times, gate, agent)
            if one.event not in barred and not is_forbidden(given, gate, one)
        ]
        for gate in gates
    ]
    open_to = [best_condition(times, gate, some) for gate, some in zip(gates, allowed, strict=True)]
    while any(open_to):
        number = max((n for n, found in enumerate(open_to) if found), key=lambda n: open_to[n][2])  # type: ignore[index]
        number = _natural(gates, open_to, number)
        condition, since, _ = open_to[number]  # type: ignore[misc]  # not None: it has the largest gain
        for other in attach(gates, gates[number], condition, since):
            open_to[other] = (
                best_condition(times, gates[other], allowed[other])
                if len(gates[other].found) < MAX_CONDITIONS
                else None
            )
    return gates


def find_answer(gate: Departures, times: Times) -> Condition | None:
    """Return after which event of the robot the changes of a signal come, if any; `gate` then knows it.

    Args:
        gate: The changes as departures of whoever gives the signal, each ready since the one before it.
        times: Of all events.
    """
    robots = {event: at for event, at in times.items() if event.agent == "robot"}
    candidates = [one for one in candidates_of(robots, gate, "operator") if one.back <= 1]
    least = least_gain(min(len(gate.left_s), SEEN)) + np.log(max(len(candidates), 1))
    before = float(gate.causes().log_likelihood.sum())
    found = _best_of(robots, gate, candidates, before, least, follows=False)  # no signal brings the robot
    if found is None:
        return None
    gate.since_s[gate.gate, found[0]] = found[1]
    return found[0]


def attach(gates: Sequence[Departures], to: Departures, condition: Condition, since: Vector) -> list[int]:
    """Add a condition to all gates that share departures with its gate; return the numbers of these gates."""
    by_row = {row: (at, left) for row, at, left in zip(to.rows.tolist(), since, to.left_s, strict=True)}
    concerned = []
    for number, gate in enumerate(gates):
        rows = (by_row.get(row, (np.nan, np.nan)) for row in gate.rows.tolist())
        shared, left_s = np.array([*rows]).reshape(-1, 2).T
        shared = np.where(left_s == gate.left_s, shared, np.nan)  # otherwise he goes on at another time
        if gate is to or np.isfinite(shared).any():
            gate.since_s[to.gate, condition] = shared
            concerned.append(number)
    return concerned


def gate_of(gates: Sequence[Departures], wait: Wait) -> Departures:
    """Return the gate that the cell file names; if a place has two approach gates, the one short of it.

    Raises:
        UnknownName: There is no such gate.
    """
    at, place = ("approach", wait.before) if wait.before is not None else ("leave", wait.leaving)
    found = [gate for gate in gates if (gate.gate.at, gate.gate.place) == (at, place)]
    if not found:
        known = sorted({gate.gate.place for gate in gates if gate.gate.at == at})
        raise UnknownName(f"cell.toml [[waits]] of the {wait.agent}", "place", str(place), known)
    return max(found, key=lambda gate: gate.gate.short)


def _given_condition(times: Times, gate: Departures, wait: Wait) -> Condition:
    """Return the condition given in the cell file; `back` is that of the highest log-likelihood if not given."""
    found = [event for event in times if _means(wait, event)]
    if not found:
        known = sorted({event_text(event) for event in times if event.agent != wait.agent})
        raise UnknownName(f"cell.toml [[waits]] of the {wait.agent}", "event", str(wait.until), known)
    own = found[0].agent == gate.gate.agent and found[0].place == gate.gate.place  # it waits for an earlier visit
    numbers = ((1,) if own else (0, 1)) if wait.back is None else (wait.back,)
    conditions = [Condition(found[0], back) for back in numbers]
    if wait.back is None and not own:
        conditions += with_room(times, gate, found[0])

    def likelihood(condition: Condition) -> float:
        since = since_event(times, gate, condition)
        held = np.where(since >= -early_s(condition), since, np.nan)
        late = float((held != since).mean()) if len(since) else 0.0
        return float(gate.causes(held).log_likelihood.sum()) * (1.0 + late) if np.isfinite(held).any() else -np.inf

    return max(conditions, key=likelihood) if len(conditions) > 1 else conditions[0]


def event_text(event: Event) -> str:
    """Return an event as written in the cell file."""
    if event.signal is not None:
        return event.signal
    return f"{event.place} {event.event}" if event.agent == "signal" else f"{event.agent} {event.event} {event.place}"


def _means(wait: Wait, event: Event) -> bool:
    return wait.until is None or wait.until == event_text(event)


def is_forbidden(given: Sequence[Wait], gate: Departures, condition: Condition) -> bool:
    """Return whether the cell file says that a gate does not wait for an event."""

    def concerns(wait: Wait) -> bool:
        return wait.never and wait.place(gate.gate.at) == gate.gate.place and _means(wait, condition.event)

    return any(concerns(wait) for wait in given)


Found = tuple[Condition, "Vector", float]
"""A condition, the time from its event to each departure, s, and its gain in log-likelihood."""


def _natural(gates: Sequence[Departures], open_to: Sequence[Found | None], number: int) -> int:
    """Return the gate to which a condition is assigned, among gates with the same departures that it also explains.

    A wait until someone leaves belongs to an approach gate; a wait for an arrival or a signal belongs to a leave gate.
    A gate at which all departures need it goes before one at which only some do: an agent who also goes elsewhere from
    a place does not wait there.
    """
    chosen, _, gain = open_to[number]  # type: ignore[misc]  # not None: chosen by the caller
    at = "approach" if chosen.event.event == "leaves" else "leave"
    mine = gates[number]
    for other, (gate, found) in enumerate(zip(gates, open_to, strict=True)):
        both = len(np.intersect1d(gate.rows, mine.rows)) if gate.gate.short == mine.gate.short else 0
        same = both >= SAME * max(len(gate.rows), len(mine.rows))
        if not same or found is None or found[0].event[:2] != chosen.event[:2] or found[2] < SIMILAR_GAIN * gain:
            continue
        if found[0].partly < chosen.partly or (gate.gate.at == at and found[0].partly == chosen.partly):
            return other
    return number


def best_condition(times: Times, gate: Departures, candidates: Sequence[Condition]) -> Found | None:
    """Return the best condition that passes all tests, the time from its event to each departure in s, and its gain."""
    if len(gate.left_s) < MIN_DECIDED:
        return None
    before = float(gate.causes().log_likelihood.sum())
    taken = {one.event[:2] for (_, one), at in gate.since_s.items() if 2 * np.isfinite(at).sum() > len(at)}
    free = [one for one in candidates if one.event[:2] not in taken]
    least = least_gain(min(len(gate.left_s), SEEN)) + np.log(max(len(candidates), 1))
    always = _best_of(times, gate, free, before, least)
    rival = (
        0.0 if always is None else (1.0 + GAIN_TOLERANCE_SHARE) * always[2] / gate.weight
    )  # prefer one that all need
    partly = [one._replace(partly=True) for one in free]
    return _best_of(times, gate, partly, before, max(rival, MIN_PART * least)) or always


def _best_of(
    times: Times,
    gate: Departures,
    candidates: Sequence[Condition],
    before: float,
    least: float,
    *,
    follows: bool = True,
) -> Found | None:
    """Return the best of some conditions that raise the log-likelihood from `before` by at least so much.

    With `follows` none of them may follow own work.
    """
    tried: list[Found] = []
    for condition in candidates:
        since = since_event(times, gate, condition)
        if not _holds(gate, condition, since):
            continue
        since = _later(condition, since)
        causes = gate.causes(since)
        gain, decides = float(causes.log_likelihood.sum()) - before, causes.share[-1].sum() * gate.weight
        if (
            decides >= (MIN_DECIDED if condition.partly or gain < SURE * least else FEW_DECIDED)
            and not (follows and _follows(gate, causes, since))
            and not _ahead(gate, condition, causes, since[gate.seen])
            and (not _is_indirect(gate, condition) or is_steady(gate, causes, since[gate.seen]))
        ):
            tried.append((condition, since, gain))
    tried.sort(key=lambda each: -each[2])
    good = [each for each in tried if each[2] >= least]
    if not good or good[0][2] - _by_chance(gate, times, good[0][0]) + before < least:
        return None
    as_good = [each for each in good if each[2] >= good[0][2] - max(GAIN_TOLERANCE, GAIN_TOLERANCE_SHARE * good[0][2])]
    found = min(as_good, key=lambda each: _before(*each[:2]))
    return found[0], found[1], found[2] * gate.weight


def _is_indirect(gate: Departures, condition: Condition) -> bool:
    """Return whether a condition is not on the other agent's last visits, so that it may hold by chance."""
    return condition.event.agent == gate.gate.agent or condition.back > 1


def _follows(gate: Departures, causes: Causes, since: Vector) -> bool:
    """Return whether an event is a consequence of own work: departures decided by own work follow it as closely.

    An agent who always waits has no such departures: some are assigned to own work by mistake.
    """
    decided, seen = causes.share.argmax(axis=0), since[gate.seen]
    own, by_event = seen[decided == 0], seen[decided == len(causes.share) - 1]
    own = own[np.isfinite(own)]
    if len(own) < MIN_DECIDED or not len(by_event):
        return False
    most, usual = (float(np.mean(own <= np.quantile(by_event, level) + EARLY_S)) for level in (1.0, CLOSE))
    if most <= FOLLOWS or usual <= USUALLY_FOLLOWS:  # some are assigned to the event by mistake
        return False
    waits = gate.waits(since).log_likelihood
    return float((causes.log_likelihood - waits).sum()) >= least_gain(len(seen))


def _ahead(gate: Departures, condition: Condition, causes: Causes, since: Vector) -> bool:
    """Tell whether an agent goes before most of the events that it would react to: nobody does.

    A signal changes after the robot has gone because it has gone: its part is missing.
    """
    by_event = since[causes.share.argmax(axis=0) == len(causes.share) - 1]
    reacts = gate.gate.agent == "operator" or condition.event.agent == "signal"
    return reacts and len(by_event) > 0 and float(np.median(by_event)) < 0.0


def _before(condition: Condition, since: Vector) -> float:
    """Return the time from event to departures, s (10 % quantile), plus PULSE_S for a cleared signal."""
    known = since[np.isfinite(since)]
    if not len(known):
        return float("inf")
    return abs(float(np.quantile(known, 0.1))) + (PULSE_S if "cleared" in str(condition.event) else 0.0)


def _holds(gate: Departures, condition: Condition, since: Vector) -> bool:
    """Return whether enough departures come after their events, and enough events come late enough to have decided."""
    known = np.isfinite(since)
    if np.count_nonzero(known) < MIN_DECIDED:
        return False
    if condition.event.agent == gate.gate.agent:  # came before it was here: `is_steady` tells
        return not condition.partly
    late = since < gate.left_s - gate.own_s  # the event came after the agent was free to go
    held = known & (since >= -early_s(condition))
    share = np.count_nonzero(held) / np.count_nonzero(known)
    enough = NEEDED <= share < HELD if condition.partly else share >= HELD
    decided = np.count_nonzero(late & (held if condition.partly else known))
    return bool(enough and decided >= (MIN_DECIDED if condition.partly else FEW_LATE))


def _later(condition: Condition, since: Vector) -> Vector:
    """Return the time from event to departure; if not all departures need it, -inf where the event came later."""
    return np.where(since < -early_s(condition), -np.inf, since) if condition.partly else since


def decided_by(since_s: Floats) -> Ints:
    """Return the cause that decided each departure, shape (N,); 0 = own work, if that improves the fit enough."""
    causes = deciding_causes(since_s)
    if len(since_s) > 1:
        waits = deciding_causes(since_s[1:])
        if float((causes.log_likelihood - waits.log_likelihood).sum()) < least_gain(since_s.shape[1]):
            return np.asarray(1 + waits.share.argmax(axis=0))
    return np.asarray(causes.share.argmax(axis=0))


def _by_chance(gate: Departures, times: Times, condition: Condition) -> float:
    """Return the highest log-likelihood with the same events in random order."""
    rng, since = np.random.default_rng(0), since_event(times, gate, condition)
    known = np.flatnonzero(np.isfinite(since))
    ahead = (gate.left_s - gate.own_s) - since  # lead of own work over the event
    found = [-np.inf]
    for _ in range(SHUFFLES):
        other = np.full(len(since), np.nan)
        other[known] = (gate.left_s - gate.own_s)[known] - rng.permutation(ahead[known])
        other = _later(condition, other) if condition.partly else np.where(other >= -EARLY_S, other, np.nan)
        found.append(float(gate.causes(other).log_likelihood.sum()))
    return max(found)
