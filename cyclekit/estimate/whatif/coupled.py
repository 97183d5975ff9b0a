"""Wait conditions after a change: faster people, an additional place, a larger buffer, a removed wait."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from cyclekit.errors import EstimateError, UnknownName
from cyclekit.learning.coupling.words import AT

if TYPE_CHECKING:
    from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, SourceCard
    from cyclekit.estimate.whatif.change import Change


def altered_coupling(change: Change, card: CouplingCard | None) -> CouplingCard | None:
    """Return the wait conditions after a change; None if there were none before.

    Raises:
        UnknownName: It names a place, signal or wait without a wait condition.
        EstimateError: It changes waits where there are none, or is not supported where there are some.
    """
    where = f"change {change.name!r}"
    if card is None or not card.coupled:
        if change.waits_change:
            seen = f"{where}: these logs show no waits of robot or operator for each other"
            raise EstimateError(seen, cure="Train on a dataset with tracks of both: cyclekit train DATASET --out MODEL")
        return None
    if change.frequency is not None or change.base_m is not None:
        seen = f"{where}: frequency and base are not supported in cells where robot and operator wait for each other"
        raise EstimateError(seen, cure="Change faster, places or the safety function.")
    if change.no_wait:
        seen = f"{where}: no_wait is for models of task lists, and this model knows positions"
        raise EstimateError(seen, cure=f"Name the wait in without_waits. Known: {', '.join(_names(card))}.")
    if unknown := sorted(set(change.faster) - {"robot", "operator"}):
        raise UnknownName(where, "agent in faster", unknown[0], ["operator"])
    if "robot" in change.faster:
        seen = f"{where}: a faster robot is for models of task lists, and this model knows positions"
        raise EstimateError(seen, cure="Change the levels of the safety function, or log a faster program.")
    if change.faster and all(gate.agent == "robot" for gate in card.gates):
        seen = f"{where}: no log shows the operator, so what a faster one changes is unknown"
        raise EstimateError(seen, cure="Ingest the tracker's log too, or change without_waits or buffer.")
    known = {name for gate in card.gates if gate.conditions for name in (shown(gate), _stored(gate))}
    if missing := [name for name in change.without_waits if name not in known]:
        raise UnknownName(where, "wait", missing[0], _names(card))
    places = {_freed(gate, one) for gate in card.gates for one in gate.conditions if one.back > 0}
    if missing := [name for name in change.more_places if name not in places]:
        raise UnknownName(where, "place at which an agent waits until it is free", missing[0], places)
    sources = [one for one in card.sources if not one.after]
    if missing := [name for name in change.buffer if not any(name in (one.signal, one.taken_by) for one in sources)]:
        raise UnknownName(where, "source of parts", missing[0], [one.signal for one in sources])
    sources = [replace(one, buffer=_room(change, one)) for one in card.sources]
    return replace(card, gates=tuple(_gate(change, gate) for gate in card.gates), sources=tuple(sources))


def shown(gate: GateCard) -> str:
    """Return the name of a wait in a change, that in `inspect`: `robot before fixture`, `robot at conveyor`."""
    return f"{gate.agent} {AT[gate.at]} {gate.place}"


def _stored(gate: GateCard) -> str:
    """Return the name of a wait in the terms of the card, which changes may use too: `robot approach fixture`."""
    return f"{gate.agent} {gate.at} {gate.place}"


def _names(card: CouplingCard) -> list[str]:
    return [shown(gate) for gate in card.gates if gate.conditions]


def _room(change: Change, source: SourceCard) -> int:
    """Return the number of parts that may wait after a change, which names their signal or where they are taken."""
    by_place = source.buffer if source.after else change.buffer.get(source.taken_by, source.buffer)
    return change.buffer.get(source.signal, by_place)


def _gate(change: Change, gate: GateCard) -> GateCard:
    removed = not {shown(gate), _stored(gate)}.isdisjoint(change.without_waits)
    conditions = () if removed else gate.conditions
    mine = tuple(_condition(change, gate, one) for one in conditions)
    return replace(gate.at_pace(1.0 / change.operator_pace), conditions=mine)


def _condition(change: Change, gate: GateCard, one: ConditionCard) -> ConditionCard:
    """Return a condition; one that a place is free again looks back one more turn for each further place."""
    return replace(one, back=one.back + change.more_places.get(_freed(gate, one), 0)) if one.back else one


def _freed(gate: GateCard, one: ConditionCard) -> str:
    """Return which place is free again by a condition: a signal tells so of the place that the agent goes to."""
    return gate.place if one.agent == "signal" else one.place
