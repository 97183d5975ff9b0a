"""Wait conditions after a change: faster people, an additional place, a larger buffer, a removed wait."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from cyclekit.errors import EstimateError, UnknownName

if TYPE_CHECKING:
    from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
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
    if change.no_wait or set(change.faster) - {"operator"}:
        seen = f"{where}: no_wait and a faster robot are for models of task lists, but this cell has positions"
        raise EstimateError(seen, cure="Name a wait in without_waits; change the levels for a faster robot.")
    if change.faster and all(gate.agent == "robot" for gate in card.gates):
        seen = f"{where}: no log shows the operator, so what a faster one changes is unknown"
        raise EstimateError(seen, cure="Ingest the tracker's log too, or change without_waits or buffer.")
    known = {shown(gate): gate for gate in card.gates if gate.conditions}
    if missing := [name for name in change.without_waits if name not in known]:
        raise UnknownName(where, "wait", missing[0], known)
    places = {_freed(gate, one) for gate in card.gates for one in gate.conditions if one.back > 0}
    if missing := [name for name in change.more_places if name not in places]:
        raise UnknownName(where, "place at which an agent waits until it is free", missing[0], places)
    parts = {source.signal for source in card.sources if not source.after}
    if missing := [name for name in change.buffer if name not in parts]:
        raise UnknownName(where, "source of parts", missing[0], parts)
    sources = (replace(one, buffer=change.buffer.get(one.signal, one.buffer)) for one in card.sources)
    return replace(card, gates=tuple(_gate(change, gate) for gate in card.gates), sources=tuple(sources))


def shown(gate: GateCard) -> str:
    """Return the name of a wait in a change: `robot approach fixture`."""
    return f"{gate.agent} {gate.at} {gate.place}"


def _gate(change: Change, gate: GateCard) -> GateCard:
    conditions = () if shown(gate) in change.without_waits else gate.conditions
    mine = tuple(_condition(change, gate, one) for one in conditions)
    return replace(gate.at_pace(1.0 / change.operator_pace), conditions=mine)


def _condition(change: Change, gate: GateCard, one: ConditionCard) -> ConditionCard:
    """Return a condition; one that a place is free again looks back one more turn for each further place."""
    return replace(one, back=one.back + change.more_places.get(_freed(gate, one), 0)) if one.back else one


def _freed(gate: GateCard, one: ConditionCard) -> str:
    """Return which place is free again by a condition: a signal tells so of the place that the agent goes to."""
    return gate.place if one.agent == "signal" else one.place
