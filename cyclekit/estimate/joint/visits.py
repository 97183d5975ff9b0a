"""What the operator did in the logs: his visits, and his positions on each walk and stay, to be drawn again."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.tracks import logged_tracks
from cyclekit.people.tracks import SPOT_M, find_stays

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Ints, Vector

AT_START_S = 0.5
"""Who stands at a place this soon after the start of an execution has not walked there."""
WALK_M_S = 1.2
"""Of an operator whose walks were never logged."""
STRAIGHT = 16
"""So many straight walks of different speed stand for a way that was never logged."""


@dataclass(frozen=True)
class OperatorVisit:
    """One stay of the operator at one of his places; times from the start of the execution, s."""

    place: str
    arrives_s: float
    leaves_s: float


class Segments:
    """Positions of the operator on logged walks and stays, each by its number.

    Attributes:
        orders: His visits in each execution, by its name.
        speeds_m_s: Of his logged walks from place to place, straight distance over time, shape (N,).
    """

    def __init__(self, dataset: Dataset) -> None:
        """Cut the logged tracks of complete executions into walks and stays."""
        self._step_s = 1.0 / dataset.rate_hz
        self._places = dataset.human_places
        self._parts: list[Floats] = []
        self._ways: dict[tuple[str, str], list[int]] = defaultdict(list)
        self._stays: dict[str, list[int]] = defaultdict(list)
        self._begins: list[Floats] = []
        self.orders: dict[str, tuple[OperatorVisit, ...]] = {}
        complete = {one.execution for one in dataset.card.executions if one.complete and not one.reference}
        for name, track in logged_tracks(dataset).items():
            if name in complete and track.seen:
                self._cut(name, track.where[:, :3])
        self.speeds_m_s = self._speeds()

    def walk(self, start: str, goal: str) -> Ints:
        """Return the numbers of walks between two places; `start` is empty where he is at the start of an execution.

        Of a way that was never logged they are straight, at his logged speeds.
        """
        found = self._ways.get((start, goal))
        if found is None:
            found = self._ways[start, goal] = self._straight(start, goal)
        return np.array(found)

    def stay(self, place: str) -> Ints:
        """Return the numbers of stays at a place; one at its middle where none was logged."""
        if not self._stays[place]:
            self._stays[place].append(self._add(np.array([self._places[place].xyz_m])))
        return np.array(self._stays[place])

    def table(self) -> tuple[Floats, Ints, Ints]:
        """Return the positions of all segments one after the other (M, 3), and of each its first row and their count.

        The row after the last one of a segment repeats it: who stands on after it stands still.
        """
        count = np.array([len(part) for part in self._parts])
        rows = [np.concatenate([part, part[-1:]]) for part in self._parts]
        return np.concatenate(rows), np.cumsum(count + 1) - count - 1, count

    def durations_s(self, numbers: Ints) -> Vector:
        """Return how long segments take, shape (N,), s."""
        return np.array([(len(self._parts[number]) - 1) * self._step_s for number in numbers.tolist()])

    def work_s(self, place: str) -> Vector:
        """Return how long he stayed at a place, ascending, shape (N,), s; without stays cut by an execution's ends."""
        found = [
            visit.leaves_s - visit.arrives_s
            for order in self.orders.values()
            for visit in order[:-1]
            if visit.place == place and visit.arrives_s > 0.0
        ]
        return np.sort(found)

    def _cut(self, name: str, where: Floats) -> None:
        spans = self._spans(where)
        if not spans:
            return
        self._begins.append(where[0])
        self.orders[name] = tuple(
            OperatorVisit(place, a * self._step_s if a * self._step_s > AT_START_S else 0.0, b * self._step_s)
            for place, a, b in spans
        )
        for place, first, last in spans:
            self._stays[place].append(self._add(where[first : last + 1]))
        there = spans[0][1] * self._step_s <= AT_START_S
        self._ways["", spans[0][0]].append(self._add(where[spans[0][1] if there else 0 : spans[0][1] + 1]))
        if there and len(spans) > 1:  # a plan may begin with his second place
            self._ways["", spans[1][0]].append(self._add(where[: spans[1][1] + 1]))
        for (start, _, left), (goal, arrives, _) in pairwise(spans):
            self._ways[start, goal].append(self._add(where[left : arrives + 1]))

    def _spans(self, where: Floats) -> list[tuple[str, int, int]]:
        """Return place, first and last row of each visit; stays at one place without another between are one visit."""
        names, found = list(self._places), list[tuple[str, int, int]]()
        centres = np.array([self._places[name].xyz_m[:2] for name in names]).reshape(-1, 2)
        for first, last in find_stays(np.arange(len(where), dtype=np.float64) * self._step_s, where):
            away = np.linalg.norm(centres - np.median(where[first : last + 1, :2], axis=0), axis=1)
            if not len(away) or away.min() > SPOT_M:
                continue
            place = names[int(away.argmin())]
            if found and found[-1][0] == place:
                first = found.pop()[1]
            found.append((place, first, last))
        return found

    def _add(self, rows: Floats) -> int:
        self._parts.append(rows)
        return len(self._parts) - 1

    def _speeds(self) -> Vector:
        found = []
        for (start, goal), numbers in self._ways.items():
            if start and start != goal:
                for part in (self._parts[number] for number in numbers):
                    far = float(np.linalg.norm(part[-1, :2] - part[0, :2]))
                    found.append(far / max((len(part) - 1) * self._step_s, self._step_s))
        return np.sort(found) if found else np.array([WALK_M_S])

    def _straight(self, start: str, goal: str) -> list[int]:
        end, level = np.array(self._places[goal].xyz_m), (np.arange(STRAIGHT) + 0.5) / STRAIGHT
        begins = [np.array(self._places[start].xyz_m)] if start else self._begins or [end]
        found = []
        for number, speed in enumerate(np.quantile(self.speeds_m_s, level).tolist()):
            begin = begins[number * len(begins) // STRAIGHT]
            far = float(np.linalg.norm(end[:2] - begin[:2]))
            rows = max(1, round(far / max(speed, 0.1) / self._step_s)) if start != goal else 0
            found.append(self._add(begin + (end - begin) * np.linspace(0.0, 1.0, rows + 1)[:, None]))
        return found


def orders_of(segments: Segments) -> Mapping[tuple[str, ...], Sequence[str]]:
    """Return the executions in which the operator visited the same places in the same order, by that order."""
    found: dict[tuple[str, ...], list[str]] = {}
    for name, visits in segments.orders.items():
        found.setdefault(tuple(visit.place for visit in visits), []).append(name)
    return found
