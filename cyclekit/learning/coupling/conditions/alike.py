"""Conditions at places of one kind, such as four fixtures with a button each, learned from all of these together.

Places are of one kind if their names differ only in a number or a last letter, or if the other agent waits in the same
way at each of them. Alone each may be visited too seldom to show what an agent waits for there; together they do. The
k-th passage at a place then needs the k-th event of the place with the same number. The evidence is that of
`conditions`, over all places of the kind.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.coupling.conditions.candidates import HELD, candidates_of, early_s, since_event, times_of
from cyclekit.learning.coupling.conditions.conditions import (
    GAIN_TOLERANCE_SHARE,
    MAX_CONDITIONS,
    attach,
    best_condition,
    find_conditions,
    is_forbidden,
)
from cyclekit.learning.coupling.conditions.departures import (
    Alike,
    Condition,
    Departures,
    Gate,
    condition_gain,
    least_gain,
)
from cyclekit.learning.coupling.events.visits import Event

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from cyclekit.config import Wait
    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.learning.coupling.conditions.candidates import Times
    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Ints, Vector

NUMBERED = re.compile(r"\d+(?=\D*$)|(?<=[ _.-])[A-Za-z]$")
"""The last number of a name, or a single last letter after a separator."""
FOUND = frozenset({"place_#", "spot_#"})
"""Names of places that were found in the logs: their numbers are arbitrary, so they tell no kind."""
SUPPORTS, REFUTES = 1.0, -1.0
"""Gain in log-likelihood of the departures at one place, above which they support a condition, below which they refute
it."""
MIN_SUPPORTS = 2
"""Minimum number of places that support a condition."""


Kinds = dict[str, tuple[str, str]]
"""Kind and number of places, by name."""


class _Kind(NamedTuple):
    """Gates at places of one kind, and the events of places of one kind, by number.

    Attributes:
        place: Name of the kind.
        members: The gates.
        events: The events of each kind.
        never: Where the robot may wait short of the places, the gates of those where it never did.
    """

    place: str
    members: dict[str, Departures]
    events: dict[Event, dict[str, Event]]
    never: dict[str, Departures]


def find_with_alike(
    courses: Sequence[ExecutionVisits],
    agent: Agent,
    given: Sequence[Wait] = (),
    barred: Collection[Event] = (),
    kinds: Kinds | None = None,
) -> list[Departures]:
    """Return the departures of an agent's gates with their conditions, also those that only places alike show.

    Args:
        courses: The executions.
        agent: The agent that waits.
        given: Waits given in the cell file.
        barred: Events to exclude.
        kinds: Kind and number of further places that are of one kind (`kinds_by_waits`).

    Raises:
        UnknownName: The cell file names a place or event that the logs do not contain.
    """
    gates, times = find_conditions(courses, agent, given, barred), times_of(courses)
    for kind in (*_kinds(gates, times, barred, None), *_kinds(gates, times, barred, kinds or {})):
        _learn(gates, times, kind, [wait for wait in given if wait.agent == agent])
    if not given and any(gate.alike for gate in gates):
        _drop_redundant(gates)
    return gates


def _drop_redundant(gates: Sequence[Departures]) -> None:
    """Drop conditions of single gates that explain nothing more once those of places alike are known."""
    for gate in gates:
        for condition in [one for one in gate.found if one not in gate.alike]:
            if condition_gain(gate, condition) < least_gain(len(gate.seen)):
                for other in gates:
                    other.since_s.pop((gate.gate, condition), None)


def number_of(name: str) -> tuple[str, str] | None:
    """Return a name with # in place of its number, and the number: `fixture_2` -> `fixture_#`, `2`; None without.

    Names that were not given, `place_2` and `spot_2`, have none.
    """
    found = NUMBERED.search(name)
    kind = f"{name[: found.start()]}#{name[found.end() :]}" if found else ""
    return (kind, found[0]) if found and kind not in FOUND else None


def kinds_by_waits(other: Sequence[Departures]) -> Kinds:
    """Return kind and number of places without numbers where an agent waits in the same way, and of those of the other.

    Args:
        other: Gates of one agent with their conditions. Where it waits for the other to leave several places, each for
            its own, the other may wait in the same way at each of these.
    """
    pairs: dict[object, list[tuple[str, str]]] = defaultdict(list)
    for gate in other:
        for one in gate.found:
            if one.event.agent != "signal" and one.event.agent != gate.gate.agent and not number_of(gate.gate.place):
                same = (gate.gate.at, one.event.agent, one.event.event, one.back, one.turns, one.partly)
                pairs[same].append((gate.gate.place, one.event.place))
    found: dict[str, tuple[str, str]] = {}
    for n, some in enumerate(pairs.values()):
        mine, theirs = zip(*some, strict=True)
        if len(some) > 1 and len(set(mine)) == len(set(theirs)) == len(some) and not found.keys() & {*mine, *theirs}:
            found |= {name: (f"# of {n}", str(k)) for names in (mine, theirs) for k, name in enumerate(names)}
    return found


def _kinds(
    gates: Sequence[Departures], times: Times, barred: Collection[Event], by_waits: Kinds | None
) -> Iterator[_Kind]:
    """Yield the kinds of gates by the names of their places, or by how the other agent waits at these."""
    number = number_of if by_waits is None else by_waits.get
    by_kind: dict[Gate, dict[str, Departures]] = defaultdict(dict)
    for gate in gates:
        if named := number(gate.gate.place):
            by_kind[replace(gate.gate, place=named[0])][named[1]] = gate
    events: dict[Event, dict[str, Event]] = defaultdict(dict)
    twice = set[Event]()
    for event in times:
        named = number(event.place)
        if named and event not in barred:
            kind = event._replace(place=named[0], signal=_signal_of_kind(event.signal, by_waits is None))
            twice |= {kind} if named[1] in events[kind] else set()
            events[kind][named[1]] = event
    for shared, members in by_kind.items():
        mine = {
            kind: some for kind, some in events.items() if kind not in twice and len(some.keys() & members.keys()) > 1
        }
        if len(members) > 1 and mine:
            yield _Kind(
                shared.place, members, mine, by_kind.get(replace(shared, short=False), {}) if shared.short else {}
            )


def _signal_of_kind(signal: str | None, by_name: bool) -> str | None:
    """Return a signal with # in place of its number, else what is common to signals of any name: their state."""
    if signal is None or not by_name:
        return signal and signal.rpartition(" ")[2]
    return (number_of(signal) or (signal,))[0]


