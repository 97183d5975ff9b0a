"""What the robot was doing: stops, places, executions and tasks, found from its motion.

A robot program moves from place to place and stands there while the gripper works. A safety halt stands too, but
somewhere along the way, and only while the scaling is zero. So a place is a spot where the robot stands although it
was allowed to move; where the scaling is not logged, a spot that the robot never passes without standing. What the
slow-down costs is computed in `account`; the operator is the business of `people`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset import Place
from cyclekit.errors import UnknownName
from cyclekit.motion import pieces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.config import Executions, NamedPlace
    from cyclekit.motion import Run

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]
    Rows = NDArray[np.int64]

MIN_STOP_S = 0.15
"""A standstill shorter than this is no stop: the reversal of a path takes one or two controller cycles."""
MERGE_M = 0.01
"""Stops nearer than this to each other are one place (robots repeat to 0.1 mm; two fixtures are never this near)."""
TWITCH_S, TWITCH_M = 0.1, 2e-4
"""A motion that is over within this time and leads no farther than this is noise of the position."""
CRAWL_M_S = 3e-3
"""A robot faster than this moves."""
_CRAWLS = 2_000_000  # speeds that its noise is told from
_PLACES = 20_000  # positions that the place of a stand is told from
EDGE_S = 0.03
"""Scaling at the edges of a standstill is not judged: speed follows the scaling a few controller cycles later."""


@dataclass(frozen=True)
class Stop:
    """A standstill of one run, rows `first`..`last` inclusive.

    Attributes:
        free: Scaling was above zero while it stood; None = scaling unknown.
        edge: The run begins or ends here without a standstill: the recorder was switched while the robot just left
            or just arrived. It can be a visit to a place, it cannot make one.
    """

    run: int
    first: int
    last: int
    xyz_m: tuple[float, float, float]
    free: bool | None
    edge: bool = False


@dataclass(frozen=True)
class Visit:
    """A stop (or several joined) at a place, rows `first`..`last` of its run."""

    place: str
    first: int
    last: int


@dataclass(frozen=True)
class Execution:
    """Consecutive visits of one run that make one execution of the process."""

    run: int
    visits: tuple[Visit, ...]
    complete: bool


def standing(run: Run) -> float:
    """Return the speed below which the robot stands, m/s: slower than the noise of its own standstill allows to see.

    It is four times the median speed below CRAWL_M_S, between 0.1 mm/s and CRAWL_M_S: low, because a motion that starts
    jerk-limited is slow for its first milliseconds.
    """
    thin = max(1, run.rows // _CRAWLS)
    crawls = [part.speed_m_s[part.speed_m_s < CRAWL_M_S][::thin] for _, part in pieces(run)]
    crawl = np.concatenate([*crawls, np.empty(0)])
    noise = float(np.median(crawl)) if len(crawl) else 0.0
    return min(max(4.0 * noise, 1e-4), CRAWL_M_S)


def find_stops(run: Run, number: int) -> list[Stop]:
    """Return the standstills of a run of at least MIN_STOP_S and its two edges, in order."""
    stops = []
    for stand in _stands(run, standing(run)):
        short = stand.last_s - stand.first_s < MIN_STOP_S
        if short and stand.first != 0 and stand.last != run.rows - 1:
            continue
        x, y, z = _resting_place(run, stand.first, stand.last)
        stops.append(Stop(number, stand.first, stand.last, (x, y, z), _free(run, stand), short))
    return stops


@dataclass
class _Stand:
    """Rows `first`..`last` in which a robot is slow, with the times and places of both."""

    first: int
    last: int
    first_s: float
    last_s: float
    first_m: Vector
    last_m: Vector


def _stands(run: Run, slow_m_s: float) -> list[_Stand]:
    """Return every standstill; a twitch of the measurement does not end one."""
    found: list[_Stand] = []
    for begin, part in pieces(run):
        still = part.speed_m_s < slow_m_s
        if begin == 0:
            still[0] = True
        if begin + part.rows == run.rows:
            still[-1] = True
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        for a, b in edges.reshape(-1, 2).tolist():
            since, until = float(part.t_s[a]), float(part.t_s[b - 1])
            here = _Stand(begin + a, begin + b - 1, since, until, part.xyz_m[a], part.xyz_m[b - 1])
            if found and (found[-1].last + 1 == here.first or _is_twitch(found[-1], here)):
                found[-1].last, found[-1].last_s, found[-1].last_m = here.last, here.last_s, here.last_m
            else:
                found.append(here)
    return found


def _is_twitch(before: _Stand, after: _Stand) -> bool:
    brief = after.first_s - before.last_s < TWITCH_S
    return bool(brief and np.linalg.norm(after.first_m - before.last_m) < TWITCH_M)


def _resting_place(run: Run, first: int, last: int) -> tuple[float, float, float]:
    """Return the median position of a stand; of a long one that of every so many rows."""
    places = [part.xyz_m[:: max(1, (last - first) // _PLACES)] for _, part in pieces(run, first, last)]
    x, y, z = np.median(np.concatenate(places), axis=0)
    return float(x), float(y), float(z)


def _free(run: Run, stand: _Stand) -> bool | None:
    """Tell whether the robot was allowed to move while it stood, None if that is unknown."""
    known = False
    for _, part in pieces(run, stand.first, stand.last):
        inside = (part.t_s > stand.first_s + EDGE_S) & (part.t_s < stand.last_s - EDGE_S)
        values = part.scaling[inside]
        values = values[np.isfinite(values)]
        if (values > 0.0).any():
            return True
        known = known or len(values) > 0
    return False if known else None


def find_places(runs: Sequence[Run], stops: Sequence[Stop], named: Mapping[str, NamedPlace]) -> dict[str, Place]:
    """Return the places of a cell, by name, named ones first and found ones (`place_1`, ...) by first visit.

    A spot is a place when the cell file names it, or the robot stood there while it was free to move (in at least
    a tenth of its stops), or, where no scaling is known, when it hardly ever passes without standing. The spot at
    which most recordings begin and end is a place too: a recorder that runs from home to home never sees it stand.
    """
    places: dict[str, Place] = {}
    xyz = np.array([stop.xyz_m for stop in stops]).reshape(-1, 3)
    common = _common_edge(stops, xyz)
    able = np.array([stop.free is not False and not stop.edge for stop in stops], bool)
    able[common] = True
    left = able.copy()
    for name, place in named.items():
        near = np.linalg.norm(xyz - np.asarray(place.xyz_m), axis=1) <= place.radius_m
        near &= able
        centre = np.median(xyz[near], axis=0) if near.any() else np.asarray(place.xyz_m)
        places[name] = Place(name, _triple(centre), _radius(xyz[near], centre), inferred=False)
        left &= np.linalg.norm(xyz - centre, axis=1) > MERGE_M
    groups = cluster(xyz, np.flatnonzero(left), MERGE_M)
    edges = [bool(np.isin(group, common).any()) for group in groups]
    others = [group for group, edge in zip(groups, edges, strict=True) if not edge]
    answers = iter(_are_places(runs, stops, xyz, others))
    found = [group for group, edge in zip(groups, edges, strict=True) if edge or next(answers)]
    for number, group in enumerate(sorted(found, key=lambda g: int(g.min())), 1):
        centre = np.median(xyz[group], axis=0)
        places[f"place_{number}"] = Place(f"place_{number}", _triple(centre), _radius(xyz[group], centre), True)
    return places


def _common_edge(stops: Sequence[Stop], xyz: Points) -> NDArray[np.int64]:
    """Return the edges of recordings that lie at one spot, if at least two and most of all edges do; else none."""
    edges = np.flatnonzero(np.array([stop.edge for stop in stops], bool))
    largest = max(cluster(xyz, edges, MERGE_M), key=len, default=edges)
    return largest if len(largest) >= 2 and 2 * len(largest) > len(edges) else edges[:0]


def _triple(xyz: Vector) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 6) for v in xyz)
    return x, y, z


def _radius(members: Points, centre: Vector) -> float:
    """Tolerance of a place: what the robot's own repeatability needs, so that a halt just before it is not taken."""
    spread = float(np.median(np.linalg.norm(members - centre, axis=1))) if len(members) else MERGE_M
    return round(min(max(6.0 * spread, 5e-4), MERGE_M), 6)


