"""The robot's runs: their rows, the times when the program did not play, and the marks of new cycles."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit import schema
from cyclekit.dataset.signals import OUTPUT, REGISTER, event_times, every_change
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.segmentation.motion import COLUMNS
from cyclekit.segmentation.stored_run import StoredRun, runs_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import Cell
    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.schema import Ints, Vector
    from cyclekit.storage.parquet import StoredTable


WHERE = "[executions] signal"
LATE_S = 0.25
"""Maximum delay of a signal after the departure that it marks, s."""


def load_runs(session: Session, read: Read, stored: Stored, cell: Cell) -> tuple[list[StoredRun], list[Ints]]:
    """Return every run of a session, and for each the rows at which a logged signal starts a cycle.

    Args:
        session: Session with its recordings in one clock.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns).
        cell: Rule for the start of an execution.

    Raises:
        ConfigError: Executions begin by a register or output that was not logged.
    """
    entry = session.recordings[0]
    if not entry.rows.get("robot"):
        return [], []
    table = stored(entry.id, COLUMNS)
    marked = _marked(session, read, stored, cell)
    more, states = _more(stored, entry.id, table.names), _not_playing(stored, entry.id)
    gap_s = cell.executions.gap_s if cell.executions.begin != "file" else np.inf
    runs = runs_of(table, entry.clock.offset_s, gap_s=gap_s, more=more, states=states)
    ends = [(run.time_at(0), run.time_at(run.rows - 1)) for run in runs]
    within = [slice(*np.searchsorted(marked, span, side="right").tolist()) for span in ends]
    marks = [marked[mine] - LATE_S for mine in within]
    changes = _changes(session, read, stored)
    runs = [replace(run, changes=_during(changes, *span)) for run, span in zip(runs, ends, strict=True)]
    return runs, [run.row_at(mine) for run, mine in zip(runs, marks, strict=True)]


def _during(changes: Mapping[str, Vector], first_s: float, last_s: float) -> dict[str, Vector]:
    """Return the changes of each signal from `first_s` to `last_s`, inclusive."""
    return {
        name: t_s[np.searchsorted(t_s, first_s) : np.searchsorted(t_s, last_s, side="right")]
        for name, t_s in changes.items()
    }


def _changes(session: Session, read: Read, stored: Stored) -> dict[str, Vector]:
    """Return the times at which each signal of the session's recordings changes, session time."""
    found: dict[str, Vector] = {}
    for entry in session.recordings:
        clock = entry.clock
        for name, times in every_change(entry, read, stored).items():
            both = np.concatenate([found.get(name, times[:0]), times * clock.rate + clock.offset_s])
            found[name] = np.sort(both)
    return found


def _more(stored: Stored, recording: str, names: Sequence[str]) -> StoredTable | None:
    """Open the joint angles and the slider of a recording; joint angles only if all are known in every row."""
    names = [name for name in names if schema.is_joint(name) and not name.startswith("qd")]
    table = stored(recording, [*names, "slider"])
    joints = [name for name in names if table.unknown(name) == 0]
    slider = ["slider"] if table.unknown("slider") < table.rows else []
    known = [*(joints if len(joints) == len(names) else []), *slider]
    return stored(recording, known) if known else None


def _not_playing(stored: Stored, recording: str) -> list[tuple[int, int, str]]:
    """Return the rows in which the program does not play: first and last row of the table, and the state."""
    table = stored(recording, ("state",))
    if table.unknown("state") == table.rows:
        return []
    return [(first, last, state) for first, last, state in table.states("state") if state != "playing"]


def _marked(session: Session, read: Read, stored: Stored, cell: Cell) -> Vector:
    """Return the times at which a logged signal starts an execution, session time."""
    how, entry = cell.executions, session.recordings[0]
    signal = {"register": REGISTER, "digital-output": f"{OUTPUT}{how.bit}"}.get(how.begin, how.signal)
    if signal is None:
        return np.empty(0)
    name = signal.partition("=")[0]
    if name == REGISTER or name.startswith(OUTPUT):
        column = REGISTER if name == REGISTER else "digital_out_bits"
        table = stored(entry.id, (column,))
        if table.unknown(column) == table.rows:
            said = signal if how.begin == "signal" else how.begin
            seen = f"{entry.shown}: executions begin by {said}, but the log does not hold it"
            raise ConfigError(seen, cure='Log it, or set begin = "auto" in [executions] of the cell file.')
    else:
        entry = _holding(name, session, read)
    clock = entry.clock
    times = event_times(entry, signal, read, stored, WHERE)
    return np.asarray(times * clock.rate + clock.offset_s)


def _holding(name: str, session: Session, read: Read) -> RecordingCard:
    """Return the recording of a session whose events include a signal."""
    known: list[str] = []
    for entry in session.recordings:
        events = read(entry.id, "events") if "events" in entry.tables else None
        names = [] if events is None else events["signal"].unique(maintain_order=True).to_list()
        if name in names:
            return entry
        known += names
    raise UnknownName(f"{session.name}, {WHERE}", "signal", name, [*known, f"{OUTPUT}0", REGISTER])
