"""The agendas of one agent as tables, and the random draws of each cycle: own work, lags, walks."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.joint.levels import WALK, WORK, Levels
from cyclekit.learning.coupling.events.trips import soonest_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.dataset.cards import TripCard
    from cyclekit.dataset.cards.coupling import CommonPaceCard
    from cyclekit.estimate.joint.legs import Agenda, Event
    from cyclekit.estimate.joint.visits import Segments
    from cyclekit.schema import Floats, Ints, Vector

NEAR = 8
"""Number of logged trips with about the same wait from which one is drawn."""
NEVER = -np.inf
"""Time of an event that needs no wait; lag of an event that is not needed in this cycle."""


class EventColumns:
    """Column numbers of all events of several agendas."""

    def __init__(self, agendas: Iterable[Agenda]) -> None:
        """Number the events of agendas, plus two columns: one that is never waited for, and one that is never read."""
        self.events = list(dict.fromkeys(event for agenda in agendas for event, _ in agenda.events))
        self._number = {event: number for number, event in enumerate(self.events)}
        self.unneeded, self.unread = len(self.events), len(self.events) + 1

    def needed(self, event: Event) -> int:
        """Return the column of an event to wait for; an event of no agenda is not waited for."""
        return self._number.get(event, self.unneeded)

    def times(self, agendas: Sequence[tuple[Agenda, Ints]], count: int) -> Floats:
        """Return event times before the start, shape (count, columns), s: inf for events still to come.

        Args:
            agendas: Agendas, each with its rows.
            count: Number of rows.
        """
        times = np.full((count, len(self.events) + 2), NEVER)
        for agenda, rows in agendas:
            mine = np.array([self._number[event] for event, _ in agenda.events], np.int64)
            times[rows[:, None], mine] = np.inf
        return times

    def padded(self, groups: Sequence[Sequence[Sequence[Event]]]) -> Ints:
        """Return the columns of the events that legs set, shape (agendas, legs, events), padded with `unread`."""
        return _padded([[[self._number[e] for e in leg] for leg in legs] for legs in groups], self.unread)


def _padded(groups: Sequence[Sequence[Sequence[int]]], fill: int) -> Ints:
    legs = max(len(group) for group in groups)
    most = max((len(leg) for group in groups for leg in group), default=0)
    table = np.full((len(groups), legs, max(most, 1)), fill)
    for g, group in enumerate(groups):
        for n, leg in enumerate(group):
            table[g, n, : len(leg)] = leg
    return table


class TripTimes:
    """How long trips from a gate take, by when its conditions let the operator go on."""

    def __init__(self, trip: TripCard, pace: float = 1.0) -> None:
        """Take the logged trips; each takes `pace` times as long."""
        self._late_s, self._took_s = np.array(trip.late_s), pace * np.array(trip.took_s)

    def took_s(self, late_s: Vector, level: Vector) -> Vector:
        """Return durations, s, of logged trips in which he could have gone on about so long after their begin.

        Args:
            late_s: How long after their begin he could go on, shape (N,), s.
            level: Levels in (0, 1) that choose among these, shape (N,).
        """
        count = len(self._late_s)
        near = min(NEAR, count)
        first = np.clip(np.searchsorted(self._late_s, late_s) - near // 2, 0, count - near)
        some = np.sort(self._took_s[first[:, None] + np.arange(near)], axis=1)
        return np.asarray(some[np.arange(len(first)), np.minimum((level * near).astype(np.int64), near - 1)])


class CycleDraws:
    """N cycles of one agent: the agenda of each, and the random draws for its legs.

    Attributes:
        agendas: All agendas that occur.
        which: Agenda of each row, shape (N,).
        last: Number of the last leg of each agenda.
        own_s: Time of own work, shape (N, legs).
        lag_s: Lag from each needed event to departure, shape (N, legs, needs).
        needs: Columns of these events, shape (agendas, legs, needs); `unneeded` where there is none.
        not_before_s: Earliest departure, shape (agendas, legs).
        arrives, passes: Columns of the events that a leg sets, shape (agendas, legs, events).
        walk, stay: Numbers of the operator's segments, shape (N, legs).
        walk_s: Duration of the walks, shape (N, legs).
        after: Number of the segment that follows the last leg, shape (N,).
        straight, straight_s: The walk that leaves out the leg before, if nobody waits there, and its duration.
        if_waits: Legs to which the operator goes only if he has to wait, shape (agendas, legs).
        trip: Numbers of the operator's trips before departure, shape (N, legs).
        trip_level: Levels of their durations, shape (N, legs).
        trips: How long trips of each kind take.
        trip_kind: Which of these may be made before departure, shape (agendas, legs); -1 = none.
        soonest_s: Lag below which he does not go on, shape (agendas, legs, needs).
        trips_waiting, trips_free: Whether he makes one if he has to wait, and if not, shape (N, legs).
    """

    def __init__(
        self,
        agendas: Sequence[Agenda],
        which: Ints,
        turn: Ints,
        count: int,
        columns: EventColumns,
        seed: int,
        common: CommonPaceCard | None = None,
    ) -> None:
        """Draw for N rows.

        Args:
            agendas: All agendas that occur.
            which: Agenda of each row, shape (N,).
            turn: Number of each row's cycle among the `count` cycles of a question; draws are spread evenly over these
                and are the same for every question.
            count: Number of cycles of a question.
            columns: Columns of the events.
            seed: Seed of the draws.
            common: What durations of one cycle share; None: nothing.
        """
        self.agendas, self.which, self._turn = agendas, which, turn
        self._levels = Levels(seed, count, common)
        self.last = np.array([len(agenda.legs) - 1 for agenda in agendas])
        needs = [[[columns.needed(need.event) for need in leg.needs] for leg in agenda.legs] for agenda in agendas]
        self.needs, self.unneeded = _padded(needs, columns.unneeded), columns.unneeded
        legs, rows = int(self.last.max()) + 1, len(which)
        self.arrives = columns.padded([[leg.arrives for leg in agenda.legs] for agenda in agendas])
        self.passes = columns.padded([[leg.passes for leg in agenda.legs] for agenda in agendas])
        self.not_before_s = np.zeros((len(agendas), legs))
        self.own_s, self.lag_s = np.zeros((rows, legs)), np.zeros((rows, legs, self.needs.shape[2]))
        self.walk, self.stay = np.zeros((rows, legs), dtype=np.int64), np.zeros((rows, legs), dtype=np.int64)
        self.walk_s, self.after = np.zeros((rows, legs)), np.zeros(rows, dtype=np.int64)
        self.straight, self.straight_s = np.zeros((rows, legs), dtype=np.int64), np.zeros((rows, legs))
        self.if_waits = np.zeros((len(agendas), legs), dtype=np.bool_)
        self.trip, self.trip_level = np.zeros((rows, legs), dtype=np.int64), np.zeros((rows, legs))
        self.trips: dict[TripCard, TripTimes] = {}
        self.trip_kind = np.full((len(agendas), legs), -1)
        self.soonest_s = np.zeros(self.needs.shape)
        self.trips_waiting, self.trips_free = np.zeros((2, rows, legs), dtype=np.bool_)
        self._rows = [np.flatnonzero(which == number) for number in range(len(agendas))]
        for number, agenda in enumerate(agendas):
            self.not_before_s[number, : len(agenda.legs)] = [leg.not_before_s for leg in agenda.legs]
            self.if_waits[number, : len(agenda.legs)] = [leg.if_waits for leg in agenda.legs]
            self._draw_work(number, agenda)

    def _draw_work(self, which: int, agenda: Agenda) -> None:
        rows, turns = self._rows[which], Counter[str]()
        for number, leg in enumerate(agenda.legs):
            key = f"{agenda.agent} {leg.name}"
            share = self._levels.share_of(leg.own_s, WORK) if agenda.agent == "operator" else 0.0
            work = self._level(rows, key, turns[key], share)
            self.own_s[rows, number] = np.maximum(quantile(leg.own_s, work), min(leg.not_before_s, 0.0))
            for each, need in enumerate(leg.needs):
                self.soonest_s[which, number, each] = soonest_s(need.lag_s.tolist())
                level = self._level(rows, f"{key} after {need.event[:3]}", turns[key], need.common)
                lag_s = quantile(need.lag_s, level)
                if need.needed < 1.0:
                    own = (f"{key} needs {need.event[:3]}", turns[key])
                    chance = self._level(rows, *((f"together {need.together}", need.passage) if need.together else own))
                    lag_s = np.where(chance < need.needed, lag_s, NEVER)
                self.lag_s[rows, number, each] = lag_s
            turns[key] += 1

    def draw_segments(self, segments: Segments, pace: float = 1.0) -> None:
        """Draw the operator's walks and stays; walks take `pace` times the logged duration."""
        for number, agenda in enumerate(self.agendas):
            rows, turns = self._rows[number], Counter[str]()
            if last := agenda.legs[-1].place:
                self.after[rows] = chosen(segments.after(last), self._level(rows, f"after {last}", 0))
            for n, leg in enumerate(agenda.legs):
                key = f"walk {leg.start}->{leg.place}"
                if leg.start is not None:
                    before, way = agenda.legs[n - 1], self._walks(segments, leg.start, leg.place)
                    share = self._levels.share_of(segments.durations_s(way), WALK)
                    level = self._level(rows, key, turns[key], share, WALK)
                    self.walk[rows, n] = chosen(way, level)
                    self.walk_s[rows, n] = pace * segments.durations_s(self.walk[rows, n])
                    if before.if_waits and before.start is not None:
                        self.straight[rows, n] = chosen(self._walks(segments, before.start, leg.place), level)
                        self.straight_s[rows, n] = pace * segments.durations_s(self.straight[rows, n])
                if leg.place:
                    self.stay[rows, n] = chosen(segments.stay(leg.place), self._level(rows, f"stay {key}", turns[key]))
                if leg.trip is not None:
                    self.set_kind(number, n, leg.trip, pace)
                    trips = segments.trip(leg.place)
                    self._draw_trips(
                        rows, n, leg.trip, trips[np.argsort(segments.durations_s(trips))], (leg.name, turns[key])
                    )
                turns[key] += 1

    def set_kind(self, agenda: int, leg: int, trip: TripCard, pace: float) -> None:
        """Set the trips that may be made before departure from a leg; they take `pace` times as long as logged."""
        self.trips.setdefault(trip, TripTimes(trip, pace))
        self.trip_kind[agenda, leg] = list(self.trips).index(trip)

    def _draw_trips(self, rows: Ints, n: int, trip: TripCard, numbers: Ints, turn: tuple[str, int]) -> None:
        """Draw which of some trips, by duration, he makes before he departs from a leg, and whether he does."""
        self.trip_level[rows, n] = level = self._level(rows, f"trip from {turn[0]}", turn[1])
        self.trip[rows, n] = chosen(numbers, level) if len(numbers) else self.stay[rows, n]
        chance = self._level(rows, f"goes from {turn[0]}", turn[1])
        self.trips_waiting[rows, n], self.trips_free[rows, n] = chance < trip.waiting, chance < trip.free

    def _walks(self, segments: Segments, start: str, goal: str) -> Ints:
        """Return the walks between two places, the shortest first where walks of one cycle share something."""
        found = segments.walk(start, goal)
        return found[np.argsort(segments.durations_s(found), kind="stable")] if self._levels.in_walks else found

    @property
    def shared(self) -> Vector:
        """Normal scores of what the operator's durations share in each row, shape (N,)."""
        return self._levels.main[self._turn]

    def levels(self, key: str, turn: int) -> Vector:
        """Return a level in (0, 1) for each row: spread evenly over the cycles of a question, and shuffled."""
        return self._level(np.arange(len(self.which)), key, turn)

    def _level(self, rows: Ints, key: str, turn: int, share: float = 0.0, kind: str = WORK) -> Vector:
        return np.asarray(self._levels.alike(key, turn, share, kind)[self._turn[rows]])


def quantile(values: Vector, level: Vector) -> Vector:
    """Return quantiles of a distribution given by its quantiles at evenly spaced levels, shape of `level`."""
    levels = np.linspace(0.0, 1.0, max(len(values), 2))
    return np.asarray(np.interp(level, levels, values if len(values) > 1 else np.repeat(values, 2)))


def chosen(numbers: Ints, level: Vector) -> Ints:
    """Return one of `numbers` for each level in (0, 1)."""
    return np.asarray(numbers[np.minimum((level * len(numbers)).astype(np.int64), len(numbers) - 1)])
