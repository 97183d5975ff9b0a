"""Notes of a dataset: what the passes over the sessions found that a user must know."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards import note
from cyclekit.people.silence import is_empty

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import Note, OperatorSignalCard
    from cyclekit.dataset.cards.notes import Value
    from cyclekit.derive.causes.causes import Evidence
    from cyclekit.derive.last_pass import LastPassResult
    from cyclekit.derive.second_pass import SecondPassResult
    from cyclekit.derive.signals.operator_signals import FoundSignals
    from cyclekit.people.silence import Absence


def empty_tracker_notes(sampled: Sequence[SecondPassResult], operator_absence: Sequence[Absence]) -> list[Note]:
    """Return a note: in how many sessions an empty tracker log means no operator, and in how many unknown."""
    empty = [
        absence
        for one, absence in zip(sampled, operator_absence, strict=True)
        if one.silences and is_empty(one.silences)
    ]
    absent = sum(absence.until_s == np.inf for absence in empty)
    return [note("tracker-empty", absent=absent, unknown=len(empty) - absent)] if empty else []


def input_notes(evidence: Evidence) -> list[Note]:
    """Return a note for each input that slows the robot."""
    return [
        note("input-slows", signal=name, state="on" if how.on else "off", percent=round(100 * how.cap))
        for name, how in evidence.inputs.items()
    ]


def signal_notes(found: FoundSignals) -> list[Note]:
    """Return notes: signals that were found to show people, or signals that follow the speed."""
    if found.follow:
        names, late_s = zip(*found.follow, strict=True)
        return [note("signals-follow", signals=", ".join(names), late_s=max(late_s))]
    return [_signal_note(one) for one in found.cards if not one.told]


def _signal_note(one: OperatorSignalCard) -> Note:
    how: dict[str, Value] = {"delay_s": one.delay_s, "explained": one.explained}
    if one.reset is None:
        return note("operator-signal", signal=one.signal, occupied=one.occupied, **how)
    stop: dict[str, Value] = {"reset": one.reset, "reset_at": one.reset_at}
    return note("operator-stop", signal=one.signal, occupied=one.occupied, **how, **stop)


def unseen_notes(finished: Sequence[LastPassResult]) -> list[Note]:
    """Return a note: how often a signal shows a person whom the tracker misses."""
    samples, sessions = sum(one.unseen for one in finished), sum(one.unseen > 0 for one in finished)
    return [note("operator-unseen", samples=samples, sessions=sessions)] if samples else []
