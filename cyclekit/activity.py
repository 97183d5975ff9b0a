"""What the operator did: x_h, task and goal of every sample of every execution.

The tracks of a session are brought into its time and the base frame; goals come from its events if there are any,
else from where the operator stays. How a single track is sampled is the business of `people`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit.dataset import Place
from cyclekit.frames import to_base
from cyclekit.people import (
    REASONS,
    Track,
    find_spots,
    find_stays,
    gap_reasons,
    goals_from_events,
    goals_from_stays,
    ids_are_real,
    link_by_motion,
    nearest_person,
    without_jumps,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.config import Cell, Source
    from cyclekit.session import Grid, Session

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]
    Read = Callable[[str, str], pl.DataFrame | None]

GOAL_SIGNAL = "goal"
"""An event whose signal name holds this word tells the operator's goal."""


OPERATOR = "operator: "
"""How a warning of a recording begins that was found here, and not when its log was read."""


@dataclass(frozen=True)
class _Log:
    """The tracks that one recording saw, in session time and base frame."""

    entry: dict[str, Any]
    tracks: list[Track]


def with_operator(
    grids: list[Grid], sources: Mapping[str, Source | None], read: Read, cell: Cell
) -> tuple[list[Grid], dict[str, Place]]:
    """Fill in x_h, the operator's task and g_h; say in the entries what was seen, and why nobody was."""
    tracks: dict[str, list[Track]] = {}
    events: dict[str, tuple[Vector, list[str]]] = {}
    gaps: dict[str, NDArray[np.int8] | None] = {}
    for session in {grid.session.name: grid.session for grid in grids}.values():
        logs, events[session.name] = _operator_logs(session, sources, read)
        tracks[session.name] = [track for log in logs for track in log.tracks]
        mine = [grid for grid in grids if grid.session is session]
        times = np.concatenate([grid.t_s for grid in mine])
        found = [_seen_by(log, times, cell) for log in logs]
        cuts = np.cumsum([len(grid.t_s) for grid in mine])[:-1]
        why = np.split(np.min(found, axis=0), cuts) if found else [None] * len(mine)
        gaps |= {grid.execution: reasons for grid, reasons in zip(mine, why, strict=True)}
    grids = [replace(g, human_m=_human(g, tracks[g.session.name], cell), human_gap=gaps[g.execution]) for g in grids]
    stays = [find_stays(g.t_s, g.human_m) for g in grids]
    spots = {name: Place(name, p.xyz_m, p.radius_m, inferred=False) for name, p in cell.human_places.items()}
    if not any(len(t) for t, _ in events.values()):
        at = [np.median(g.human_m[a : b + 1], axis=0) for g, spans in zip(grids, stays, strict=True) for a, b in spans]
        spots = spots or find_spots(np.array(at).reshape(-1, 3))
    goals = [
        goals_from_events(*events[g.session.name], g.t_s)
        if len(events[g.session.name][0])
        else goals_from_stays(spans, g.human_m, spots)
        for g, spans in zip(grids, stays, strict=True)
    ]
    spots |= _places_of_goals(grids, goals, stays, spots)
    return [_with_human_columns(g, goal, spots) for g, goal in zip(grids, goals, strict=True)], spots


def _operator_logs(
    session: Session, sources: Mapping[str, Source | None], read: Read
) -> tuple[list[_Log], tuple[Vector, list[str]]]:
    logs: list[_Log] = []
    times, values = [np.empty(0)], []
    for entry in session.entries:
        clock = entry["clock"]
        people = read(entry["id"], "people") if "people" in entry["tables"] else None
        if people is not None:
            logs.append(_Log(entry, _tracks(entry, people, sources[entry["id"]])))
        said = read(entry["id"], "events") if "events" in entry["tables"] else None
        if said is not None:
            said = said.filter(pl.col("signal").str.contains(GOAL_SIGNAL, literal=True)).sort("t_s")
            times.append(said["t_s"].to_numpy() * clock["rate"] + clock["offset_s"])
            values += said["value"].to_list()
    t_event = np.concatenate(times)
    order = np.argsort(t_event, kind="stable")
    return logs, (t_event[order], [values[i] for i in order.tolist()])


