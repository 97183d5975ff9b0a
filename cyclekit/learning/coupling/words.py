"""Wait conditions in words, the same in every command and on the page, and what each of them costs in the logs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset.cards.notes import note
from cyclekit.learning.coupling.waits import condition_text
from cyclekit.text.numbers import fixed, percent, span

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, InTurnCard, SourceCard, TripCard
    from cyclekit.dataset.cards.notes import Note

AT = {"leave": "at", "approach": "before"}
"""Where an agent waits, by the kind of gate: `robot before fixture`."""


MOSTLY = 0.9
"""A wait of the cell file is contradicted if a smaller share of the logged passages obeys it."""


@dataclass(frozen=True)
class WaitRow:
    """One wait condition in words.

    Attributes:
        gate, condition: What it says in words.
        who: Who waits where: `robot before fixture`.
        until: Until what: `operator leaves fixture (release set)`, and in which passages.
        lag_s: 5 %, 50 % and 95 % quantile of the time from the event until the agent goes on, s.
        had_to_wait: In how many of the logged passages this event came last, also at all places of the kind together.
    """

    gate: GateCard
    condition: ConditionCard
    who: str
    until: str
    lag_s: tuple[float, float, float]
    had_to_wait: str

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        obeyed = {"obeyed": self.condition.held, "had_to_wait": self.condition.decided, "passages": self.gate.passages}
        return {"who": self.who, "until": self.until, "lag_s": list(self.lag_s), **obeyed}


def wait_rows(found: CouplingCard | None, shown: Callable[[str], str] = str) -> list[WaitRow]:
    """Return the wait conditions of a cell in words; `shown` gives the display name of a place."""
    rows = []
    for gate in found.gates if found else ():
        for one in gate.conditions:
            who = f"{gate.agent} {AT[gate.at]} {shown(gate.place)}" + (" (told)" if gate.told else "")
            who += f", at {shown(gate.wait_at)}" if gate.wait_at else ""
            low_s, middle_s, high_s = (_quantile(one.lag_s, level) for level in (0.05, 0.5, 0.95))
            had_to_wait = f"{one.decided} of {gate.passages}" + (f" ({one.alike} at all alike)" if one.alike else "")
            until = condition_text(one, shown) + _passages(one)
            rows.append(WaitRow(gate, one, who, until, (low_s, middle_s, high_s), had_to_wait))
    return rows


def contradicted(found: CouplingCard | None) -> list[Note]:
    """Return a note for each wait of the cell file that the logged passages contradict."""
    rows = [row for row in wait_rows(found) if row.gate.told and row.condition.held < MOSTLY and row.gate.passages]
    return [
        note(
            "wait-contradicted",
            agent=row.gate.agent,
            where=f"{AT[row.gate.at]} {row.gate.place}",
            until=row.until,
            obeyed=round(row.condition.held * row.gate.passages),
            passages=row.gate.passages,
        )
        for row in rows
    ]


def _passages(one: ConditionCard) -> str:
    """Return in which passages a condition is needed, as the end of a phrase."""
    text = f", {one.back} visit{'s' * (one.back > 1)} earlier" if one.back else ""
    text += f", every {_nth(one.turns.every)} time" if one.turns.every > 1 else ""
    text += f", needed in {percent(one.needed)}" if one.needed < 1.0 else ""
    return text + (", where the other waits too" if one.together else "")


def _nth(number: int) -> str:
    return {2: "2nd", 3: "3rd"}.get(number, f"{number}th")


def habit_lines(found: CouplingCard | None) -> list[str]:
    """Return when parts and signals come that neither agent sets, and what the operator does in waits and before them.

    One sentence each.
    """
    if found is None:
        return []
    in_turn = found.in_turn.signals if found.in_turn else ()
    lines = [line for source in found.sources for line in _source_lines(source, in_turn=source.signal in in_turn)]
    lines += [_in_turn_line(found.in_turn)] if found.in_turn else []
    lines += [f"operator: goes to {place} in the middle of his work, and comes back to it" for place in found.errands]
    lines += [_trip_line(gate, gate.trip) for gate in found.gates if gate.trip is not None]
    lines += [_own_work_line(gate) for gate in found.gates if gate.own_by]
    return [*lines, *([found.pace.said] if found.pace is not None else [])]


def _trip_line(gate: GateCard, trip: TripCard) -> str:
    took_s = sorted(trip.took_s)
    return (
        f"operator {AT[gate.at]} {gate.place}: trips to {' or '.join(trip.places)} in "
        f"{percent(trip.waiting)} of his waits "
        f"and {percent(trip.free)} of the other passages, "
        f"{span(_quantile(took_s, 0.05), _quantile(took_s, 0.95), 1)} s"
    )


def _own_work_line(gate: GateCard) -> str:
    sides = {"next": "before he goes to", "before": "after he comes from"}
    begun = "if a cycle begins in the middle of it"
    where = [f"{sides[one.side]} {one.place}" if one.place else begun for one in gate.own_by]
    each = [f"{fixed(_quantile(one.own_s, 0.5), 1)} s {what}" for one, what in zip(gate.own_by, where, strict=True)]
    return f"operator at {gate.place}: median own work {', '.join(each)}"


def _in_turn_line(card: InTurnCard) -> str:
    gap, first = (
        f"{span(_quantile(values, 0.05), _quantile(values, 0.95), 1)} s" for values in (card.gap_s, card.first_s)
    )
    return (
        f"one operator gives {', '.join(card.signals)} in turn: each at the earliest {gap} after the one before, the "
        f"first {first} after the start"
    )


def _source_lines(source: SourceCard, *, in_turn: bool) -> list[str]:
    gap = f"{span(_quantile(source.gap_s, 0.05), _quantile(source.gap_s, 0.95), 1)} s"
    if not source.after:
        between = ", also between executions" if source.comes_on else ""
        signal = "" if source.inferred else f" of {source.signal}"
        return [f"parts{signal} come {gap} apart{between}; at most {source.buffer} wait at {source.taken_by}"]
    lines = []
    for one in source.after:
        lag = f"{span(max(_quantile(one.lag_s, 0.05), 0.0), _quantile(one.lag_s, 0.95), 1)} s"
        visit = " in its visit before" if one.back else ""
        by_itself = not in_turn and _quantile(source.gap_s, 0.95) > 0.0
        own = f", or {gap} after the one before, whichever is later" if by_itself else ""
        lines.append(f"{source.signal} {source.event} comes {lag} after robot {one.event} {one.place}{visit}{own}")
    return lines


def waited_s(tasks: pl.DataFrame, rows: Sequence[WaitRow]) -> list[float]:
    """Return the time that logged tasks waited for each condition, s, in all of them together.

    Args:
        tasks: Table TASKS of both agents, with what ended each wait.
        rows: The conditions by which the waits were named.
    """
    order = ("execution", "agent", "index")
    goal = pl.col("task").str.split("->").list.last()
    open_ = tasks.sort(order).with_columns(
        goal=goal, next_goal=goal.shift(-1).over("execution", "agent"), s=pl.coalesce("lost_wait_s", "wait_s")
    )
    found = []
    for row in rows:
        gate = row.gate
        there = pl.col("goal") == gate.place
        there = there if gate.at == "leave" else there | (pl.col("next_goal") == gate.place)
        mine = (pl.col("agent") == gate.agent) & (pl.col("waited_for") == condition_text(row.condition)) & there
        mine = mine.fill_null(value=False)
        found.append(float(open_.filter(mine)["s"].sum()))
        open_ = open_.filter(~mine)
    return found


def _quantile(values: Sequence[float], level: float) -> float:
    at = level * (len(values) - 1)
    low = int(at)
    return values[low] + (at - low) * (values[min(low + 1, len(values) - 1)] - values[low])
