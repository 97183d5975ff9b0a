"""Find the signals that show people where there is no tracker: fields of a scanner, light curtains, doors, mats.

A signal is accepted if the level follows it with a constant delay, and if it explains more of the lost time on
held-out executions than the robot's place and the signals accepted before it. Signals that the robot itself sets are
excluded: outputs, the register, inputs that mirror an output, and signals that follow the speed instead of leading it.

If the level rises after a button instead of after the signal, the stop that lasts until then is accepted in place of
the signal, if it explains more.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards import OperatorSignalCard
from cyclekit.dataset.signals import OUTPUT, REGISTER, SignalChanges, state_of
from cyclekit.derive.causes.cause_samples import signal_position_features
from cyclekit.derive.causes.usual_levels import usual_levels
from cyclekit.derive.signals.latched_signals import OFF, ON, begins_of, latched
from cyclekit.derive.signals.robot_signals import not_set_by_robot, of_program
from cyclekit.derive.signals.signal_evidence import SignalEvidence
from cyclekit.derive.signals.signal_responses import (
    MAX_RESTART_S,
    MIN_RESPONSES,
    SAME_S,
    Responses,
    left_s,
    responses_to,
)
from cyclekit.errors import UnknownName

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config.cells import OperatorSignal
    from cyclekit.schema import Bools, Vector

LATE_S = 0.5
"""Maximum time, s, after a change of speed at which a signal may be a field that is logged late."""
MIN_GAIN = 0.02
"""Minimum additional share of the lost time that a signal must explain."""
OF_REST, MIN_LATER_GAIN, BEYOND_CHANCE = 0.5, 0.005, 4.0
"""Enough after the first signal: share of the unexplained time, share of the lost time, standard errors by execution.
Where two fields together almost always show what a third one shows, the third one explains little more; but without it
no rule on single fields is right."""
FOLDS, MAX_SIGNALS, MAX_ROWS = 5, 16, 30_000
MAX_RESETS = 3
"""Maximum number of resets that are tried for one stop: those after which the level rises most often."""
SHORT, COARSE = 5, 4
"""If there are more candidates, all are compared on every COARSE-th sample, and the best SHORT of them on all."""


class _Lead(NamedTuple):
    """Response of the level to a signal: the value that means occupied, and the delays, s, of falls and rises.

    `by_rises`: no falls answer it, so the delay is that of the rises.
    """

    occupied: str
    delay_s: float
    rise_s: float | None
    by_rises: bool = False

    @property
    def hold_s(self) -> float | None:
        """Additional delay of rises, s; None if no rise was seen."""
        hold_s = None if self.rise_s is None else self.rise_s - self.delay_s
        return hold_s if hold_s is None or hold_s > SAME_S else 0.0


class _Stop(NamedTuple):
    """A stop that lasts until a reset: its signal and value, and the reset and its value."""

    signal: str
    occupied: str
    reset: str
    reset_at: str


class FoundSignals(NamedTuple):
    """Signals that show people; reaction time to the first, s, and least additional delay of rises, s; None = not seen.

    `follow`: inputs that change after the speed, and their delay, s; set only if no signal was found.
    """

    cards: tuple[OperatorSignalCard, ...] = ()
    latency_s: float | None = None
    hold_s: float | None = None
    follow: tuple[tuple[str, float], ...] = ()


def find_signals(evidence: SignalEvidence, told: Sequence[OperatorSignal] = ()) -> FoundSignals:
    """Return the signals that show people.

    Args:
        evidence: Data of all sessions, or of some.
        told: Signals that the cell file names; if given, no others are searched for.

    Raises:
        UnknownName: No log holds a signal that the cell file names, or it never changes.
    """
    leads: dict[str, _Lead] = {}
    stops: dict[str, _Stop] = {}
    order: list[tuple[str, str]] = []
    if told:
        for one in told:
            for name in filter(None, (one.signal, one.reset)):
                if name not in evidence.signals:
                    raise UnknownName(
                        "[[operator_signals]] of the cell file", "signal that changes", name, evidence.signals
                    )
            signal, occupied = one.signal, state_of(one.occupied)
            if one.reset is not None:
                stop = _Stop(signal, occupied, one.reset, state_of(one.reset_at))
                signal, occupied = _name_of(stop), ON
                stops[signal], evidence = stop, _with(evidence, signal, _course(evidence, stop))
            lead = _lead(occupied, *_delays(evidence, signal, occupied), evidence.at_once_s)
            leads[signal] = lead or _Lead(occupied, 0.0, None)
            order.append((one.name, signal))
    else:
        leads = _leading(evidence)
        evidence, leads, stops, found = _explaining(evidence, leads)
        order = [(name, name) for name in found]
    cards: list[OperatorSignalCard] = []
    on: list[Bools] = []
    usual_s = min((leads[signal].delay_s for _, signal in order if not leads[signal].by_rises), default=np.inf)
    for name, signal in order:
        leads |= _with_usual_delay(evidence, on, {signal: leads[signal]}, usual_s)
        lead = leads[signal]
        stop = stops.get(signal, _Stop(signal, lead.occupied, "", ""))
        on.append(_on(evidence, signal, lead))
        cards.append(
            OperatorSignalCard(
                name=name,
                signal=stop.signal,
                occupied=stop.occupied,
                reset=stop.reset or None,
                reset_at=stop.reset_at,
                delay_s=round(max(lead.delay_s, 0.0), 3),
                hold_s=None if lead.hold_s is None else round(lead.hold_s, 3),
                explained=max(0.0, min(1.0, round(1.0 - float(_unexplained(evidence, on).sum()), 4))),
                told=bool(told),
            )
        )
    first = leads[order[0][1]] if order else None
    if first is None:
        return FoundSignals(follow=_following(evidence))
    holds_s = [card.hold_s for card in cards if card.hold_s is not None]
    return FoundSignals(tuple(cards), max(first.delay_s, 0.0), min(holds_s, default=0.0) or None)


def _leading(evidence: SignalEvidence) -> dict[str, _Lead]:
    """Return the signals that the level follows and that the robot does not set."""
    found = {}
    for name, changes in not_set_by_robot(evidence).items():
        tried = [(value, *_delays(evidence, name, value)) for value in np.unique(changes.value).tolist()]
        value, falls, rises = max(tried, key=lambda one: one[1][1] + one[2][1])
        lead = _lead(value, falls, rises, evidence.at_once_s)
        if lead is not None and not of_program(evidence, changes.at(evidence.t_s) == value):
            found[name] = lead
    return found


def _with_stops(
    evidence: SignalEvidence, leads: Mapping[str, _Lead]
) -> tuple[SignalEvidence, dict[str, _Lead], dict[str, _Stop]]:
    """Return evidence and leads with those stops that last until a reset, and these stops, by name.

    The level must rise at a constant delay after the reset, and less often after the signal itself. A signal that lets
    the level fall as well is a field, no button.
    """
    resets = [
        (name, value)
        for name, changes in not_set_by_robot(evidence).items()
        for value in np.unique(changes.value).tolist()
        if _lead(value, Responses(), _resumes(evidence, changes.to(value)), evidence.at_once_s)
        and 2 * responses_to(left_s(changes, value), evidence.falls_s).number < len(changes.to(value))
    ]
    found, stops = dict(leads), dict[str, _Stop]()
    for name, lead in leads.items():
        falls, rises = _delays(evidence, name, lead.occupied)
        able: list[tuple[int, _Stop, _Lead, SignalChanges]] = []
        for reset, value in resets:
            stop = _Stop(name, lead.occupied, reset, value)
            course = _course(evidence, stop)
            resumes = _resumes(evidence, course.to(OFF))
            mine = _lead(ON, falls, resumes, evidence.at_once_s)
            if reset != name and mine is not None and mine.rise_s is not None and resumes.number > rises.number:
                able.append((resumes.number, stop, mine, course))
        for _, stop, mine, course in sorted(able, key=lambda one: -one[0])[:MAX_RESETS]:
            stops[_name_of(stop)], found[_name_of(stop)] = stop, mine
            evidence = _with(evidence, _name_of(stop), course)
    return evidence, found, stops


def _course(evidence: SignalEvidence, stop: _Stop) -> SignalChanges:
    signal, reset = evidence.signals[stop.signal], evidence.signals[stop.reset]
    return latched(signal, stop.occupied, reset, stop.reset_at, begins_of(stop.signal, evidence.begins_s))


def _name_of(stop: _Stop) -> str:
    return f"{stop.signal} (reset: {stop.reset}{'' if stop.reset_at == ON else f' = {stop.reset_at}'})"


def _with(evidence: SignalEvidence, name: str, changes: SignalChanges) -> SignalEvidence:
    return replace(evidence, signals={**evidence.signals, name: changes})


def _following(evidence: SignalEvidence) -> tuple[tuple[str, float], ...]:
    """Return the inputs that change a constant time after the speed, and that delay, s."""
    found = []
    for name, changes in evidence.signals.items():
        if name != REGISTER and not name.startswith(OUTPUT):
            tried = [_delays(evidence, name, value) for value in np.unique(changes.value).tolist()]
            falls, rises = max(tried, key=lambda one: one[0].number + one[1].number)
            late = [one.delay_s for one in (falls, rises) if one.delay_s is not None]
            if (
                len(late) == 2
                and -LATE_S <= min(late) <= max(late) <= -evidence.at_once_s
                and falls.number + rises.number >= MIN_RESPONSES
            ):
                found.append((name, -min(late)))
    return tuple(found)


def _lead(occupied: str, falls: Responses, rises: Responses, at_once_s: float) -> _Lead | None:
    """Return the response of the level to a signal; None if the level does not follow it.

    Falls are rare if a field is effective on only a small part of the path; the delay is then taken from the rises.
    """
    often, seldom = sorted((falls, rises), key=lambda one: -one.number)
    if often.delay_s is None or often.delay_s <= -at_once_s or falls.number + rises.number < MIN_RESPONSES:
        return None
    if seldom.delay_s is None or seldom.delay_s <= -at_once_s:
        by_rises = often is rises
        return _Lead(occupied, often.delay_s, None, by_rises) if 2 * seldom.number < often.number + 1 else None
    return _Lead(occupied, falls.delay_s or 0.0, rises.delay_s)


def _explaining(
    evidence: SignalEvidence, first_leads: Mapping[str, _Lead]
) -> tuple[SignalEvidence, dict[str, _Lead], dict[str, _Stop], list[str]]:
    """Return the signals that explain more than the robot's place and the signals before them, best first.

    A stop that lasts until a reset is chosen in place of its signal if it explains more by as much as a further signal.
    Fields lie in one another, so that one seems to answer with another's delay: the delays of the signals left are
    those to the changes of level that the chosen ones do not answer, where these suffice.

    Returns:
        Evidence with the stops as signals, leads, stops, and the chosen names.
    """
    evidence, leads, stops = _with_stops(evidence, first_leads)
    chosen: list[str] = []
    on: list[Bools] = []
    rest = _unexplained(evidence, on)
    for at_once in (False, True):
        left = [name for name, lead in leads.items() if (lead.delay_s < evidence.at_once_s) == at_once]
        while left and len(chosen) < MAX_SIGNALS:
            states = {name: _on(evidence, name, leads[name]) for name in left}
            if chosen:
                changed = _with_usual_delay(
                    evidence, on, {name: leads[name] for name in left}, leads[chosen[0]].delay_s
                )
                leads |= changed
                states |= {name: _on(evidence, name, lead) for name, lead in changed.items()}
            able = _shortlist(evidence, on, states, stops)
            rests = {name: _unexplained(evidence, [*on, states[name]]) for name in able}
            simple = {name: rests.get(stop.signal, rest) for name, stop in stops.items() if name in rests}
            some = [one for one in able if one not in stops or _gains(simple[one], rests[one], first=False)]
            best = min(some, key=lambda name: rests[name].sum(), default="")
            if not some or not _gains(rest, rests[best], first=not chosen):
                break
            rest = rests[best]
            on.append(states[best])
            chosen.append(best)
            mine = {stops[name].signal if name in stops else name for name in chosen}
            unanswered = _unanswered(evidence, {name: leads[name] for name in chosen})
            new = {name: lead for name, lead in _leading(unanswered).items() if name not in chosen}
            more, with_stops, new_stops = _with_stops(unanswered, new)
            evidence = replace(more, falls_s=evidence.falls_s, rises_s=evidence.rises_s)
            kept = {name: lead for name, lead in leads.items() if name not in stops or name in chosen}
            leads = {**kept, **with_stops, **{name: leads[name] for name in chosen}}
            stops = {name: stop for name, stop in (stops | new_stops).items() if name in leads}
            here = [name for name, lead in leads.items() if (lead.delay_s < evidence.at_once_s) == at_once]
            left = [one for one in here if (stops[one].signal if one in stops else one) not in mine]
    return evidence, leads, stops, chosen


def _with_usual_delay(
    evidence: SignalEvidence, on: Sequence[Bools], leads: Mapping[str, _Lead], delay_s: float
) -> dict[str, _Lead]:
    """Return the signals without falls whose level falls at the usual delay and rises later, where that explains more.

    A protective field inside a warning field often shows no fall of its own, but a restart delay.
    """
    found: dict[str, _Lead] = {}
    for name, lead in leads.items():
        if lead.by_rises and lead.delay_s > delay_s + SAME_S:
            other = _Lead(lead.occupied, delay_s, lead.delay_s)
            now, then = (_unexplained(evidence, [*on, _on(evidence, name, one)]).sum() for one in (lead, other))
            if then < now:
                found[name] = other
    return found


def _shortlist(
    evidence: SignalEvidence, on: Sequence[Bools], states: Mapping[str, Bools], stops: Mapping[str, _Stop]
) -> list[str]:
    """Return the signals that explain most in every COARSE-th sample, with the signals of the stops among them."""
    if len(states) <= SHORT:
        return list(states)
    rough = {name: float(_unexplained(evidence, [*on, state], COARSE).sum()) for name, state in states.items()}
    best = sorted(rough, key=lambda name: rough[name])[:SHORT]
    plain = {stops[name].signal for name in best if name in stops} & states.keys()
    return [name for name in states if name in best or name in plain]


def _unanswered(evidence: SignalEvidence, leads: Mapping[str, _Lead]) -> SignalEvidence:
    """Return the evidence without the changes of level that answer the chosen signals."""
    falls_s, rises_s = evidence.falls_s, evidence.rises_s
    for name, lead in leads.items():
        changes = evidence.signals[name]
        falls_s = _apart(falls_s, changes.to(lead.occupied) + lead.delay_s)
        rises_s = _apart(rises_s, left_s(changes, lead.occupied) + (lead.rise_s or lead.delay_s))
    return replace(evidence, falls_s=falls_s, rises_s=rises_s)


def _apart(times_s: Vector, from_s: Vector) -> Vector:
    """Return the times that lie apart from all others, ascending."""
    near = np.searchsorted(from_s, times_s + SAME_S, side="right") > np.searchsorted(from_s, times_s - SAME_S)
    return np.asarray(times_s[~near])


def _gains(before: Vector, after: Vector, *, first: bool) -> bool:
    """Return whether a signal explains enough more: `_unexplained` without and with it."""
    gain = before - after
    total = float(gain.sum())
    if total >= MIN_GAIN or first:
        return total >= MIN_GAIN
    if total < max(MIN_LATER_GAIN, OF_REST * float(before.sum())) or len(gain) < 2:
        return False
    return total >= BEYOND_CHANCE * float(np.sqrt(len(gain)) * gain.std(ddof=1))


def _delays(evidence: SignalEvidence, signal: str, occupied: str) -> tuple[Responses, Responses]:
    """Return the delays of falls after a signal turned occupied, and of rises after it turned free (`responses_to`)."""
    changes = evidence.signals[signal]
    return responses_to(changes.to(occupied), evidence.falls_s), _resumes(evidence, left_s(changes, occupied))


def _resumes(evidence: SignalEvidence, free_s: Vector) -> Responses:
    """Return the delay of rises of the level after the times at which a signal turned free."""
    return responses_to(free_s, evidence.rises_s, MAX_RESTART_S)


def _on(evidence: SignalEvidence, name: str, lead: _Lead) -> Bools:
    """Return where a signal shows a person, shape (N,), shifted by the delay of the level."""
    changes = evidence.signals[name]
    on = changes.at(evidence.t_s - lead.delay_s) == lead.occupied
    if lead.hold_s:
        ends = left_s(changes, lead.occupied)
        last_s = np.append(-np.inf, ends)[np.searchsorted(ends, evidence.t_s - lead.delay_s, side="right")]
        on |= evidence.t_s - lead.delay_s - last_s < lead.hold_s
    return np.asarray(on)


def _unexplained(evidence: SignalEvidence, on: Sequence[Bools], every: int = 1) -> Vector:
    """Return the lost time of each execution, held out, that signals and the robot's place do not explain, shape (E,).

    As a share of the lost time of all executions, from every `every`-th sample.
    """
    known = np.flatnonzero(evidence.level >= 0)
    known = known[:: every * (1 + len(known) // MAX_ROWS)]
    levels, level = np.asarray(evidence.levels), evidence.level[known]
    execution = np.unique(evidence.execution[known], return_inverse=True)[1].ravel()
    states: list[Vector | Bools] = [state[known] for state in on]
    features = np.column_stack([signal_position_features(evidence.place[known], states), *states]).astype(np.float64)
    lost, wrong = levels[-1] - levels[level], np.zeros(len(known))
    for part in range(min(FOLDS, int(execution.max(initial=-1)) + 1)):
        learn = execution % FOLDS != part
        if not learn.any():
            return np.ones(1)
        together = np.zeros(int(learn.sum()), np.int64)  # one group: cuts are judged on the held-out fold
        tree = usual_levels(features[learn], level[learn], len(levels), together)
        said = tree.lowest(features[~learn], 0.5)
        wrong[~learn] = np.abs(levels[said] - levels[level[~learn]])
    return np.bincount(execution, wrong) / lost.sum() if lost.any() else np.ones(1)