def cluster(xyz: Points, rows: NDArray[np.int64], radius_m: float) -> list[NDArray[np.int64]]:
    """Group positions that lie within `radius_m` of the densest spots, densest first; an unknown one is in no group.

    Args:
        xyz: Positions, shape (M, 3), metres.
        rows: Which of them to group.
        radius_m: Reach of a group around its densest cell's median.
    """
    groups: list[NDArray[np.int64]] = []
    rest = rows[np.isfinite(xyz[rows]).all(axis=1)]
    while len(rest):
        cells = np.floor(xyz[rest] / radius_m).astype(np.int64)
        _, index, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        core = np.median(xyz[rest[index.ravel() == int(counts.argmax())]], axis=0)
        near = np.linalg.norm(xyz[rest] - core, axis=1) <= radius_m
        groups.append(rest[near])
        rest = rest[~near]
    return groups


def _are_places(runs: Sequence[Run], stops: Sequence[Stop], xyz: Points, groups: Sequence[Rows]) -> list[bool]:
    """Tell which groups of stops are places."""
    centres = [np.median(xyz[group], axis=0) for group in groups]
    free = [any(stops[i].free for i in group.tolist()) for group in groups]
    asked = [centre for centre, is_free in zip(centres, free, strict=True) if not is_free]
    passes = iter(count_passes(runs, np.array(asked).reshape(-1, 3)).tolist())
    answers = []
    for group, centre, is_free in zip(groups, centres, free, strict=True):
        if is_free:
            near = np.linalg.norm(xyz - centre, axis=1) <= MERGE_M
            answers.append(bool(len(group) >= 0.1 * np.count_nonzero(near)))
        else:
            answers.append(bool(len(group) >= 0.8 * next(passes)))
    return answers


