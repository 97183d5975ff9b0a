"""The robot's runs: which rows of which recordings, when their program did not play, and what marks a new cycle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit import schema
from cyclekit.errors import ConfigError
from cyclekit.motion import COLUMNS
from cyclekit.stored_run import runs_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.config import Cell
    from cyclekit.motion import Run
    from cyclekit.session import Session
    from cyclekit.tables import StoredTable

    Rows = NDArray[np.int64]
    Stored = Callable[[str, Sequence[str]], StoredTable]


def load_runs(
    sessions: Sequence[Session], stored: Stored, cell: Cell, progress: Callable[[float, str], None]
) -> tuple[list[Run], list[Rows]]:
    """Return every run of every session, and of each the rows at which something logged says that a cycle begins.

    Args:
        sessions: In one clock; told which runs are theirs.
        stored: Opens the robot table of a recording (id, columns).
        cell: What begins an execution.
        progress: Told fraction and text.

    Raises:
        ConfigError: Executions are to begin by a register or output that was not logged.
    """
    runs: list[Run] = []
    marks: list[Rows] = []
    gap_s = cell.executions.gap_s if cell.executions.begin != "file" else np.inf
    for number, session in enumerate(sessions):
        progress(number / len(sessions), f"motion of {session.name}")
        entry = session.entries[0]
        if not entry["rows"].get("robot"):
            continue
        table = stored(entry["id"], COLUMNS)
        marked = _marked(stored, entry, cell)
        more, states = _more(stored, entry["id"], table.names), _not_playing(stored, entry["id"])
        for run in runs_of(table, entry["clock"]["offset_s"], gap_s=gap_s, more=more, states=states):
            session.runs.append(len(runs))
            runs.append(run)
            inside = marked[(marked > run.first) & (marked < run.end)]
            marks.append(inside - run.first - 1)
    return runs, marks


def _more(stored: Stored, recording: str, names: Sequence[str]) -> StoredTable | None:
    """Open the joint angles and the slider of a recording, as far as they are known all along."""
    names = [name for name in names if schema.is_joint(name) and not name.startswith("qd")]
    table = stored(recording, [*names, "slider"])
    joints = [name for name in names if table.unknown(name) == 0]
    slider = ["slider"] if table.unknown("slider") < table.rows else []
    known = [*(joints if len(joints) == len(names) else []), *slider]
    return stored(recording, known) if known else None


def _not_playing(stored: Stored, recording: str) -> list[tuple[int, int, str]]:
    """Return where the program does not play: first and last row of the table, and its state."""
    table = stored(recording, ("state",))
    if table.unknown("state") == table.rows:
        return []
    return [(first, last, state) for first, last, state in table.states("state") if state != "playing"]


def _marked(stored: Stored, entry: Mapping[str, Any], cell: Cell) -> Rows:
    """Return the rows at which the register or the output that marks executions has changed."""
    how = cell.executions
    column = {"register": "register", "digital-output": "digital_out_bits"}.get(how.begin)
    if column is None:
        return np.empty(0, np.int64)
    table = stored(entry["id"], (column,))
    if table.unknown(column) == table.rows:
        seen = f"{entry['sources'][0]['path']}: executions are to begin by {how.begin}, and that was not logged"
        raise ConfigError(seen, cure='Log it, or set begin = "auto" in [executions] of the cell file.')
    found, before = [np.empty(0, np.int64)], None
    for number, (begin, _) in enumerate(table.groups):
        values, is_known = table.whole_numbers(number, column)
        known = np.flatnonzero(is_known)
        if not len(known):
            continue
        values = (values[known] >> how.bit) & 1 if how.begin == "digital-output" else values[known]
        steps = np.diff(values, prepend=values[0] if before is None else before)
        found.append(begin + known[(steps > 0) if how.begin == "digital-output" else (steps != 0)])
        before = int(values[-1])
    return np.concatenate(found)
