"""What the operator did: x_h, task and goal of every sample of every execution.

The tracks of a session are brought into its time and the base frame; goals come from its events if there are any,
else from where the operator stays. How a single track is sampled is the business of `people`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset import Place
from cyclekit.frames import to_base
from cyclekit.people import Track, find_spots, find_stays, goals_from_events, goals_from_stays, nearest_person

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


def with_operator(
    grids: list[Grid], sources: Mapping[str, Source | None], read: Read, cell: Cell
) -> tuple[list[Grid], dict[str, Place]]:
    """Fill in x_h, the operator's task and g_h."""
    tracks: dict[str, list[Track]] = {}
    events: dict[str, tuple[Vector, list[str]]] = {}
    for session in {grid.session.name: grid.session for grid in grids}.values():
        tracks[session.name], events[session.name] = _operator_logs(session, sources, read)
    grids = [replace(g, human_m=_human(g, tracks[g.session.name], cell)) for g in grids]
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
) -> tuple[list[Track], tuple[Vector, list[str]]]:
    tracks: list[Track] = []
    times, values = [np.empty(0)], []
    for entry in session.entries:
        clock = entry["clock"]
        people = read(entry["id"], "people") if "people" in entry["tables"] else None
        if people is not None:
            source = sources[entry["id"]]
            frame = source.frame if source else None
            for (person,), rows in people.sort("t_s").group_by(["person"], maintain_order=True):
                xyz = to_base(rows.select("x_m", "y_m", "z_m").to_numpy(), frame, up=entry["up"])
                t = rows["t_s"].to_numpy() * clock["rate"] + clock["offset_s"]
                tracks.append(Track(str(person), t, xyz))
        said = read(entry["id"], "events") if "events" in entry["tables"] else None
        if said is not None:
            said = said.filter(pl.col("signal").str.contains(GOAL_SIGNAL, literal=True)).sort("t_s")
            times.append(said["t_s"].to_numpy() * clock["rate"] + clock["offset_s"])
            values += said["value"].to_list()
    t_event = np.concatenate(times)
    order = np.argsort(t_event, kind="stable")
    return tracks, (t_event[order], [values[i] for i in order.tolist()])


def _human(grid: Grid, tracks: Sequence[Track], cell: Cell) -> Points:
    tcp = grid.frame.select("robot_x_m", "robot_y_m", "robot_z_m").to_numpy()
    return nearest_person(tracks, grid.t_s, tcp, bridge_s=cell.bridge_s)


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


def _with_human_columns(grid: Grid, goals: Sequence[str | None], spots: Mapping[str, Place]) -> Grid:
    nowhere = (np.nan, np.nan, np.nan)
    at = np.array([spots[name].xyz_m if name and name in spots else nowhere for name in goals]).reshape(-1, 3)
    columns = [
        *(pl.Series(f"human_{axis}_m", grid.human_m[:, k]).fill_nan(None) for k, axis in enumerate("xyz")),
        *(pl.Series(f"human_goal_{axis}_m", at[:, k]).fill_nan(None) for k, axis in enumerate("xyz")),
        pl.Series("human_task", goals, dtype=pl.String),
    ]
    return replace(grid, frame=grid.frame.with_columns(columns))
