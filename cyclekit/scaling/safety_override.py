"""Use the speed override of the safety system's separate log as the robot's scaling.

The override is compared with the scaling inferred from the motion. This shows whether it applies to this robot, and
gives the clock offset. If both agree, the logged one is used: it is also known at standstills, and its ramps are sharp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards import note
from cyclekit.segmentation.motion import NOT_LOGGED, InferredScaling

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.dataset.cards import Note
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read
    from cyclekit.schema import Vector
    from cyclekit.segmentation.stored_run import Run

SILENT_S, SILENT_STEPS = 1.0, 20.0
"""Maximum time for which a value is held until the next row: the larger of these, in s and in median log periods."""
SURE = 0.02
"""Maximum standard deviation of inferred scalings that are compared."""
COMPARED, ROUGHLY = 20_000, 1500
"""Maximum number of compared samples per session: for the fine search, and for the coarse one."""
MIN_ROWS = 200
"""Minimum number of compared samples."""
NEAR_S, FAR_S = (-0.5, 1.5), (-60.0, 60.0)
"""Range of the robot's delay after the log, s: with known clock offset, and with unknown one."""
COARSE_S, FINE_S = 0.1, 0.01
MAX_MEDIAN_DIFFERENCE, MAX_QUANTILE_DIFFERENCE = 0.02, 0.1
"""Maximum median difference, and maximum 90 % quantile of differences, for both to agree."""
CAPPED = 0.2
"""Maximum of a difference in the misfit; also the minimum range of the scaling."""
APART_S, BETTER = 2.0, 1.5
"""Offsets farther than APART_S from the best one must have at least BETTER times its misfit; else it is ambiguous."""
_TIE = 0.002
AT_ONCE = 1 << 17
"""Number of rows of a run in memory at once, apart from their scaling."""
AGREES, DIFFERS, TOO_LITTLE = "agrees", "differs", "too little"


@dataclass(frozen=True)
class SafetyOverride:
    """Override of one session from the log of its safety system.

    Attributes:
        log: Name of the log, as shown to users.
        t_s: Time, shape (T,), ascending; session time as far as the clock offset is known, s.
        override: Shape (T,), 0 to 1.
        clock_known: Whether the clock offset to the robot is known, not assumed.
    """

    log: str
    t_s: Vector
    override: Vector
    clock_known: bool

    def at(self, t_s: Vector) -> Vector:
        """Return the override at times, shape (N,), NaN in gaps of the log."""
        row = np.searchsorted(self.t_s, t_s, side="right") - 1
        held_s = max(SILENT_S, SILENT_STEPS * float(np.median(np.diff(self.t_s))))
        known = (row >= 0) & (t_s - self.t_s[row] <= held_s)
        return np.where(known, self.override[row], np.nan)


@dataclass(frozen=True)
class OverrideMatch:
    """Agreement of an override with the scaling inferred from the motion, at the best offset.

    Attributes:
        later_s: Delay of the robot after the log, s.
        error: Median difference at that delay.
        found: AGREES, DIFFERS or TOO_LITTLE.
    """

    later_s: float
    error: float
    found: str

    @property
    def agrees(self) -> bool:
        """Whether both are the same."""
        return self.found == AGREES


def override_of(session: Session, read: Read) -> SafetyOverride | None:
    """Return the override that a session's safety system logged; None if there is none.

    Args:
        session: Session with its recordings in one clock.
        read: Returns a native table of a recording (id, table), None if it has none.
    """
    for recording in session.recordings:
        table = read(recording.id, "safety") if "safety" in recording.tables else None
        if table is None:
            continue
        known = table.drop_nulls("override").sort("t_s")
        if known.height > 2:
            clock = recording.clock
            t_s = known["t_s"].to_numpy() * clock.rate + clock.offset_s
            return SafetyOverride(recording.shown, t_s, known["override"].to_numpy(), "assumed" not in clock.method)
    return None