def _learn(gates: Sequence[Departures], times: Times, kind: _Kind, given: Sequence[Wait]) -> None:
    """Find what the gates of one kind need, and attach it to those of them that do not refute it."""
    known: list[Condition] = []
    while len(known) < MAX_CONDITIONS and (found := _found(times, kind, known)):
        condition, gains = found
        known.append(condition)
        mine = {number: kind.members[number] for number, gain in gains.items() if gain > REFUTES}
        if sum(gain > SUPPORTS for gain in gains.values()) < max(MIN_SUPPORTS, len(kind.members) - len(mine) + 1):
            continue
        alike = _alike(times, kind._replace(members=mine), condition)
        for number, gate in (mine | kind.never).items():
            if (event := kind.events[condition.event].get(number)) is None:
                continue
            one = condition._replace(event=event)
            since = since_event(times, gate, one)
            if number not in mine:  # the robot never stood short of this place: it had better not be there too early
                since += gate.came_s - gate.left_s
                if (since < -early_s(one)).any():
                    continue
            if not is_forbidden(given, gate, one):
                _replace(gates, gate, one, since)
                gate.alike[one] = alike._replace(mine=np.isin(alike.joined.rows, gate.rows))


def _found(times: Times, kind: _Kind, known: Sequence[Condition]) -> tuple[Condition, dict[str, float]] | None:
    """Return the best condition of a kind, and its gain at each place; places that do not obey one are left out.

    One that only some departures need, at all places, must explain clearly more.
    """
    joined, together = _joined(kind, times, known), _times_of_kind(times, kind)
    parts: dict[tuple[str, ...], list[Condition]] = defaultdict(list)
    for condition in candidates_of(together, joined, joined.gate.agent):
        parts[_obeying(kind, condition, since_event(together, joined, condition))].append(condition)
    found: tuple[Condition, dict[str, float], float] | None = None
    for numbers, candidates in parts.items():
        some = kind._replace(members={number: kind.members[number] for number in numbers})
        if len(numbers) >= MIN_SUPPORTS and (one := _best(times, some, candidates, known)):
            found = one if found is None or one[2] > found[2] else found
    every = [condition for some in parts.values() for condition in some]
    if len(parts) > 1 and (one := _best(times, kind, every, known)):
        found = one if found is None or one[2] > (1.0 + GAIN_TOLERANCE_SHARE) * found[2] else found
    return found[:2] if found else None


