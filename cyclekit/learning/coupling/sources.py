"""How signals come that the robot waits for: parts by their gaps and how many may wait, others by what they answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.coupling import GateCard, SourceCard
from cyclekit.learning.coupling.conditions.answers import find_answers
from cyclekit.learning.coupling.conditions.lags import deciding_causes, quantiles, reverse_kaplan_meier
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
from cyclekit.learning.coupling.subset import evenly

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Vector

MAX_GAPS = 1200
"""Maximum number of gaps to learn from."""
FULL = 0.98
"""Share of the parts at whose arrival no more parts than the buffer size are waiting."""


def find_sources(courses: Sequence[ExecutionVisits], gates: Sequence[GateCard]) -> tuple[SourceCard, ...]:
    """Return the sources of the signals that the robot waits for.

    Where operators were logged these are parts that come to its places. Where none was, somebody or something unseen
    gives every signal: after what the robot has done (`answers`), or as parts come.
    """
    unseen = not any(course.visits["operator"] for course in courses)
    waits = {
        (Event(one.agent, one.place, one.event), gate.place): gate.at
        for gate in gates
        for one in gate.conditions
        if gate.agent == "robot" and one.agent == "signal" and one.event in ("set", "cleared")
    }
    found: dict[Event, SourceCard] = {}
    for (event, place), at in sorted(waits.items()):
        source = find_answers(courses, event, place) if unseen else None
        if source is None and (unseen or (at, event.event) == ("leave", "set")):
            source = _source(courses, event, place)
        if source is not None and (event not in found or source.after):
            found[event] = source
    return tuple(found.values())


def _source(courses: Sequence[ExecutionVisits], event: Event, place: str) -> SourceCard | None:
    came = [course.events.get(event, np.empty(0)) for course in courses]
    taken = [course.events.get(Event("robot", place, "leaves"), np.empty(0)) for course in courses]
    begins = [course.visits["robot"][0].left_s for course in courses]
    first = np.array([at[0] - begin for at, begin in zip(came, begins, strict=True) if len(at)])
    waiting = np.concatenate([_waiting(*each) for each in zip(came, taken, strict=True)])
    if not len(first) or sum(len(at) > 1 for at in came) == 0:
        return None
    buffer = max(1, int(np.quantile(waiting, FULL, method="higher")))
    since = np.concatenate([_since(*each, buffer) for each in zip(came, taken, strict=True)], axis=1)
    since = since[:, evenly(since.shape[1], MAX_GAPS)]
    decided = deciding_causes(since).share.argmax(axis=0) == 0
    gaps = reverse_kaplan_meier(since[0], decided * 1.0, np.ones(len(decided), np.bool_))
    return SourceCard(
        signal=event.place,
        event="cleared" if event.event == "cleared" else "set",
        gap_s=quantiles(since[0], gaps),
        first_s=quantiles(first, np.full(len(first), 1.0 / len(first))),
        buffer=buffer,
        taken_by=place,
    )


def _waiting(came: Vector, taken: Vector) -> Vector:
    """Return the number of waiting parts when each part arrives, including itself, shape (N,)."""
    gone = np.searchsorted(np.sort(taken[np.isfinite(taken)]), came, side="right")
    return np.asarray(np.arange(1.0, len(came) + 1.0) - gone)


def _since(came: Vector, taken: Vector, buffer: int) -> Vector:
    """Return for each part after the first the time since the previous part, and since room, shape (2, N), s."""
    room = np.full(max(len(came) - 1, 0), np.nan)
    for part in range(max(buffer, 1), len(came)):
        if part - buffer < len(taken):
            room[part - 1] = came[part] - taken[part - buffer]
    return np.array([np.diff(came), room])
