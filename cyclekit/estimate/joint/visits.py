"""The operator's logged visits, and his positions on each walk and stay, from which rollouts draw."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.cards.dataset import begun
from cyclekit.estimate.joint.long_stays import parted_stays, unseen_walks
from cyclekit.estimate.joint.stop_overs import StopOvers
from cyclekit.estimate.operator.tracks import logged_tracks
from cyclekit.learning.censored import as_whole
from cyclekit.learning.coupling.events.errands import joined
from cyclekit.learning.coupling.events.trips import LONG, LONG_S, part_trips, usual_walks_s
from cyclekit.learning.coupling.events.visits import PlaceVisit
from cyclekit.learning.coupling.pace.own_work import AT_START_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import LoggedTrack
    from cyclekit.schema import Floats, Ints, Vector

WALK_M_S = 1.2
"""Walking speed, m/s, of an operator whose walks were never logged."""
MIN_WALKS, MIN_M = 10, 0.1
"""Minimum number of walks, and minimum standard deviation of their lengths, m, to fit durations of other walks."""
SURE = 3.0
"""Threshold, standard errors, for a significant difference between two means. A statistical level: half and twice of it
give the same cycle times with the fixture of the contract, 20 executions."""
STANDS_M = 0.15
"""Maximum distance, m, from his last position at which the operator stands there."""
MIN_FIRST = 3
"""Minimum number of executions that begin with a place; with fewer, those with it as second place count as well."""
MIN_OFTEN = 5
"""Minimum number of walks on a way, below which those that took too long do not count."""
STRAIGHT = 16
"""Number of straight walks of different duration generated for a way that was never logged."""


class Segments:
    """Numbered segments: the operator's positions on logged walks and stays, and on trips while he waits.

    Attributes:
        orders: The visits in each whole execution, one for each task, by its name.
        stop_overs: Places by which he went from one to another of these.
    """

    def __init__(
        self,
        dataset: Dataset,
        coupling: CouplingCard | None = None,
        paces: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Cut the logged tracks of begun executions into walks, stays and the trips that are known.

        Args:
            dataset: The logs.
            coupling: Who waits for whom.
            paces: Duration of work and of walks in an execution relative to now, by its name; not named: as now.
        """
        self._paces_of = paces or {}
        self._step_s = 1.0 / dataset.rate_hz
        self._places = dataset.human_places
        self._parts: list[Floats] = []
        self._stretch: list[float] = []
        self._ways: dict[tuple[str, str], list[int]] = defaultdict(list)
        self._later: dict[str, list[int]] = defaultdict(list)
        self._stays: dict[str, list[int]] = defaultdict(list)
        self._begins: list[Floats] = []
        self._first_stays: dict[str, list[float]] = defaultdict(list)
        self._trips: dict[str, list[int]] = defaultdict(list)
        self._after: dict[str, list[int]] = defaultdict(list)
        every_gate = coupling.gates if coupling is not None else ()
        gates = [gate for gate in every_gate if gate.trip is not None]
        self._trips_at = {(gate.at, gate.place) for gate in gates}
        self._after_s = max((gate.trip.after_s for gate in gates if gate.trip is not None), default=0.0)
        self.trip_places = {place for gate in gates if gate.trip is not None for place in gate.trip.places}
        errands = coupling.errands if coupling is not None else ()
        self._spots = {gate.wait_at for gate in every_gate if gate.wait_at}
        self._waits_before = {
            gate.place for gate in every_gate if gate.conditions and (gate.agent, gate.at) == ("operator", "approach")
        }
        self._visits: dict[str, tuple[PlaceVisit, ...]] = {}
        cards = dataset.card.executions
        self._whole = {one.execution for one in cards if one.whole and not one.reference}
        known = {one.execution for one in begun(cards) if not one.reference}
        tracks = logged_tracks(dataset)
        mine = dataset.every_task().filter((pl.col("agent") == "operator") & pl.col("agent_name").is_null())
        every: dict[str, list[PlaceVisit]] = {}
        cut_off: list[tuple[str, PlaceVisit, PlaceVisit]] = []
        for (name,), visits in mine.sort("execution", "index").group_by(["execution"], maintain_order=True):
            if name in known and str(name) in tracks and tracks[str(name)].seen:
                every[str(name)] = joined(self._seen(tracks[str(name)], visits), errands)
                cut_off += [(str(name), *both) for both in self._cut_off(tracks[str(name)], visits, errands)]
        walks_s = usual_walks_s(list(every.values())) if gates else {}
        for name, seen in every.items():
            self._cut(name, tracks[name], seen, walks_s)
        self.orders = self._tasks()
        self._add_unseen(tracks)
        self.stop_overs = StopOvers(tuple(visit.place for visit in visits) for visits in self.orders.values())
        self._pace = self._paces()
        self._add_cut_off(cut_off, tracks)
        self._drop_longer()

    def walk(self, start: str, goal: str) -> Ints:
        """Return the numbers of walks between two places; `start` is empty at the start of an execution.

        For a way that was never logged, straight walks with the usual duration for their length are generated.
        """
        found = self._ways.get((start, goal))
        if start == "" and len(found or []) < MIN_FIRST and self._later[goal]:
            found = [*(found or []), *self._later[goal]]
        if found is None:
            found = self._ways[start, goal] = self._straight(start, goal)
        return np.array(found)

    def stay(self, place: str) -> Ints:
        """Return the numbers of stays at a place; without any, of a generated one at its centre."""
        if not self._stays[place]:
            self._stays[place].append(self._add(np.array([self._places[place].xyz_m])))
        return np.array(self._stays[place])

    def after(self, place: str) -> Ints:
        """Return the numbers of what followed the last task of executions at a place; without any, of stays there.

        Where executions did not end there, but at a stop-over after it, he goes to that.
        """
        stop = self.stop_overs.at_end(place)
        found = self._ways.get((place, stop)) if stop else self._after[place]
        return np.array(found) if found else self.stay(place)

    def table(self) -> tuple[Floats, Ints, Ints]:
        """Return the positions of all segments concatenated (M, 3), and the first row and row count of each.

        The last row of a segment is repeated after it: the operator stands still there.
        """
        count = np.array([len(part) for part in self._parts])
        rows = [np.concatenate([part, part[-1:]]) for part in self._parts]
        return np.concatenate(rows), np.cumsum(count + 1) - count - 1, count

    def durations_s(self, numbers: Ints) -> Vector:
        """Return the durations of segments, shape (N,), s."""
        steps = [(len(self._parts[number]) - 1) * self._stretch[number] for number in numbers.tolist()]
        return self._step_s * np.array(steps)

    @property
    def stretch(self) -> Vector:
        """Duration of each segment now relative to the logged one, shape (segments,)."""
        return np.array(self._stretch)

    def work_s(self, place: str) -> Vector:
        """Return durations of stays at a place, ascending, shape (N,), s, except those begun before their execution.

        One that the end of its execution cuts lasted at least so long; a place where all are cut has none. Two
        consecutive tasks at one place appear as one long stay. Executions with the most stays there have no such
        stays: if their stays are significantly shorter, only these are used.
        """
        stays, single = self._single(place)
        if single is not None:
            return np.sort(single)
        cut = [(visits[-1], self._pace_of(name)[0]) for name, visits in self._visits.items() if visits]
        cut_s = [
            (visit.left_s - visit.arrived_s) / pace
            for visit, pace in cut
            if visit.place == place and visit.arrived_s > 0.0
        ]
        if not len(stays):
            return stays
        return as_whole(np.append(stays, cut_s), np.repeat([False, True], [len(stays), len(cut_s)]))

    def _single(self, place: str) -> tuple[Vector, Vector | None]:
        """Return all stays at a place, and those of executions with the most of them, if significantly shorter, s."""
        stays: list[tuple[int, float]] = []
        for name, visits in self._visits.items():
            times, (pace, _) = sum(visit.place == place for visit in visits), self._pace_of(name)
            mine = [visit for visit in visits[:-1] if visit.place == place and visit.arrived_s > 0.0]
            stays += [(times, (visit.left_s - visit.arrived_s) / pace) for visit in mine]
        most, every = max((times for times, _ in stays), default=0), np.array([s for _, s in stays])
        single, others = (np.array([s for n, s in stays if (n == most) is alone]) for alone in (True, False))
        if min(len(single), len(others)) >= MIN_WALKS:
            chance = np.hypot(single.std(ddof=1) / len(single) ** 0.5, others.std(ddof=1) / len(others) ** 0.5)
            if others.mean() - single.mean() > SURE * chance:
                return every, single
        return every, None

    def _tasks(self) -> dict[str, tuple[PlaceVisit, ...]]:
        """Return the visits in each execution, with stays of several consecutive tasks at one place as so many visits.

        No execution then has more visits to the place than the most that were logged, and none is shorter than all.
        """
        found = dict(self._visits)
        for place in {visit.place for visits in found.values() for visit in visits}:
            single = self._single(place)[1]
            if single is None:
                continue
            most = max(sum(visit.place == place for visit in visits) for visits in found.values())
            for name, visits in found.items():
                found[name] = parted_stays(visits, place, most, float(single.min()))
        return {
            name: tuple(visit for visit in visits if visit.place not in self._spots)
            for name, visits in found.items()
            if name in self._whole
        }

    def _add_unseen(self, tracks: Mapping[str, LoggedTrack]) -> None:
        """Store the walks between consecutive tasks at one place that appear as one long stay.

        They are shorter than those that are seen; a stay that lasts longer than that has another cause, such as a wait.
        """
        for place in self._places:
            single, seen = self._single(place)[1], self._ways.get((place, place))
            if single is None or not seen:
                continue
            longest_s = float(self.durations_s(np.array(seen)).max())
            walks = unseen_walks(self.orders, place, float(single.mean()), lambda name: self._pace_of(name)[0])
            for name, begin_s, took_s in walks:
                pace = self._pace_of(name)[1]
                first, last = (max(self._row(at_s), 0) for at_s in (begin_s, begin_s + took_s * pace))
                if took_s <= longest_s:
                    seen.append(self._add(tracks[name].where[first : last + 1, :3], pace))

    def first_stays_s(self, place: str) -> Vector:
        """Return durations of stays at a place at the start of an execution, ascending, shape (N,), s."""
        return np.sort(self._first_stays[place])

    def trip(self, place: str) -> Ints:
        """Return the numbers of trips from a place; if there are none, of all trips."""
        found = self._trips.get(place) or [number for some in self._trips.values() for number in some]
        return np.array(found, dtype=np.int64)

    def _seen(self, track: LoggedTrack, visits: pl.DataFrame) -> list[PlaceVisit]:
        """Return the visits to known places in one execution, from the first row of its track to the last, s."""
        last_s, found = (len(track.where) - 1) * self._step_s, []
        for place, arrives_s, leaves_s in visits.select("goal_place", "arrival_s", "end_s").iter_rows():
            first_s = 0.0 if arrives_s is None else max(arrives_s - track.begin_s, 0.0)
            left_s = last_s if leaves_s is None else min(leaves_s - track.begin_s, last_s)
            if place in self._places and first_s <= left_s:
                found.append(PlaceVisit(place, first_s, left_s))
        return found

    def _cut_off(
        self, track: LoggedTrack, visits: pl.DataFrame, errands: Sequence[str]
    ) -> list[tuple[PlaceVisit, PlaceVisit]]:
        """Return the visits before and after each walk that ended after its execution; times as in `_seen`.

        Trips, errands and waits at spots are left out.
        """
        last_s, known = (len(track.where) - 1) * self._step_s, set(self._places) - self.trip_places - self._spots
        every = [
            PlaceVisit(place, arrives_s - track.begin_s, np.nan if leaves_s is None else leaves_s - track.begin_s)
            for place, arrives_s, leaves_s in visits.select("goal_place", "arrival_s", "end_s").iter_rows()
            if arrives_s is not None
        ]
        return [
            (before, after)
            for before, after in pairwise(every)
            if after.arrived_s > last_s
            and after.arrived_s > before.left_s
            and before.place != after.place
            and {before.place, after.place} <= known - set(errands)
        ]

    def _add_cut_off(
        self, walks: Sequence[tuple[str, PlaceVisit, PlaceVisit]], tracks: Mapping[str, LoggedTrack]
    ) -> None:
        """Store walks that ended after their execution: without them, long ones would be missing.

        He may have idled on the way, as the cycle was over: long ones do not count, and those that began after the end
        only between places with few other walks. His position after the end is assumed on the straight way.
        """
        least_s, per_m, _ = self._pace
        later: list[tuple[tuple[str, str], Floats, float]] = []
        for name, before, after in walks:
            way, took_s = (before.place, after.place), after.arrived_s - before.left_s
            begin, end = (np.array(self._places[place].xyz_m) for place in way)
            if took_s > LONG * (least_s + per_m * float(np.linalg.norm((end - begin)[:2]))) + LONG_S:
                continue
            seen, pace = tracks[name].where[max(self._row(before.left_s), 0) :, :3], self._pace_of(name)[1]
            path = seen if len(seen) else begin[None]
            rows = max(self._row(took_s) + 1 - len(path), 1)
            path = np.concatenate([path, path[-1] + (end - path[-1]) * (np.arange(1, rows + 1) / rows)[:, None]])
            if len(seen):
                self._ways[way].append(self._add(path, pace))
            else:
                later.append((way, path, pace))
        few = {way for way, _, _ in later if len(self._ways[way]) < MIN_WALKS}
        for way, path, pace in later:
            if way in few:
                self._ways[way].append(self._add(path, pace))

    def _pace_of(self, name: str) -> tuple[float, float]:
        return self._paces_of.get(name, (1.0, 1.0))

    def _row(self, at_s: float) -> int:
        return round(at_s / self._step_s)

    def _cut(
        self, name: str, track: LoggedTrack, seen: Sequence[PlaceVisit], walks_s: Mapping[tuple[str, str], float]
    ) -> None:
        where, (work, walk) = track.where[:, :3], self._pace_of(name)
        visits, trips = part_trips(seen, self.trip_places, walks_s, self._trips_at, self._after_s)
        spans = [(visit.place, self._row(visit.arrived_s), self._row(visit.left_s)) for visit in visits]
        for number, trip in trips.items():
            went, back = self._row(trip.left_s), self._row(trip.back_s)
            self._trips[visits[number].place].append(self._add(where[went : back + 1]))
        if not spans:
            return
        self._begins.append(where[0])
        at_s = [(place, a * self._step_s, b * self._step_s) for place, a, b in spans]
        self._visits[name] = tuple(PlaceVisit(place, a if a > AT_START_S else 0.0, b) for place, a, b in at_s)
        for number, (place, first, left) in enumerate(spans):
            end = self._row(trips[number].left_s) if number in trips else left
            self._stays[place].append(self._add(where[first : end + 1]))
        worked = [span for span in spans if span[0] not in self._spots]
        if worked and name in self._whole:
            self._after[worked[-1][0]].append(self._add(_until_he_stands(where[worked[-1][2] :]), walk))
        there = at_s[0][1] <= AT_START_S
        self._begin(where, spans, (work, walk), there=there)
        self._ways["", spans[0][0]].append(self._add(where[spans[0][1] if there else 0 : spans[0][1] + 1], walk))
        if there and len(spans) > 1:  # a plan may begin with the second place; a wait before it is none of its way
            goal, arrives, _ = spans[1]
            if spans[0][0] in self._spots:
                self._ways["", goal].append(self._add(where[spans[0][2] : arrives + 1], walk))
            else:
                begin = spans[0][2] if goal in self._waits_before else 0
                self._later[goal].append(self._add(where[begin : arrives + 1], walk))
        for number, ((start, _, left), (goal, arrives, _)) in enumerate(pairwise(spans)):
            if number not in trips:  # he may have come from the trip, on another way
                self._ways[start, goal].append(self._add(where[left : arrives + 1], walk))

    def _begin(
        self, where: Floats, spans: Sequence[tuple[str, int, int]], pace: tuple[float, float], *, there: bool
    ) -> None:
        """Store the initial stay, including one too short to be detected as a stay."""
        goal, arrives, left = spans[0]
        if there:
            if len(spans) > 1:
                self._first_stays[goal].append(left * self._step_s / pace[0])
            return
        for place, card in self._places.items():
            out = np.linalg.norm(where[: arrives + 1, :2] - np.array(card.xyz_m[:2]), axis=1) > card.radius_m
            if not out[0] and out.any():
                left = int(out.argmax())
                self._first_stays[place].append(left * self._step_s / pace[0])
                self._ways[place, goal].append(self._add(where[left : arrives + 1], pace[1]))
                return

    def _add(self, rows: Floats, pace: float = 1.0) -> int:
        """Store a segment in an execution in which it took `pace` times as long as now; return its number."""
        self._parts.append(rows)
        self._stretch.append(1.0 / pace)
        return len(self._parts) - 1

    def _paces(self) -> tuple[float, float, Vector]:
        """Return the duration of walks, s: constant part, time per metre, and quantiles of the residuals."""
        ways = [(way, number) for way, numbers in self._ways.items() if self._leads_on(way) for number in numbers]
        walks, far = [number for _, number in ways], np.array([self._far_m(*each) for each in ways])
        took = self.durations_s(np.array(walks, dtype=np.int64))
        if len(walks) < MIN_WALKS or far.std() < MIN_M:
            return 0.0, 1.0 / WALK_M_S, np.zeros(1)
        per_m = max(float(np.cov(far, took)[0, 1] / far.var(ddof=1)), 0.0)
        least = float(took.mean() - per_m * far.mean())
        return least, per_m, np.sort(took - least - per_m * far)

    def _leads_on(self, way: tuple[str, str]) -> bool:
        return bool(way[0]) and way[0] != way[1]

    def _far_m(self, way: tuple[str, str], number: int) -> float:
        """Return how far a walk led, m; by its places where the operator was not seen at both ends."""
        far_m = float(np.linalg.norm(self._parts[number][-1, :2] - self._parts[number][0, :2]))
        begin, end = (np.array(self._places[place].xyz_m[:2]) for place in way)
        return far_m if np.isfinite(far_m) else float(np.linalg.norm(end - begin))

    def _drop_longer(self) -> None:
        """Drop the walks of seldom ways that took much longer than usual: he was somewhere on them, and not seen."""
        least_s, per_m, beside_s = self._pace
        seldom = [way for way, numbers in self._ways.items() if self._leads_on(way) and len(numbers) < MIN_OFTEN]
        for way in seldom if len(beside_s) >= MIN_WALKS else ():
            numbers = self._ways[way]
            longest_s = [LONG * (least_s + per_m * self._far_m(way, number)) + LONG_S for number in numbers]
            took_s = self.durations_s(np.array(numbers, dtype=np.int64)).tolist()
            kept = [n for n, took, most in zip(numbers, took_s, longest_s, strict=True) if took <= most]
            if kept:
                self._ways[way] = kept
            else:
                del self._ways[way]

    def _straight(self, start: str, goal: str) -> list[int]:
        end, level = np.array(self._places[goal].xyz_m), (np.arange(STRAIGHT) + 0.5) / STRAIGHT
        begins = [np.array(self._places[start].xyz_m)] if start else self._begins or [end]
        least_s, per_m, beside_s = self._pace
        found = []
        for number, more_s in enumerate(np.quantile(beside_s, level).tolist()):
            begin = begins[number * len(begins) // STRAIGHT]
            took_s = least_s + per_m * float(np.linalg.norm(end[:2] - begin[:2])) + more_s
            rows = max(1, round(took_s / self._step_s)) if start != goal else 0
            found.append(self._add(begin + (end - begin) * np.linspace(0.0, 1.0, rows + 1)[:, None]))
        return found


def _until_he_stands(where: Floats) -> Floats:
    """Return positions (N, 3) up to the first that is within STANDS_M of all later ones."""
    far = np.linalg.norm(where[:, :2] - where[-1, :2], axis=1) > STANDS_M
    return where[: len(far) - int(far[::-1].argmax()) + 1] if far.any() else where[-1:]
