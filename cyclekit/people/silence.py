"""What silence of a tracker means: no person in view, or the tracker is not running.

Some trackers write a row with empty cells while nobody is there, others write nothing. Of the latter a log begins when
somebody comes and ends when he has left; before and after, nobody is there. That a tracker is one of these shows in the
middle of its logs: it falls silent, and goes on later. Which way people then come and go shows there too.
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
"""A pause of the rows up to this long is one behind something, or a lost connection."""
ENOUGH = 3
"""From this many silences within the logs on, the tracker is taken to write nothing while no person is in view."""
EXIT_M = 1.0
"""A log that ends this close to where others fell silent ends because the person left."""


@dataclass(frozen=True)
class Silence:
    """How one log of people begins, ends and pauses.

    Attributes:
        first_s: Time of its first row, session seconds; NaN without rows.
        last_s: Time of its last row.
        first_m: Where somebody was then, shape (2,), metres, base frame; NaN = nobody.
        last_m: Where somebody was at the last row.
        beside_m: Where somebody was before and after each silence in its middle, shape (M, 2).
        empty_rows: It also has rows without anybody: then silence says nothing.
        told: What the cell file says.
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
        """Look at the rows of a log: times (N,), ascending, session seconds, and positions (N, 3), base frame."""
        if not len(t_s):
            nowhere = np.full(2, np.nan)
            return cls(np.nan, np.nan, nowhere, nowhere, np.empty((0, 2)), empty_rows=False, told=told)
        pauses = np.flatnonzero(np.diff(t_s) > SILENT_S)
        beside = xyz_m[np.concatenate([pauses, pauses + 1]), :2]
        empty = bool(np.isnan(xyz_m[:, 0]).any())
        return cls(float(t_s[0]), float(t_s[-1]), xyz_m[0, :2], xyz_m[-1, :2], beside, empty, told)


@dataclass(frozen=True)
class Absence:
    """Silences at the ends of a session's logs without a person: up to `until_s`, and from `from_s` on."""

    until_s: float = -np.inf
    from_s: float = np.inf


def absences(sessions: Sequence[Sequence[Silence]]) -> list[Absence]:
    """Return for each session when its logs' silence proves that no operator was present.

    Args:
        sessions: Of each session its logs of people.
    """
    every = [log for logs in sessions for log in logs]
    beside = np.concatenate([np.empty((0, 2)), *(log.beside_m for log in every)])
    writes_nothing = len(beside) >= 2 * ENOUGH and not any(log.empty_rows for log in every)
    told = any(log.told == "absent" for log in every)
    return [_of_session(logs, beside, writes_nothing=writes_nothing or (told and is_empty(logs))) for logs in sessions]


def is_empty(logs: Sequence[Silence]) -> bool:
    """Tell whether no log has a row."""
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
