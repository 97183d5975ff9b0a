"""Proposes which states of a PLC's trace are tasks, whose, and what begins a cycle: for a drafted cell file.

Stations are bits that exclude each other and are named alike, steps and words the states of one column that come again.
A cycle begins with a start button, with leaving a state of rest, with a program number, or with the state between whose
returns the agent is always at as many places.
"""

from __future__ import annotations

import re
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.adapter import is_person
from cyclekit.config.cells import Activity
from cyclekit.ingest.activities import is_bit

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cyclekit.ingest.activities import SignalLog, Stay

EXCLUSIVE = 0.02
"""Statistical: bits exclude each other if they are on together for at most this share of the time that one of them is.
Half and twice of it change no draft of the simulated plants."""
FEWEST = 3
"""Statistical: cycles, and returns of a state on average, that a log must hold. 2 and 6 change no draft of these."""
MOST_STATES = 100
"""A size: a column of more states is a count or a measurement."""
REGULAR = 0.1
"""Statistical: coefficient of variation of the number of tasks of a cycle up to which a state that is no rest may begin
it. Half and twice of it change no draft of these."""

_WORDS = re.compile(r"[A-ZÄÖÜ]+(?![a-zäöüß])|[A-ZÄÖÜ]?[a-zäöüß]+|\d+")
_STATION = {"rob", "roboter", "robot", "station", "stat", "platz", "pos", "position", "place", "at", "an", "am", "bei",
            "ort", "nest", "werker"}  # fmt: skip
_STEP = {"schritt", "step", "state", "zustand", "status", "seq", "sequence", "phase", "kette", "chain", "packml"}
_NO_STATION = {"greifer", "gripper", "grip", "tür", "tuer", "door", "ampel", "lampe", "lamp", "light", "tower", "feld",
               "field", "schutz", "schutzfeld", "warnfeld", "warning", "protective", "scanner", "taste", "taster",
               "button", "start", "stop", "ventil", "valve", "spanner", "clamp", "zylinder", "cylinder", "sauger",
               "vacuum", "vakuum", "modus", "mode", "betriebsart", "auto", "hand", "override", "ovr", "prozent",
               "percent", "alarm", "fehler", "error", "fault", "teil", "part", "zaehler", "zähler", "count",
               "counter"}  # fmt: skip
_START = {"start", "zyklusstart", "cyclestart", "go", "begin", "anlauf", "startknopf", "starttaste", "zyklus", "cycle"}
_PROGRAM = {"program", "programm", "prog", "prg", "recipe", "rezept", "rezeptur", "typ", "type", "product", "produkt",
            "auftrag", "job", "order", "variante", "variant", "model", "modell"}  # fmt: skip
_REST = {"home", "grundstellung", "gst", "idle", "ready", "bereit", "ruhe", "standby", "warten", "wait", "waiting",
         "stopped", "leerlauf", "init"}  # fmt: skip
_WAY = {"fahrt", "fahren", "faehrt", "fährt", "verfahren", "moving", "move", "travel", "traveling", "travelling",
        "transit", "unterwegs", "bewegung", "motion", "between", "zwischen", "none", "unknown", "transfer"}  # fmt: skip


class _Found(NamedTuple):
    """Signals whose states may be tasks: their states in order of time, those that are none, and a rank."""

    signals: tuple[str, ...]
    stays: list[Stay]
    idle: tuple[str, ...]
    rank: tuple[bool, bool, int]


def find_activities(changes: SignalLog) -> tuple[Activity, ...]:
    """Return the activities that the signals of a log show; none if they show no tasks of a robot, or no cycle."""
    signals = {name: changes.stays(name) for name in changes.names(["*"])}
    bits = {name: stays for name, stays in signals.items() if is_bit(stay.name for stay in stays)}
    able = [found for some in _alike(bits) if (found := _as_bits(some, bits)) is not None]
    able += [found for name in signals.keys() - bits.keys() if (found := _as_states(name, signals[name])) is not None]
    robots = [found for found in able if not any(map(is_person, found.signals))]
    if not robots:
        return ()
    best = max(robots, key=lambda found: (*found.rank, found.signals))
    cycle, rest = _cycle(best, signals, bits)
    if cycle is None:
        return ()
    column = (_pattern(best.signals, signals),) if len(best.signals) > 1 else best.signals
    column = column if all(column) else best.signals
    people = [found for found in able if all(map(is_person, found.signals))]
    first = Activity(column, idle=tuple(dict.fromkeys((*best.idle, *rest))), cycle=cycle)
    return (first, *(Activity(one.signals, agent=_agent(one.signals[0])) for one in people[:1]))


def _is_rest(state: str) -> bool:
    return state == "0" or bool(_words(state) & _REST)


def _words(name: str) -> set[str]:
    return {word.lower() for word in _WORDS.findall(name)}


