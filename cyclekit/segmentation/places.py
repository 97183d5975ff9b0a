"""The places of a cell, from the standstills of its robot.

A place is a position at which the robot stops although it was allowed to move. If the scaling is not logged, it is a
position that the robot rarely passes without a standstill, or with many standstills of the same duration. Motion is
evaluated first. Then signals (an output, a register, an event) that change during standstills at these places, and
rarely otherwise, show further places.

A robot without dwells stops at each position for at most a row or two of its log. If it has standstills at no more than
one place, these turning points divide its motion (`with_turns`).
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.dataset import Place
from cyclekit.segmentation.standstills import Standstill
from cyclekit.segmentation.stored_run import Run, pieces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import NamedPlace
    from cyclekit.schema import Ints, Points, Vector


COUNTED = 5000
"""Maximum number of positions, evenly chosen, among which neighbours are counted, so that the cost is linear. Only the
order of equally visited places rests on it, half or twice of it alike: a group is made of all positions."""
MERGE_M = 0.01
"""Maximum distance, m, of standstills at one place (robots repeat to 0.1 mm; two fixtures are never this close)."""
WORKS, WORKS_AT = 0.9, 0.8
"""A signal marks work if at least WORKS of its changes are in standstills, and it changes in at least WORKS_AT of the
standstills at some place. A signal of stop or motion changes at the ends of standstills, and in most at no place."""

EVEN, OFTEN, EXACT_M = 0.7, 5, 5e-4
"""Minimum ratio of short to long standstills, minimum number of standstills, and maximum median distance, m, for a
place at which the robot works, however often it passes without a stop: protective stops vary in duration and position
with the operator."""
VARIES, PASSED = 0.5, 1.1
"""The robot only waits at a position if the ratio of short to long standstills is below VARIES, and if it comes there
at least PASSED times as often as it stops."""
FEW, OFTEN_PASSED = 3, 4.0
"""Fewer standstills show no variation: there, it only waits if it comes OFTEN_PASSED times as often as it stops."""


def find_places(
    runs: Sequence[Run], stops: Sequence[Standstill], named: Mapping[str, NamedPlace], *, all_named: bool = False
) -> dict[str, Place]:
    """Return the places of a cell by name: named ones first, then found ones (`place_1`, ...) by first visit.

    A position is a place in any of these cases:

    - The cell file names it.
    - In at least a tenth of its standstills, the robot was free to move.
    - The scaling is unknown, and the robot rarely passes without a standstill, or its standstills are similar.
    - Most recordings begin and end there: a recorder that runs from home to home never records a standstill at home.
    - In at least half of its standstills, a signal changes that marks work at other places.

    It is no place if the robot also passes without a stop and its standstills vary widely: the robot waits there. With
    `all_named`, only named places are returned.
    """
    places: dict[str, Place] = {}
    xyz = np.array([stop.xyz_m for stop in stops]).reshape(-1, 3)
    common = _common_edge(stops, xyz)
    able = np.array([stop.free is not False and not stop.edge for stop in stops], bool)
    able[common] = True
    left = able.copy()
    members: list[Ints] = []
    for name, place in named.items():
        near = np.linalg.norm(xyz - np.asarray(place.xyz_m), axis=1) <= place.radius_m
        near &= able
        members.append(np.flatnonzero(near))
        centre = np.median(xyz[near], axis=0) if near.any() else np.asarray(place.xyz_m)
        places[name] = Place(name, _triple(centre), _radius(xyz[near], centre), inferred=False)
        left &= np.linalg.norm(xyz - centre, axis=1) > MERGE_M
    if all_named:
        return places
    groups = cluster(xyz, np.flatnonzero(left), MERGE_M)
    edges = [bool(np.isin(group, common).any()) for group in groups]
    others = [group for group, edge in zip(groups, edges, strict=True) if not edge]
    answers = iter(_are_places(runs, stops, xyz, others))
    found = [group for group, edge in zip(groups, edges, strict=True) if edge or next(answers)]
    found = _without_waits(runs, stops, xyz, found)
    found += _by_signals(runs, stops, xyz, [*members, *found])
    for number, group in enumerate(sorted(found, key=lambda g: int(g.min())), 1):
        centre = np.median(xyz[group], axis=0)
        places[f"place_{number}"] = Place(f"place_{number}", _triple(centre), _radius(xyz[group], centre), True)
    return places


def _without_waits(runs: Sequence[Run], stops: Sequence[Standstill], xyz: Points, groups: Sequence[Ints]) -> list[Ints]:
    """Return the groups of standstills without those at positions where the robot only waits.

    At such a position, it passes without a stop if it need not wait, and its standstills vary widely, or are few.
    """
    asked = [
        OFTEN_PASSED if len(group) < FEW else PASSED if evenness(runs, stops, group) < VARIES else None
        for group in groups
    ]
    centres = [np.median(xyz[group], axis=0) for group, least in zip(groups, asked, strict=True) if least is not None]
    passes = iter(count_passes(runs, np.array(centres).reshape(-1, 3)).tolist())
    kept = []
    for group, least in zip(groups, asked, strict=True):
        near = np.linalg.norm(xyz - np.median(xyz[group], axis=0), axis=1) <= MERGE_M
        if least is None or next(passes) < least * np.count_nonzero(near):
            kept.append(group)
    return kept


def evenness(runs: Sequence[Run], stops: Sequence[Standstill], group: Ints) -> float:
    """Return the ratio of short (10 % quantile) to long (90 % quantile) standstills of a group, 0 to 1."""
    ends = [(runs[stops[i].run], stops[i]) for i in group.tolist()]
    short_s, long_s = np.quantile([run.time_at(stop.last) - run.time_at(stop.first) for run, stop in ends], (0.1, 0.9))
    return float(short_s / long_s) if long_s > 0 else 1.0


def _by_signals(runs: Sequence[Run], stops: Sequence[Standstill], xyz: Points, known: Sequence[Ints]) -> list[Ints]:
    """Return groups of standstills in which signals change that mark work at `known` places."""
    telling = _of_work(runs, stops, known)
    if not telling:
        return []
    rests = np.array([not stop.edge for stop in stops], bool)
    for group in known:
        if len(group):
            rests &= np.linalg.norm(xyz - np.median(xyz[group], axis=0), axis=1) > MERGE_M
    works = rests & np.array([bool(telling & stop.changes.keys()) for stop in stops], bool)
    groups = cluster(xyz, np.flatnonzero(works), MERGE_M)
    near = [np.linalg.norm(xyz[rests] - np.median(xyz[group], axis=0), axis=1) <= MERGE_M for group in groups]
    return [group for group, here in zip(groups, near, strict=True) if 2 * len(group) >= np.count_nonzero(here)]


def _of_work(runs: Sequence[Run], stops: Sequence[Standstill], known: Sequence[Ints]) -> set[str]:
    """Return the signals that mark work; see WORKS."""
    total, inside = Counter[str](), Counter[str]()
    for run in runs:
        total.update({name: len(times) for name, times in run.changes.items()})
    for stop in stops:
        inside.update(stop.changes)
    steady: set[str] = set()
    for group in known:
        seen = Counter(name for i in group.tolist() for name in stops[i].changes)
        steady |= {name for name, many in seen.items() if len(group) >= 3 and many >= WORKS_AT * len(group)}
    return {name for name in steady if inside[name] >= WORKS * total[name]}


def _common_edge(stops: Sequence[Standstill], xyz: Points) -> Ints:
    """Return the edges of recordings at a common position, if at least two and the majority share it; else none."""
    edges = np.flatnonzero(np.array([stop.edge for stop in stops], bool))
    largest = max(cluster(xyz, edges, MERGE_M), key=len, default=edges)
    return largest if len(largest) >= 2 and 2 * len(largest) > len(edges) else edges[:0]


def _triple(xyz: Vector) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 6) for v in xyz)
    return x, y, z


def _radius(members: Points, centre: Vector) -> float:
    """Return the radius of a place, m: just the robot's repeatability, so that a stop just before it is excluded."""
    spread = float(np.median(np.linalg.norm(members - centre, axis=1))) if len(members) else MERGE_M
    return round(min(max(6.0 * spread, 5e-4), MERGE_M), 6)