def match_of(logged: SafetyOverride, runs: Iterable[tuple[Run, Sequence[InferredScaling]]]) -> OverrideMatch:
    """Compare an override with the scaling inferred from the motion of the same session.

    Args:
        logged: The override.
        runs: The runs of the session without logged scaling, each with its inferred parts.
    """
    t_s, scaling = _sure(runs)
    if len(t_s) < MIN_ROWS or np.ptp(scaling) < CAPPED:
        return OverrideMatch(0.0, 0.0, TOO_LITTLE)
    step = -(-len(t_s) // COMPARED)
    t_s, scaling = t_s[::step], scaling[::step]

    def misfit(later_s: Vector, every: int = 1) -> Vector:
        return np.array([_misfit(logged, t_s[::every], scaling[::every], later) for later in later_s])

    reach = NEAR_S if logged.clock_known else FAR_S
    offsets = np.arange(reach[0], reach[1] + COARSE_S, COARSE_S)
    coarse = misfit(offsets, max(1, len(t_s) // ROUGHLY))
    if not np.isfinite(coarse).any():
        return OverrideMatch(0.0, 0.0, TOO_LITTLE)
    best = float(offsets[np.nanargmin(coarse)])
    fine = np.arange(best - COARSE_S, best + COARSE_S + FINE_S, FINE_S)
    found = misfit(fine)
    later_s = float(np.median(fine[found <= np.nanmin(found) + _TIE * CAPPED]))
    away = np.abs(offsets - later_s) > APART_S
    alone = not away.any() or bool(np.nanmin(coarse[away]) > BETTER * float(np.nanmin(found)))
    differ = np.abs(logged.at(t_s - later_s) - scaling)
    differ = differ[np.isfinite(differ)]
    error = float(np.median(differ))
    agrees = alone and error <= MAX_MEDIAN_DIFFERENCE and float(np.quantile(differ, 0.9)) <= MAX_QUANTILE_DIFFERENCE
    return OverrideMatch(later_s, error, AGREES if agrees else DIFFERS)


def taken(logged: SafetyOverride, later_s: float, run: Run) -> InferredScaling:
    """Return the scaling of a whole run from the override, which the robot follows `later_s` after the log."""
    blocks = (run.window(at, min(at + AT_ONCE, run.rows) - 1) for at in range(0, run.rows, AT_ONCE))
    scaling = np.concatenate(
        [logged.at(block.t_s - later_s) for block in blocks]
    )  # not float32: 69 % is just within the tolerance of a level of 70 %
    gap = np.where(np.isfinite(scaling), 0, NOT_LOGGED).astype(np.int8)
    return InferredScaling(0, scaling, np.broadcast_to(0.0, scaling.shape), gap)


def logged_apart(
    runs: Sequence[Run],
    parts: Sequence[Sequence[InferredScaling]],
    sessions: Sequence[Session],
    overrides: Sequence[SafetyOverride | None],
) -> tuple[dict[int, InferredScaling], list[Note]]:
    """Return the scaling of the runs that follow the override of their session's safety system, and notes.

    Args:
        runs: All runs.
        parts: Inferred parts of each run.
        sessions: All sessions, with the indices of their runs.
        overrides: Logged override of each session.
    """
    found: dict[int, InferredScaling] = {}
    told: dict[str, list[tuple[str, OverrideMatch]]] = {}
    for session, logged in zip(sessions, overrides, strict=True):
        silent = [number for number in session.runs if not runs[number].knows_scaling]
        if logged is None or not silent:
            continue
        agreed = match_of(logged, [(runs[number], parts[number]) for number in silent])
        told.setdefault(agreed.found, []).append((logged.log, agreed))
        if agreed.agrees:
            found |= {number: taken(logged, agreed.later_s, runs[number]) for number in silent}
    return found, [_told_of_logs(what, mine) for what, mine in told.items()]


def _told_of_logs(found: str, told: Sequence[tuple[str, OverrideMatch]]) -> Note:
    """Return one note on all logs with the same result."""
    error, later_s = (np.array([getattr(one, name) for _, one in told]) for name in ("error", "later_s"))
    values: dict[str, str | int | float] = {"log": told[0][0], "logs": len(told), "error": float(error.max())}
    times = {"earliest_s": float(later_s.min()), "latest_s": float(later_s.max())}
    if found == AGREES:
        return note("scaling-of-safety-log", **values, **times)
    if found == DIFFERS:
        return note("override-not-followed", **values, **times)
    return note("override-not-compared", **values)


def _sure(runs: Iterable[tuple[Run, Sequence[InferredScaling]]]) -> tuple[Vector, Vector]:
    """Return the times of precise inferred scalings and their values, shapes (N,)."""
    times, values = [np.empty(0)], [np.empty(0)]
    for run, parts in runs:
        for part in parts:
            sure = np.flatnonzero(part.deviation <= SURE)
            if len(sure):
                times.append(run.window(part.first, part.first + len(part.scaling) - 1).t_s[sure])
                values.append(part.scaling[sure].astype(np.float64))
    return np.concatenate(times), np.concatenate(values)


def _misfit(logged: SafetyOverride, t_s: Vector, scaling: Vector, later_s: float) -> float:
    """Return the mean capped difference at an offset; NaN if the log covers at most half of the times."""
    differ = np.abs(logged.at(t_s - later_s) - scaling)
    known = np.isfinite(differ)
    return float(np.minimum(differ[known], CAPPED).mean()) if 2 * int(known.sum()) > len(t_s) else np.nan
