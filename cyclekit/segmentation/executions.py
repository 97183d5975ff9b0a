"""Visits to places and executions, from the robot's standstills.

The time lost by slow-downs is computed in `time_account`; the operator is handled in `people`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import UnknownName
from cyclekit.segmentation.places import MERGE_M
from cyclekit.segmentation.stored_run import Run, pieces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import Executions
    from cyclekit.dataset.dataset import Place
    from cyclekit.schema import Ints
    from cyclekit.segmentation.standstills import Standstill


HOME = "home"
"""Where executions begin unless the cell file says otherwise, if a place has this name: only people name places so."""


@dataclass(frozen=True)
class Visit:
    """A standstill (or several joined) at a place, rows `first`..`last` of its run.

    `reached`: first and last row at the waiting position on the way there; None without one.
    """

    place: str
    first: int
    last: int
    reached: tuple[int, int] | None = None


@dataclass(frozen=True)
class Execution:
    """Consecutive visits of one run that form one execution of the process.

    `cut`: the end of the log cuts it; `waits`: in a wait short of a place: the place, first and last row there.
    """

    run: int
    visits: tuple[Visit, ...]
    complete: bool
    cut: bool = False
    waits: tuple[str, int, int] | None = None


def find_visits(stops: Sequence[Standstill], places: Mapping[str, Place], runs: Sequence[Run]) -> list[list[Visit]]:
    """Return the visits to places of each run, in order; standstills at a place without leaving it are one visit."""
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
    visits: Sequence[Sequence[Visit]], places: Mapping[str, Place], how: Executions, marks: Sequence[Ints]
) -> list[Execution]:
    """Split the visits of each run into executions by the rule of the cell file.

    An execution goes from the departure at its first visit to the arrival at its last; consecutive ones share a visit.
    It is complete, unless executions are split by home, or half of the logs begin and end there, and it does not: one
    that ends elsewhere is cut by the end of the log.

    Args:
        visits: Visits of each run, in order.
        places: All places, for the message.
        how: Rule for the start of an execution.
        marks: Rows of each run at which a logged signal marks the start of an execution.

    Raises:
        UnknownName: `how.home` is not a place of this cell.
    """
    if how.home is not None and how.home not in places:
        raise UnknownName("cell.toml [executions] home", "place", how.home, places)
    firsts = [seen[0].place for seen in visits if seen]
    named = HOME if any(visit.place == HOME for seen in visits for visit in seen) else None
    home = how.home or named or max(sorted(set(firsts)), key=firsts.count, default="")
    walked = [seen for seen in visits if len(seen) > 1]
    returned = sum(seen[0].place == home == seen[-1].place for seen in walked)
    found = []
    for number, (seen, marked) in enumerate(zip(visits, marks, strict=True)):
        cuts = _begins(seen, how, home, marked)
        by_home = how.begin in {"auto", "home"} and (len(cuts) > 2 or 2 * returned >= len(walked) > 0)
        for a, b in pairwise(cuts):
            begun, ended = (not by_home or seen[at].place == home for at in (a, b))
            found.append(Execution(number, tuple(seen[a : b + 1]), begun and ended, not ended))
    return found


def _begins(seen: Sequence[Visit], how: Executions, home: str, marked: Ints) -> list[int]:
    """Return the indices of the visits at which an execution starts, and of the last visit, ascending."""
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