def _best(
    times: Times, kind: _Kind, candidates: Sequence[Condition], known: Sequence[Condition]
) -> tuple[Condition, dict[str, float], float] | None:
    """Return the best of some conditions of a kind, its gain in log-likelihood at each place, and the whole gain."""
    joined = _joined(kind, times, known)
    found = best_condition(_times_of_kind(times, kind), joined, candidates)
    if found is None:
        return None
    condition, since, whole = found
    gain, whose = joined.causes(since).log_likelihood - joined.causes().log_likelihood, _whose(kind)[joined.seen]
    return condition, {number: float(gain[whose == n].sum()) for n, number in enumerate(kind.members)}, whole


def _replace(gates: Sequence[Departures], member: Departures, one: Condition, since: Vector) -> None:
    """Give a gate a condition of its kind, in place of those on the same visits of the other agent."""
    for old in [old for old in member.found if old.event[:2] == one.event[:2]]:
        for gate in gates:
            gate.since_s.pop((member.gate, old), None)
    attach(gates, member, one, since)


def _obeying(kind: _Kind, condition: Condition, since: Vector) -> tuple[str, ...]:
    """Return the numbers of the places where departures do not precede the event."""
    whose, early = _whose(kind), since < -early_s(condition)
    known = np.isfinite(since)
    return tuple(
        number
        for n, number in enumerate(kind.members)
        if np.count_nonzero(early[whose == n]) <= (1.0 - HELD) * np.count_nonzero(known[whose == n]) + 0.5
    )


def _whose(kind: _Kind) -> Ints:
    """Return the number of the member of each departure in `_joined`, shape (N,)."""
    return np.repeat(np.arange(len(kind.members)), [len(each.left_s) for each in kind.members.values()])


def _alike(times: Times, kind: _Kind, condition: Condition) -> Alike:
    """Return the departures of the gates that need a condition, and the time of each since its event."""
    some, together = _joined(kind, times, ()), _times_of_kind(times, kind)
    some.since_s[some.gate, condition] = since_event(together, some, condition)
    left = condition._replace(event=condition.event._replace(signal=None))
    seen = since_event(together, some, left if left.event in together else condition)
    return Alike(some, condition, seen, np.zeros(len(seen), np.bool_))


def _joined(kind: _Kind, times: Times, known: Sequence[Condition]) -> Departures:
    """Return the departures of all gates of a kind as those of one gate, each execution once for each place.

    They have the conditions that are `known` of the kind, and those of other events.
    """
    members = list(kind.members.values())
    executions = len(next(iter(times.values())))
    counts = np.cumsum([0] + [len(each.left_s) for each in members])
    own = [each.own_s + _usual_s(each) for each in members]
    found = Departures(
        replace(members[0].gate, place=kind.place),
        np.concatenate([each.rows for each in members]),
        np.concatenate([each.course + n * executions for n, each in enumerate(members)]),
        np.concatenate([each.occurrence for each in members]),
        np.concatenate(own),
        np.concatenate([each.left_s for each in members]),
        np.concatenate([each.came_s for each in members]),
    )
    alike = {event for some in kind.events.values() for event in some.values()}
    for n, each in enumerate(members):
        for (gate, condition), since in each.since_s.items():
            if condition.event not in alike:
                column = np.full(len(found.left_s), np.nan)
                column[counts[n] : counts[n + 1]] = since
                found.since_s[gate, condition] = column
    together = _times_of_kind(times, kind)
    return replace(
        found, since_s=found.since_s | {(found.gate, one): since_event(together, found, one) for one in known}
    )


def _usual_s(gate: Departures) -> float:
    """Return the usual own work before leaving a place, which may differ between places of a kind, s."""
    return float(np.quantile(gate.left_s - gate.own_s, 0.1)) if gate.gate.at == "leave" else 0.0


def _times_of_kind(times: Times, kind: _Kind) -> Times:
    """Return the times of each kind of event, with the executions once for each place, as in `_joined`."""
    executions = len(next(iter(times.values())))
    found: Times = {}
    for event, by_number in kind.events.items():
        most = max(times[each].shape[1] for each in by_number.values())
        found[event] = np.full((len(kind.members) * executions, most), np.nan)
        for n, number in enumerate(kind.members):
            if number in by_number:
                at = times[by_number[number]]
                found[event][n * executions : (n + 1) * executions, : at.shape[1]] = at
    return found