def _tracks(entry: dict[str, Any], people: pl.DataFrame, source: Source | None) -> list[Track]:
    """Return the tracks of the people in a recording, without what cannot have been.

    A body on the robot's flange is nobody. Ids that do not last are replaced by tracks linked by motion.
    """
    entry["warnings"] = [text for text in entry["warnings"] if not text.startswith(OPERATOR)]
    if source is not None and source.sees is not None:
        rides = pl.col("person") == source.sees_as if source.sees_as is not None else pl.lit(value=True)
        people = people.filter(~rides)
    people = people.sort("t_s", maintain_order=True)
    clock = entry["clock"]
    xyz = to_base(people.select("x_m", "y_m", "z_m").to_numpy(), source.frame if source else None, up=entry["up"])
    t = people["t_s"].to_numpy() * clock["rate"] + clock["offset_s"]
    names = people["person"].fill_null("").cast(pl.String).to_list()
    numbers = people["person"].fill_null("").rank("dense").cast(pl.Int64).to_numpy() - 1
    if not ids_are_real(numbers):
        count = len(set(names))
        numbers = link_by_motion(t, xyz)
        names = [f"linked_{number + 1}" for number in numbers.tolist()]
        told = f"{count} track ids in {people['t_s'].n_unique()} frames last for no longer than a frame or two"
        entry["warnings"].append(f"{OPERATOR}{told}: linked by motion into {int(numbers.max(initial=-1)) + 1} tracks")
    tracks: list[Track] = []
    disbelieved = 0
    for number in [n for n in dict.fromkeys(numbers.tolist()) if n >= 0]:
        rows = np.flatnonzero(numbers == number)
        parts, dropped = without_jumps(Track(names[rows[0]], t[rows], xyz[rows]))
        tracks += parts
        disbelieved += dropped
    if disbelieved:
        told = f"{disbelieved} positions are not believed, since nobody moves at over 20 m/s"
        entry["warnings"].append(f"{OPERATOR}{told}: unknown there")
    entry["operator"] = {"not_believed": disbelieved}
    return tracks


def _seen_by(log: _Log, times: Vector, cell: Cell) -> NDArray[np.int8]:
    """Return whether the recording saw somebody at each sample, and why not; note the counts."""
    clock = log.entry["clock"]
    first, last = (log.entry[key] * clock["rate"] + clock["offset_s"] for key in ("first_s", "last_s"))
    found = gap_reasons(log.tracks, times, (first, last), bridge_s=cell.bridge_s)
    counts = np.bincount(found, minlength=len(REASONS)).tolist()
    log.entry["operator"] |= dict(zip(REASONS, counts, strict=True))
    return found


def _human(grid: Grid, tracks: Sequence[Track], cell: Cell) -> Points:
    tcp = grid.frame.select("robot_x_m", "robot_y_m", "robot_z_m").to_numpy()
    return nearest_person(tracks, grid.t_s, tcp, bridge_s=cell.bridge_s, width_s=1.0 / cell.rate_hz)


def _places_of_goals(
    grids: Sequence[Grid],
    goals: Sequence[Sequence[str | None]],
    stays: Sequence[Sequence[tuple[int, int]]],
    known: Mapping[str, Place],
) -> dict[str, Place]:
    """Where a goal that only a button names lies: the median of the stays during which it was in force.

    The middle of a stay decides: at its end the next button is pressed before the operator is fast enough to walk.
    """
    at: dict[str, list[Vector]] = {}
    for grid, goal, spans in zip(grids, goals, stays, strict=True):
        for first, last in spans:
            name = goal[(first + last) // 2]
            if name is not None and name not in known:
                at.setdefault(name, []).append(np.median(grid.human_m[first : last + 1], axis=0))
    return {name: _spot(name, np.array(points)) for name, points in sorted(at.items())}


def _spot(name: str, points: Points) -> Place:
    x, y, z = (round(float(v), 4) for v in np.nanmedian(points, axis=0))
    return Place(name, (x, y, z), 0.4, inferred=True)


def _why_unseen(grid: Grid) -> list[str | None]:
    """Return why x_h is unknown at each sample; None where it is known, or where nobody was to be tracked."""
    unseen = np.isnan(grid.human_m[:, 0])
    if grid.human_gap is None:
        return [None] * len(unseen)
    reasons = np.maximum(grid.human_gap, REASONS.index("occluded"))  # a position that is not believed was hidden
    return [REASONS[reason] if hidden else None for reason, hidden in zip(reasons, unseen, strict=True)]


def _with_human_columns(grid: Grid, goals: Sequence[str | None], spots: Mapping[str, Place]) -> Grid:
    nowhere = (np.nan, np.nan, np.nan)
    at = np.array([spots[name].xyz_m if name and name in spots else nowhere for name in goals]).reshape(-1, 3)
    columns = [
        *(pl.Series(f"human_{axis}_m", grid.human_m[:, k], nan_to_null=True) for k, axis in enumerate("xyz")),
        *(pl.Series(f"human_goal_{axis}_m", at[:, k], nan_to_null=True) for k, axis in enumerate("xyz")),
        pl.Series("human_task", goals, dtype=pl.String),
        pl.Series("human_gap", _why_unseen(grid), dtype=pl.String),
    ]
    return replace(grid, frame=grid.frame.with_columns(columns))