def cluster(xyz: Points, rows: Ints, radius_m: float) -> list[Ints]:
    """Group positions within `radius_m` of the densest centres, densest first; unknown positions are in no group.

    The result does not depend on the axes: a centre is the median of all positions within half the radius of the one
    with the most neighbours.

    Args:
        xyz: Positions, shape (M, 3), m.
        rows: Indices of the positions to group.
        radius_m: Radius of a group around its centre.
    """
    from scipy.spatial import cKDTree  # slow to import, and only needed to look for places

    groups: list[Ints] = []
    rows = rows[np.isfinite(xyz[rows]).all(axis=1)]
    if not len(rows):
        return groups
    points = xyz[rows]
    tree = cKDTree(points)
    counted = cKDTree(points[:: math.ceil(len(points) / COUNTED)])
    dense = counted.query_ball_point(points, 0.5 * radius_m, return_length=True)
    left = np.ones(len(rows), dtype=np.bool_)
    for seed in np.argsort(-dense, kind="stable").tolist():
        if not left[seed]:
            continue
        around = np.array(tree.query_ball_point(points[seed], 0.5 * radius_m), dtype=np.int64)
        core = np.median(points[around[left[around]]], axis=0)
        near = np.array(tree.query_ball_point(core, radius_m), dtype=np.int64)
        near = np.union1d(near[left[near]], [seed])
        groups.append(rows[near])
        left[near] = False
    return groups