def _alike(bits: Mapping[str, Sequence[Stay]]) -> set[tuple[str, ...]]:
    """Return groups of bits whose names begin, or end, with the same words."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in bits:
        words = [word.lower() for word in _WORDS.findall(name)]
        if _words(name) & _NO_STATION:
            continue
        for count in range(1, len(words) + 1):
            groups.setdefault(("begins", *words[:count]), []).append(name)
            groups.setdefault(("ends", *words[-count:]), []).append(name)
    return {tuple(names) for names in groups.values() if len(names) > 1 or is_person(names[0])}


def _as_bits(names: tuple[str, ...], bits: Mapping[str, Sequence[Stay]]) -> _Found | None:
    """Return a group of bits as tasks, if they exclude each other."""
    on = {name: [stay for stay in bits[name] if stay.name == "1"] for name in names}
    on = {name: stays for name, stays in on.items() if stays}
    stays = sorted((stay._replace(name=name) for name in on for stay in on[name]), key=lambda stay: stay.begin_s)
    rest = tuple(name for name in on if _is_rest(name))
    if len(stays) < FEWEST * len(on) or (len(on) < 2 and not any(map(is_person, on))):
        return None
    if any(_together_s(on[one], on[other]) > EXCLUSIVE * _lasted_s(on[one]) for one, other in combinations(on, 2)):
        return None
    named = all(_words(name) & _STATION for name in on)
    if not named and len(on) == 2:  # open and closed, on and off
        return None
    return _Found(tuple(on), stays, rest, (named, len(on) > 2, len(stays)))


def _together_s(one: Sequence[Stay], other: Sequence[Stay]) -> float:
    """Return for how long two bits are on at the same time, s."""
    begins, ends = (np.array([getattr(stay, edge) for stay in other]) for edge in ("begin_s", "end_s"))
    ends = np.where(np.isnan(ends), begins, ends)
    done_s = np.concatenate([[0.0], np.cumsum(ends - begins)])

    def until_s(at_s: float) -> float:
        number = int(np.searchsorted(begins, at_s, side="right"))
        return float(done_s[number] - max(ends[number - 1] - at_s, 0.0)) if number else 0.0

    return sum(until_s(stay.end_s) - until_s(stay.begin_s) for stay in one if stay.end_s == stay.end_s)


def _lasted_s(stays: Iterable[Stay]) -> float:
    return sum(stay.end_s - stay.begin_s for stay in stays if stay.end_s == stay.end_s)


def _as_states(name: str, stays: list[Stay]) -> _Found | None:
    """Return the states of a column as tasks, if they come again."""
    states = {stay.name for stay in stays} - {""}
    words = _words(name)
    if words & (_NO_STATION | _PROGRAM) or any(re.search(r"\d[.,]\d*[1-9]", state) for state in states):
        return None
    ways = {state for state in states if _words(state) & _WAY}
    rest = {state for state in states - ways if _is_rest(state)}
    tasks = [stay for stay in stays if stay.name in states - ways]
    if not 2 < len(states) <= MOST_STATES or len(tasks) < FEWEST * len(states - ways):
        return None
    idle = tuple(sorted(ways | rest))
    return _Found((name,), tasks, idle, (False, bool(words & (_STEP | _STATION)), len(tasks)))


def _cycle(
    found: _Found, signals: Mapping[str, Sequence[Stay]], bits: Mapping[str, Sequence[Stay]]
) -> tuple[str | None, tuple[str, ...]]:
    """Return what begins a cycle, as in the cell file, and the state of rest that does."""
    tasks = np.array([stay.begin_s for stay in found.stays if stay.name not in found.idle])

    def counts(begins_s: Sequence[float]) -> np.ndarray:
        return np.diff(np.searchsorted(tasks, begins_s))

    def divides(begins_s: Sequence[float]) -> bool:
        each = counts(begins_s)
        return len(each) >= FEWEST and float(np.median(each)) >= 2.0

    for name, stays in bits.items():
        if _words(name) & _START and divides([stay.begin_s for stay in stays if stay.name == "1"]):
            return name, ()
    of = "" if len(found.signals) > 1 else f"{found.signals[0]}="
    returns: dict[str, list[float]] = {}
    for stay in found.stays:
        returns.setdefault(stay.name, []).append(stay.begin_s)
    for state, begins_s in sorted(returns.items(), key=lambda one: one[0] == "0"):
        if _is_rest(state) and divides(begins_s):
            return f"{of}{state}", (state,)
    for name, stays in signals.items():
        work = {other.name for one, other in pairwise(stays) if _is_rest(one.name) and not _is_rest(other.name)}
        begins_s = [stay.begin_s for stay in stays if stay.name in work]
        other = name not in (*found.signals, *bits) and not _words(name) & _PROGRAM
        if other and len(work) == 1 and divides(begins_s):
            return f"{name}={work.pop()}", ()
    for name, stays in signals.items():
        comes_s = [stay.begin_s for stay in stays if stay.name not in ("0", "")]
        if name not in bits and _words(name) & _PROGRAM and divides(comes_s):
            return name, ()
    able = [(state, counts(at_s)) for state, at_s in returns.items() if divides(at_s) and state not in found.idle]
    spread = {state: float(each.std() / each.mean()) for state, each in able}
    regular = [state for state, _ in able if spread[state] <= REGULAR]
    best = min(
        regular, key=lambda state: (round(spread[state], 2), len(returns[state]), returns[state][0]), default=None
    )
    return (f"{of}{best}", ()) if best is not None else (None, ())


def _pattern(names: Sequence[str], signals: Iterable[str]) -> str:
    """Return the pattern that means these signals and no others; empty if there is none."""
    first, last = min(names), max(names)
    same = next((at for at, (one, other) in enumerate(zip(first, last, strict=False)) if one != other), len(first))
    begin = first[:same]
    plain = not set("*?[") & set(begin)
    return f"{begin}*" if begin and plain and {s for s in signals if s.startswith(begin)} == set(names) else ""


def _agent(name: str) -> str:
    return next(str(word) for word in _WORDS.findall(name) if is_person(word))
