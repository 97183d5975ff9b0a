"""Meaning of a tracker's silence: no person in view, or the tracker is not running.

Some trackers write a row with empty cells while nobody is in view, others write nothing. A log of the latter starts
when a person arrives and ends when he has left; before and after, nobody is present. Such a tracker is recognised by
silences within its logs. Their positions also show where people enter and leave.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Points, Vector


Meaning = Literal["absent", "unknown"]
SILENT_S = 5.0
"""Maximum duration, s, of a pause of the rows that counts as occlusion or lost connection."""
ENOUGH = 3
"""Minimum number of silences within the logs from which the tracker is assumed to write nothing without a person."""
EXIT_M = 1.0
"""Maximum distance, m, of a log's end from other silences at which the person is assumed to have left."""


@dataclass(frozen=True)
class Silence:
    """How one log of people starts, ends and pauses.

    Attributes:
        first_s: Time of the first row, session seconds; NaN without rows.
        last_s: Time of the last row.
        first_m: Position of a person at the first row, shape (2,), m, base frame; NaN = nobody.
        last_m: Position of a person at the last row.
        beside_m: Positions before and after each silence within the log, shape (M, 2), m.
        empty_rows: Whether it has rows without a person; silence then has no meaning.
        told: Meaning given in the cell file.
    """

    first_s: float
    last_s: float
    first_m: Vector
    last_m: Vector
    beside_m: Points
    empty_rows: bool
    told: Meaning | None = None

    @classmethod
    def of(cls, t_s: Vector, xyz_m: Points, told: Meaning | None) -> Silence:
        """Return it for a log: times (N,), ascending, session seconds, and positions (N, 3), base frame, m."""
        if not len(t_s):
            nowhere = np.full(2, np.nan)
            return cls(np.nan, np.nan, nowhere, nowhere, np.empty((0, 2)), empty_rows=False, told=told)
        pauses = np.flatnonzero(np.diff(t_s) > SILENT_S)
        beside = xyz_m[np.concatenate([pauses, pauses + 1]), :2]
        empty = bool(np.isnan(xyz_m[:, 0]).any())
        return cls(float(t_s[0]), float(t_s[-1]), xyz_m[0, :2], xyz_m[-1, :2], beside, empty, told)


@dataclass(frozen=True)
class Absence:
    """Times without a person at the ends of a session's logs: up to `until_s`, and from `from_s` on."""

    until_s: float = -np.inf
    from_s: float = np.inf


def absences(sessions: Sequence[Sequence[Silence]]) -> list[Absence]:
    """Return for each session when the silence of its logs proves that no operator was present.

    Args:
        sessions: Logs of people of each session.
    """
    every = [log for logs in sessions for log in logs]
    beside = np.concatenate([np.empty((0, 2)), *(log.beside_m for log in every)])
    writes_nothing = len(beside) >= 2 * ENOUGH and not any(log.empty_rows for log in every)
    told = any(log.told == "absent" for log in every)
    return [_of_session(logs, beside, writes_nothing=writes_nothing or (told and is_empty(logs))) for logs in sessions]


def is_empty(logs: Sequence[Silence]) -> bool:
    """Return whether no log has a row."""
    return all(np.isnan(log.first_s) for log in logs)


def _of_session(logs: Sequence[Silence], beside_m: Points, *, writes_nothing: bool) -> Absence:
    if not logs:
        return Absence()
    until = [_end(log, log.first_s, log.first_m, beside_m, believed=writes_nothing) for log in logs]
    since = [_end(log, log.last_s, log.last_m, beside_m, believed=writes_nothing) for log in logs]
    if is_empty(logs):
        return Absence(until_s=np.inf) if all(end is not None for end in until) else Absence()
    return Absence(
        -np.inf if None in until else float(np.nanmin([end for end in until if end is not None])),
        np.inf if None in since else float(np.nanmax([end for end in since if end is not None])),
    )


def _end(log: Silence, t_s: float, at_m: Vector, beside_m: Points, *, believed: bool) -> float | None:
    """Return the time beyond which this log's silence means that no operator is present; None if it means nothing."""
    if log.told is not None:
        return t_s if log.told == "absent" else None
    if not believed:
        return None
    near = np.isnan(t_s) or bool((np.linalg.norm(beside_m - at_m, axis=1) <= EXIT_M).any())
    return t_s if near else None