def count_passes(runs: Sequence[Run], centres: Points) -> Rows:
    """Count how often the robot comes within MERGE_M of each spot, standing or not; centres (C, 3), counts (C,)."""
    counts = np.zeros(len(centres), np.int64)
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = _cell(centres[:, None] + MERGE_M * around[None]).ravel()  # of each spot all that it reaches into
    order = np.argsort(cells, kind="stable")
    cells, owners = cells[order], order // len(around)
    for run in runs if len(centres) else ():
        last = np.full(len(centres), -2, np.int64)
        for begin, part in pieces(run):
            spot, row = _near(part.xyz_m, centres, cells, owners)
            row = row + begin
            before = np.where(np.diff(spot, prepend=-1) == 0, np.roll(row, 1), last[spot])
            counts += np.bincount(spot[row != before + 1], minlength=len(centres))
            np.maximum.at(last, spot, row)
    return counts


def _near(xyz_m: Points, centres: Points, cells: Rows, owners: Rows) -> tuple[Rows, Rows]:
    """Return which rows are within MERGE_M of which spots, by spot and row.

    Args:
        xyz_m: Positions, shape (T, 3), metres.
        centres: The spots, shape (C, 3).
        cells: Cells that they reach into, ascending.
        owners: Whose each cell is, an index into the centres.
    """
    known = np.flatnonzero(np.isfinite(xyz_m).all(axis=1))
    cell = _cell(xyz_m[known])
    first, end = np.searchsorted(cells, cell, side="left"), np.searchsorted(cells, cell, side="right")
    many = end - first
    row = np.repeat(known, many)
    within = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
    spot = owners[np.repeat(first, many) + within]
    near = np.linalg.norm(xyz_m[row] - centres[spot], axis=1) <= MERGE_M
    order = np.lexsort((row[near], spot[near]))
    return spot[near][order], row[near][order]


