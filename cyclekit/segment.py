"""What the robot was doing: stops, places, executions and tasks, found from its motion.

A robot program moves from place to place and stands there while the gripper works. A safety halt stands too, but
somewhere along the way, and only while the scaling is zero. So a place is a spot where the robot stands although it
was allowed to move; where the scaling is not logged, a spot that the robot never passes without standing. What the
slow-down costs is computed in `account`; the operator is the business of `people`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset import Place
from cyclekit.errors import UnknownName

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.config import Executions, NamedPlace

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]

MIN_STOP_S = 0.15
"""A standstill shorter than this is no stop: the reversal of a path takes one or two controller cycles."""
MERGE_M = 0.01
"""Stops nearer than this to each other are one place (robots repeat to 0.1 mm; two fixtures are never this near)."""
TWITCH_S, TWITCH_M = 0.1, 2e-4
"""A motion that is over within this time and leads no farther than this is noise of the position."""
EDGE_S = 0.03
"""Scaling at the edges of a standstill is not judged: speed follows the scaling a few controller cycles later."""


@dataclass(frozen=True)
class RobotRun:
    """One continuous stretch of a robot log.

    Attributes:
        t_s: Session time, shape (T,), strictly increasing, seconds.
        xyz_m: TCP, shape (T, 3), metres.
        speed_m_s: TCP speed, shape (T,), m/s.
        scaling: Shape (T,), NaN = unknown.
        marker: Execution marker (register value or digital output), shape (T,); empty when none is used.
    """

    t_s: Vector
    xyz_m: Points
    speed_m_s: Vector
    scaling: Vector
    marker: Vector = field(default_factory=lambda: np.empty(0))


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


def split_runs(t_s: Vector, *, gap_s: float) -> list[slice]:
    """Return the continuous stretches of a log: split where the clock jumps ahead by more than `gap_s` or goes back."""
    step = np.diff(t_s)
    cuts = np.flatnonzero((step > gap_s) | (step <= 0)) + 1
    edges = [0, *cuts.tolist(), len(t_s)]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def tcp_speed(t_s: Vector, xyz_m: Points, *, window_s: float = 0.024) -> Vector:
    """Return the TCP speed, m/s, shape (T,), as the slope of the position over `window_s` around each row.

    The window (three controller cycles at 125 Hz) keeps the position's resolution from dominating a quotient of
    differences at 500 Hz.
    """
    if len(t_s) < 3:
        return np.zeros(len(t_s))
    half = max(1, round(window_s / 2 / float(np.median(np.diff(t_s)))))
    row = np.arange(len(t_s))
    after, before = np.minimum(row + half, len(t_s) - 1), np.maximum(row - half, 0)
    path = np.linalg.norm(xyz_m[after] - xyz_m[before], axis=1)
    return np.asarray(path / np.maximum(t_s[after] - t_s[before], 1e-9))


def standing(speed_m_s: Vector) -> NDArray[np.bool_]:
    """Tell where the robot stands, shape (T,): slower than the noise of its own standstill allows to see.

    The threshold is four times the median speed below 3 mm/s, between 0.1 and 3 mm/s: low, because a motion that
    starts jerk-limited is slow for its first milliseconds.
    """
    crawl = speed_m_s[speed_m_s < 3e-3]
    noise = float(np.median(crawl)) if len(crawl) else 0.0
    return np.asarray(speed_m_s < min(max(4.0 * noise, 1e-4), 3e-3))


def find_stops(run: RobotRun, number: int) -> list[Stop]:
    """Return the standstills of a run of at least MIN_STOP_S and its two edges, in order."""
    stops = []
    for first, last in _stands(run).tolist():
        short = run.t_s[last] - run.t_s[first] < MIN_STOP_S
        if short and first != 0 and last != len(run.t_s) - 1:
            continue
        x, y, z = np.median(run.xyz_m[first : last + 1], axis=0)
        stops.append(Stop(number, first, last, (float(x), float(y), float(z)), _free(run, first, last), short))
    return stops


def _stands(run: RobotRun) -> NDArray[np.int64]:
    """Return the first and last row of every standstill, shape (S, 2); a twitch of the measurement does not end one."""
    still = standing(run.speed_m_s)
    still[[0, -1]] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2] - 1
    brief = run.t_s[first[1:]] - run.t_s[last[:-1]] < TWITCH_S
    twitch = brief & (np.linalg.norm(run.xyz_m[first[1:]] - run.xyz_m[last[:-1]], axis=1) < TWITCH_M)
    return np.column_stack([first[np.concatenate([[True], ~twitch])], last[np.concatenate([~twitch, [True]])]])


def _free(run: RobotRun, first: int, last: int) -> bool | None:
    t = run.t_s[first : last + 1]
    inside = run.scaling[first : last + 1][(t > t[0] + EDGE_S) & (t < t[-1] - EDGE_S)]
    known = inside[np.isfinite(inside)]
    return bool((known > 0.0).any()) if len(known) else None


def find_places(runs: Sequence[RobotRun], stops: Sequence[Stop], named: Mapping[str, NamedPlace]) -> dict[str, Place]:
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
    found = [g for g in groups if np.isin(g, common).any() or _is_place(runs, stops, xyz, g)]
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


def _is_place(runs: Sequence[RobotRun], stops: Sequence[Stop], xyz: Points, group: NDArray[np.int64]) -> bool:
    centre = np.median(xyz[group], axis=0)
    if any(stops[i].free for i in group.tolist()):
        near = np.linalg.norm(xyz - centre, axis=1) <= MERGE_M
        return bool(len(group) >= 0.1 * np.count_nonzero(near))
    passes = sum(_passes(run, centre) for run in runs)
    return len(group) >= 0.8 * passes


def _passes(run: RobotRun, centre: Vector) -> int:
    """Count how often a run comes within MERGE_M of a spot, standing or not."""
    near = np.linalg.norm(run.xyz_m - centre, axis=1) <= MERGE_M
    return int(near[0]) + int(np.count_nonzero(np.diff(near.astype(np.int8)) == 1)) if len(near) else 0


def find_visits(stops: Sequence[Stop], places: Mapping[str, Place], runs: Sequence[RobotRun]) -> list[list[Visit]]:
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


def _stayed(run: RobotRun, a: int, b: int) -> bool:
    return float(np.linalg.norm(run.xyz_m[a : b + 1] - run.xyz_m[a], axis=1).max()) <= MERGE_M


def find_executions(
    runs: Sequence[RobotRun], visits: Sequence[Sequence[Visit]], places: Mapping[str, Place], how: Executions
) -> list[Execution]:
    """Cut the visits of each run into executions, as the cell file says they begin.

    An execution goes from the departure at its first visit to the arrival at its last; consecutive ones share a visit.
    It is complete when the run shows both the place it left from and a place it ended at.

    Raises:
        UnknownName: `how.home` is no place of this cell.
    """
    if how.home is not None and how.home not in places:
        raise UnknownName("cell.toml [executions] home", "place", how.home, places)
    firsts = [seen[0].place for seen in visits if seen]
    home = how.home or max(sorted(set(firsts)), key=firsts.count, default="")
    found = []
    for number, (run, seen) in enumerate(zip(runs, visits, strict=True)):
        cuts = _begins(run, seen, how, home)
        for a, b in pairwise(cuts):
            by_home = how.begin in {"auto", "home"} and len(cuts) > 2
            whole = not by_home or (seen[a].place == home and seen[b].place == home)
            found.append(Execution(number, tuple(seen[a : b + 1]), whole))
    return found


def _begins(run: RobotRun, seen: Sequence[Visit], how: Executions, home: str) -> list[int]:
    """Indices of the visits at which an execution begins, with the last visit as the end; ascending."""
    if len(seen) < 2:
        return []
    last = len(seen) - 1
    if how.begin in {"file", "gap"}:
        return [0, last]
    if how.begin in {"register", "digital-output"}:
        step = np.diff(run.marker)
        edges = np.flatnonzero(step > 0 if how.begin == "digital-output" else step != 0)
        departures = np.array([visit.last for visit in seen])
        begins = {int(np.searchsorted(departures, edge)) for edge in [-1, *edges.tolist()]}
        return sorted({b for b in begins if b < last} | {last})
    cuts = [i for i, visit in enumerate(seen) if visit.place == home]
    return sorted({*cuts, last}) if cuts else [0, last]
