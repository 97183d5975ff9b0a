"""What the logs show of the cell at the time of each value of a set override."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.alignment.clocks import ASSUMED
from cyclekit.dataset.signals import OUTPUT, REGISTER, values_of
from cyclekit.dataset.unknown_height import in_plane
from cyclekit.people.activity import person_tracks
from cyclekit.people.tracks import nearest_person
from cyclekit.segmentation.stored_run import sampled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read, SignalChanges, Stored
    from cyclekit.schema import Floats, Vector
    from cyclekit.segmentation.stored_run import Run

ROBOT = "robot "
"""First word of the features that the robot alone shows."""
FAR_M = 99.0
"""Distance of nobody, m."""
PAST_S = (2.0, 10.0)
"""The state of the last so many seconds counts as well, s: an override that rises by 10 %/s needs up to ten."""
TOGETHER_S = 1.0
"""Time around a change of the override in which a signal changes with it, s."""


@dataclass(frozen=True)
class SetOverrideRows:
    """N rows of one session while its robot log runs.

    Attributes:
        t_s: Session time, shape (N,), ascending, s.
        override: The set override, shape (N,), 0 to 1; NaN = not logged.
        scaling: The other scaling in the log, shape (N,), NaN = unknown.
        features: What the cell looked like, by name, shape (N,) each.
        tracked: Whether a tracker in the robot's clock logged people.
    """

    t_s: Vector
    override: Vector
    scaling: Vector
    features: Mapping[str, Vector]
    tracked: bool


def override_rows(
    item: tuple[Session, Sequence[Run]],
    *,
    step_s: float,
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
    cell: Cell,
) -> SetOverrideRows:
    """Return rows of a session, `step_s` apart.

    Args:
        item: The session, its recordings in one clock, and the runs of its robot.
        step_s: Time between rows, s.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns).
        cell: Bridged gap of tracks.
    """
    session, runs = item
    parts = [sampled(run, np.arange(run.time_at(0), run.time_at(run.rows - 1), step_s)) for run in runs]
    t_s, override, scaling = (
        np.concatenate([np.empty(0), *(getattr(part, name) for part in parts)]) for name in ("t_s", "slider", "scaling")
    )
    tcp_m = np.concatenate([np.empty((0, 3)), *(part.xyz_m for part in parts)])
    features: dict[str, Vector] = {f"{ROBOT}{axis}": np.nan_to_num(tcp_m[:, k]) for k, axis in enumerate("xyz")}
    tracks = person_tracks(session.recordings, sources, read)
    if tracks:
        human_m, _ = nearest_person(tracks, t_s, tcp_m, bridge_s=cell.bridge_s, width_s=step_s)
        features |= _of_people(tcp_m, human_m, step_s)
    features |= _of_signals(session, t_s, override, step_s, read, stored)
    clocks = [one.clock.method for one in session.recordings if "people" in one.tables]
    return SetOverrideRows(t_s, override, scaling, features, bool(tracks) and ASSUMED not in clocks)


def _of_people(tcp_m: Floats, human_m: Floats, step_s: float) -> dict[str, Vector]:
    way = in_plane(tcp_m, human_m) - tcp_m
    seen = np.isfinite(way).all(axis=1)
    apart_m, flat_m = (np.where(seen, np.linalg.norm(way[:, :axes], axis=1), FAR_M) for axes in (3, 2))
    found = {"distance": apart_m, "distance on the floor": flat_m}
    found |= {f"person {axis}": np.where(seen, human_m[:, k], FAR_M) for k, axis in enumerate("xy")}
    return found | {f"distance {past_s}": least(apart_m, past_s, step_s) for past_s in PAST_S}


def _of_signals(
    session: Session, t_s: Vector, override: Vector, step_s: float, read: Read, stored: Stored
) -> dict[str, Vector]:
    """Return the states of two-state inputs and events, without those that follow the override, such as a lamp."""
    moved_s = t_s[1:][np.diff(override) != 0.0]
    found: dict[str, Vector] = {}
    for entry in session.recordings:
        for name, logged in values_of(entry, read, stored).items():
            changes = logged._replace(t_s=logged.t_s * entry.clock.rate + entry.clock.offset_s)
            if name == REGISTER or name.startswith(OUTPUT) or _follows(changes, moved_s, step_s):
                continue
            values = np.unique(changes.value)
            state = (changes.at(t_s) == values[-1]).astype(np.float64)
            if len(values) == 2 and np.ptp(state) > 0.0:
                found[name] = state
                found |= {f"{name} all {past_s}": least(state, past_s, step_s) for past_s in PAST_S}
                found |= {f"{name} any {past_s}": -least(-state, past_s, step_s) for past_s in PAST_S}
    return found


def _follows(changes: SignalChanges, moved_s: Vector, step_s: float) -> bool:
    """Return whether a signal usually changes after the override, not before it."""
    at_s = changes.t_s[1:]
    if not len(at_s) or not len(moved_s):
        return False
    early, middle, late = (np.searchsorted(at_s, moved_s + off_s) for off_s in (-step_s - TOGETHER_S, 0.0, TOGETHER_S))
    return int((late > middle).sum()) > int((middle > early).sum())


def least(values: Vector, past_s: float, step_s: float) -> Vector:
    """Return the least value of the last `past_s` seconds, shape (N,)."""
    width = round(past_s / step_s)
    padded = np.concatenate([np.full(width, np.inf), values])
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, width + 1).min(axis=1))