def _are_places(runs: Sequence[Run], stops: Sequence[Standstill], xyz: Points, groups: Sequence[Ints]) -> list[bool]:
    """Return which groups of standstills are places."""
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
            off_m = np.median(np.linalg.norm(xyz[group] - centre, axis=1))
            even = len(group) >= OFTEN and off_m <= EXACT_M and evenness(runs, stops, group) >= EVEN
            answers.append(bool(len(group) >= 0.8 * next(passes) or even))
    return answers


def count_passes(runs: Sequence[Run], centres: Points) -> Ints:
    """Return how often the robot comes within MERGE_M of each centre (C, 3), with or without a stop, shape (C,)."""
    counts = np.zeros(len(centres), np.int64)
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = _packed(_cell(centres)[:, None] + around[None]).ravel()  # all cells that each centre reaches into
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


def _near(xyz_m: Points, centres: Points, cells: Ints, owners: Ints) -> tuple[Ints, Ints]:
    """Return pairs of centre and row within MERGE_M of each other, sorted by centre and row.

    Args:
        xyz_m: Positions, shape (T, 3), m.
        centres: Centres, shape (C, 3), m.
        cells: Cells that they reach into, ascending.
        owners: Index of the centre of each cell.
    """
    known = np.flatnonzero(np.isfinite(xyz_m).all(axis=1))
    cell = _packed(_cell(xyz_m[known]))
    first, end = np.searchsorted(cells, cell, side="left"), np.searchsorted(cells, cell, side="right")
    many = end - first
    row = np.repeat(known, many)
    within = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
    spot = owners[np.repeat(first, many) + within]
    near = np.linalg.norm(xyz_m[row] - centres[spot], axis=1) <= MERGE_M
    order = np.lexsort((row[near], spot[near]))
    return spot[near][order], row[near][order]


def _cell(xyz_m: Points) -> Ints:
    """Return the cube of edge MERGE_M of each position (..., 3) as integers, shape (..., 3).

    Neighbours are found by these integers, as rounding of 0.61 / 0.01 or 0.60 / 0.01 may shift a position.
    """
    return np.asarray(np.floor(xyz_m / MERGE_M).astype(np.int64))


def _packed(index: Ints) -> Ints:
    """Return one integer for each cube (..., 3), shape (...)."""
    index = index + (1 << 20)
    return np.asarray((index[..., 0] << 42) + (index[..., 1] << 21) + index[..., 2])


SLOW = 0.1
"""Maximum speed at a turn, as fraction of the usual speed (90 % quantile)."""
APART_S = 0.5
"""Maximum time, s, between slow rows of one turn, and maximum duration of a turn at which the robot goes on."""


def with_turns(runs: Sequence[Run], stops: Sequence[Standstill]) -> list[Standstill]:
    """Return the standstills, and the turns at positions with more than one turn or standstill, in order.

    Such a turn counts as at the standstills there, or at the middle of the turns: where the robot is pushed or rings,
    each is some millimetres off.

    Args:
        runs: All runs.
        stops: Their standstills.
    """
    turns = [turn for number, run in enumerate(runs) for turn in _turns(run, number, stops)]
    both = [*stops, *turns]
    xyz = np.array([stop.xyz_m for stop in both]).reshape(-1, 3)
    kept = list(stops)
    for group in cluster(xyz, np.arange(len(both)), MERGE_M):
        if len(group) > 1:
            rests = group[group < len(stops)]
            middle = _triple(np.median(xyz[rests if len(rests) else group], axis=0))
            kept += [replace(both[i], xyz_m=middle) for i in group.tolist() if i >= len(stops)]
    return sorted(kept, key=lambda stop: (stop.run, stop.first))


def _turns(run: Run, number: int, stops: Sequence[Standstill]) -> list[Standstill]:
    """Return where speed falls nearly to zero and rises again: at once, or at one position, though never at rest.

    A robot that is pushed where it stands, or rings there, is never at rest.
    """
    rests = [stop.first for stop in stops if stop.run == number and not stop.edge]
    found = []
    for begin, part in pieces(run):
        speed = part.speed_m_s
        usual = float(np.nanquantile(speed, 0.9)) if np.isfinite(speed).any() else 0.0
        slow = np.flatnonzero(speed < SLOW * usual)
        groups = np.split(slow, np.flatnonzero(np.diff(part.t_s[slow]) > APART_S) + 1) if len(slow) else []
        for rows in groups:
            first, last = int(rows[0]), int(rows[-1])
            if first == 0 or last == part.rows - 1:
                continue  # an edge
            row = int(rows[int(speed[rows].argmin())])
            xyz = _triple(part.xyz_m[row])
            if part.t_s[last] - part.t_s[first] <= APART_S:
                found.append(Standstill(number, begin + row, begin + row, xyz, free=True))
            elif bisect_left(rests, begin + first) == bisect_right(rests, begin + last):
                away = np.linalg.norm(part.xyz_m[first : last + 1] - part.xyz_m[row], axis=1)
                if float(away.max()) <= MERGE_M:
                    found.append(Standstill(number, begin + first, begin + last, xyz, free=True))
    return found