def _cell(xyz_m: Points) -> Rows:
    """Return the number of the cube of MERGE_M that each position (..., 3) lies in, shape (...)."""
    index = np.floor(xyz_m / MERGE_M).astype(np.int64) + (1 << 20)
    return np.asarray((index[..., 0] << 42) + (index[..., 1] << 21) + index[..., 2])


def find_visits(stops: Sequence[Stop], places: Mapping[str, Place], runs: Sequence[Run]) -> list[list[Visit]]:
    """Return, per run, its visits to places in order; stops at one place without leaving it are one visit."""
    visits: list[list[Visit]] = [[] for _ in runs]
    names = list(places)
    centres = np.array([places[name].xyz_m for name in names]).reshape(-1, 3)
    radii = np.array([places[name].radius_m for name in names])
    for stop in stops:
        if not names:
            break
        distance = np.linalg.norm(centres - np.asarray(stop.xyz_m), axis=1)
        best = int(distance.argmin())
        if distance[best] > radii[best]:
            continue
        seen = visits[stop.run]
        if seen and seen[-1].place == names[best] and _stayed(runs[stop.run], seen[-1].last, stop.first):
            seen[-1] = Visit(names[best], seen[-1].first, stop.last)
        else:
            seen.append(Visit(names[best], stop.first, stop.last))
    return visits


def _stayed(run: Run, a: int, b: int) -> bool:
    begin = run.window(a, a).xyz_m[0]
    parts = (part.xyz_m for _, part in pieces(run, a, b))
    return all(float(np.linalg.norm(xyz - begin, axis=1).max()) <= MERGE_M for xyz in parts)


def find_executions(
    visits: Sequence[Sequence[Visit]], places: Mapping[str, Place], how: Executions, marks: Sequence[Rows]
) -> list[Execution]:
    """Cut the visits of each run into executions, as the cell file says they begin.

    An execution goes from the departure at its first visit to the arrival at its last; consecutive ones share a visit.
    It is complete when the run shows both the place it left from and a place it ended at.

    Args:
        visits: Of each run, in order.
        places: All places, for the message.
        how: What begins an execution.
        marks: Of each run the rows at which a register or output says that one begins.

    Raises:
        UnknownName: `how.home` is no place of this cell.
    """
    if how.home is not None and how.home not in places:
        raise UnknownName("cell.toml [executions] home", "place", how.home, places)
    firsts = [seen[0].place for seen in visits if seen]
    home = how.home or max(sorted(set(firsts)), key=firsts.count, default="")
    found = []
    for number, (seen, marked) in enumerate(zip(visits, marks, strict=True)):
        cuts = _begins(seen, how, home, marked)
        for a, b in pairwise(cuts):
            by_home = how.begin in {"auto", "home"} and len(cuts) > 2
            whole = not by_home or (seen[a].place == home and seen[b].place == home)
            found.append(Execution(number, tuple(seen[a : b + 1]), whole))
    return found


def _begins(seen: Sequence[Visit], how: Executions, home: str, marked: Rows) -> list[int]:
    """Indices of the visits at which an execution begins, with the last visit as the end; ascending."""
    if len(seen) < 2:
        return []
    last = len(seen) - 1
    if how.begin in {"file", "gap"}:
        return [0, last]
    if how.begin in {"register", "digital-output", "signal"}:
        departures = np.array([visit.last for visit in seen])
        begins = {int(np.searchsorted(departures, row)) for row in [-1, *marked.tolist()]}
        return sorted({b for b in begins if b < last} | {last})
    cuts = [i for i, visit in enumerate(seen) if visit.place == home]
    return sorted({*cuts, last}) if cuts else [0, last]
