"""What the operator does next: logged tracks continued by stretches of other logged tracks, for as long as asked.

A cycle may take longer than any log of the operator. Where a track ends, it goes on with a stretch of another track
that begins in the same state: what the operator does, where he is, how he moves, and for how long he has been at it
(or away). Of the tracks that come nearest one is drawn. A logged execution ends when the robot is done, which depends
on what the operator did before and not on what he does next; so what followed the same state elsewhere is a fair draw
of what follows here, however long or short the execution was that it comes from. (A block bootstrap with matched
blocks: Carlstein, Do, Hall, Hesterberg and Künsch, Bernoulli 4, 1998.) No state says everything, and a log ends more
often where its operator is away; so instants are weighed until all of the logs is used alike (`Continuation._weights`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Ints, Points, Vector


NEAR_M = 0.4
"""One unit of difference between two states: so far apart,"""
NEAR_M_S = 0.5
"""... so much faster,"""
PHASE_S = 10.0
"""... so much later since the cycle began, where the operator's habits begin with it,"""
ELAPSED = 2.0
"""... or at it for exp(1 / ELAPSED) times as long (times of seconds; below a second nothing differs)."""
OTHER_TASK = 5.0
"""Units by which two tasks of the operator differ."""
ITSELF = 5.0
"""Units by which a stretch of the very track that ends differs: it would be walked in a circle."""
AWAY = 100.0
"""Units by which being away differs from being there."""
STILL_M_S = 0.2
"""An operator slower than this stays."""
LONG_S = 60.0
"""For longer than this nobody needs to know how long he has been at it."""
ALIKE = 0.5
"""Ends of the same log are one state where neither time differs by more units: what can follow is looked up once."""
EVERY_S = 0.5
"""Instants of a track at which a stretch may begin are so far apart,"""
LEAST_S = 1.0
"""... and the last one is so long before its end."""
DRAWN = 15
"""The nearest instants of so many tracks can be drawn,"""
WITHIN = 1.5
"""... if they are no farther than the best one by so many units."""
TURNS = 60
"""Rounds in which the weights of the instants are found."""
MOST_WEIGHED = 400
"""More tracks than this are no few that follow each other: all instants weigh the same."""
PARTS = 4
"""Parts of a track that are weighed apart."""
MOST_WEIGHT = 30.0
"""No instant is drawn so many times as readily as its likeness alone would have it, or as seldom."""
BLEND_S = 1.0
"""The step between two tracks is smoothed over this time; no longer than the shortest stretch."""
AT_ONCE = 2_000_000
"""Differences between states that are in memory at once."""


@dataclass(frozen=True)
class Stretch:
    """What was logged of one operator from the start of a cycle: x_h (and g_h), (T, 3 or 6), and activity, (T,)."""

    where: Points
    activity: Ints


@dataclass(frozen=True)
class _Piece:
    """What one splice appends to N tracks: to which, behind how many samples, from behind which instant, how many."""

    track: Ints
    behind: Ints
    instant: Ints
    count: Ints


class Continuation:
    """Stretches that can follow, by state."""

    def __init__(self, tracks: Sequence[Stretch], step_s: float, *, phase_free: bool) -> None:
        """Remember the states of all logged tracks.

        Args:
            tracks: One per execution, from its start.
            step_s: Time between samples.
            phase_free: The operator's habits do not begin with the cycle.
        """
        self._step_s = step_s
        self._logs = logs = LoggedStates(tracks, step_s)
        self._kinds = 1 + int(logs.activity.max(initial=-1))
        lengths = logs.last + 1 - logs.first
        self._latest_s = 0.0 if phase_free or not len(lengths) else float(np.quantile(lengths, 0.5)) * step_s
        every, least = max(1, round(EVERY_S / step_s)), max(1, round(LEAST_S / step_s))
        instants = [np.arange(begin, end + 1 - least, every) for begin, end in zip(logs.first, logs.last, strict=True)]
        self._owner = np.repeat(np.arange(len(instants)), [len(some) for some in instants])
        self._at = np.concatenate([np.empty(0, np.int64), *instants])
        since = self._at - logs.first[self._owner]
        self._states = np.hstack([logs.states(self._at, self._kinds), self._times(logs.spell[self._at], since)])
        self._owners, self._begins = np.unique(self._owner, return_index=True)
        self._weight: Vector | None = None

    def _weights(self) -> Vector:
        """Return how readily each instant is drawn, shape (instants,), so that all of the logs is used alike.

        By likeness alone a few tracks follow each other again and again, their ends more than their beginnings, and
        what happens there would be taken for what operators do. Each end of a track leads to instants that are like
        it. Their weights, one for each of PARTS parts of each track, are changed in turns until, walked for ever,
        every part comes as often as in the logs.
        """
        logs, count = self._logs, len(self._logs.last)
        length = (logs.last + 1 - logs.first).astype(np.float64)
        times = self._times(logs.spell[logs.last], length.astype(np.int64) - 1)
        found, near = self.nearest(np.hstack([logs.states(logs.last, self._kinds), times]), np.arange(count))
        may = np.arange(found.shape[1]) < near[:, None]
        to = self._owner[found]
        into = (self._at[found] - logs.first[to]) / length[to]  # where each track is entered, in [0, 1)
        begin = np.arange(PARTS) / PARTS
        covers = np.clip(begin + 1.0 / PARTS - into[..., None], 0.0, 1.0 / PARTS) * length[to][..., None]
        covers[~may] = 0.0
        part = to * PARTS + (into * PARTS).astype(np.int64)
        every = (to[..., None] * PARTS + np.arange(PARTS)).ravel()
        weight, at = np.ones(count * PARTS), length / length.sum()
        wanted = np.repeat(length / length.sum() / PARTS, PARTS)
        for _ in range(TURNS):
            step = np.where(may, weight[part], 0.0)
            step *= (at / step.sum(axis=1))[:, None]
            at = 0.5 * at + 0.5 * np.bincount(to.ravel(), step.ravel(), minlength=count)
            used = np.bincount(every, (step[..., None] * covers).ravel(), minlength=len(weight))
            off = np.clip(wanted / np.maximum(used / used.sum(), 1e-9), 0.1, 10.0)
            ahead = (covers * off[every].reshape(covers.shape)).sum(axis=2) / np.maximum(covers.sum(axis=2), 1e-9)
            total = np.bincount(part[may], minlength=len(weight))
            mean = np.bincount(part[may], ahead[may], minlength=len(weight)) / np.maximum(total, 1)
            weight = np.clip(weight * np.where(total > 0, mean, 1.0) ** 0.5, 1.0 / MOST_WEIGHT, MOST_WEIGHT)
        parts = ((self._at - logs.first[self._owner]) / length[self._owner] * PARTS).astype(np.int64)
        return np.asarray(weight[self._owner * PARTS + parts])

    def extend(
        self, begun: Sequence[Stretch], owners: Sequence[int], length: int, *, seed: int = 0
    ) -> tuple[Points, Ints]:
        """Continue tracks to `length` samples each.

        Args:
            begun: K tracks, each of one sample or more.
            owners: Which of the remembered tracks each ends with, -1: none; itself it goes on with at need (ITSELF).
            length: Samples wanted.
            seed: Same seed, same draw.

        Returns:
            x_h (and g_h), shape (K, length, 3 or 6), and activity, shape (K, length).
        """
        where = np.empty((len(begun), length, begun[0].where.shape[1]))
        activity = np.empty((len(begun), length), dtype=np.int64)
        for k, track in enumerate(begun):
            filled = min(len(track.where), length)
            where[k, :filled], activity[k, :filled] = track.where[:filled], track.activity[:filled]
            where[k, filled:], activity[k, filled:] = track.where[-1], track.activity[-1]
        if len(self._at):
            self._write(where, activity, self._pieces(begun, np.array(owners), length, seed))
        return where, activity

    def _pieces(self, begun: Sequence[Stretch], owners: Ints, length: int, seed: int) -> list[_Piece]:
        """Return what is appended, splice by splice: each time to all tracks that are too short."""
        logs, rng, pieces = self._logs, np.random.default_rng(seed), []
        back = round(LONG_S / self._step_s)
        ends = LoggedStates([Stretch(track.where[-back:], track.activity[-back:]) for track in begun], self._step_s)
        choices = _Choices(self, np.vstack([logs.states(logs.last, self._kinds), ends.states(ends.last, self._kinds)]))
        filled, spell, kind = (
            np.array([len(track.where) for track in begun]),
            ends.spell[ends.last],
            ends.kind[ends.last],
        )
        end = np.where(owners >= 0, owners, len(logs.last) + np.arange(len(begun)))  # by number among all ends
        while len(short := np.flatnonzero(filled < length)):
            times = self._times(spell[short], filled[short])
            luck = rng.random(len(begun))[short]  # the same for a track, however long the others are to be
            source = choices.draw(end[short], times, luck)
            owner, instant = self._owner[source], self._at[source]
            last = logs.last[owner]
            count = last - instant
            pieces.append(_Piece(short, filled[short], instant, np.minimum(count, length - filled[short])))
            goes_on = np.where(kind[short] == logs.kind[instant], spell[short], 0) + count
            spell[short] = np.where(logs.spell[last] < count, logs.spell[last], goes_on)
            kind[short], end[short] = logs.kind[last], owner
            filled[short] += count
        return pieces

    def _times(self, spell: Ints, since: Ints) -> Points:
        """Return the two times of states, in units (N, 2), from samples (N,): at it for so long, and into the cycle."""
        elapsed_s = np.clip(spell * self._step_s, 1.0, LONG_S)
        phase_s = np.minimum(since * self._step_s, self._latest_s)
        return np.stack([ELAPSED * np.log(elapsed_s), phase_s / PHASE_S], axis=1)

    def nearest(self, states: Points, ends: Ints) -> tuple[Ints, Ints]:
        """Return the instants of DRAWN tracks that come nearest to each state (N, features), and how many may be drawn.

        Args:
            states: How the operator is.
            ends: Which of the remembered tracks ends there, shape (N,).

        Returns:
            Numbers of instants, nearest first, shape (N, tracks), and how many of them are near enough, shape (N,).
        """
        found, counts = [], []
        at_once = max(1, AT_ONCE // len(self._at))
        for first in range(0, len(states), at_once):
            some = states[first : first + at_once]
            squares = (some**2).sum(axis=1)[:, None] + (self._states**2).sum(axis=1) - 2.0 * some @ self._states.T
            away = np.sqrt(np.maximum(np.minimum.reduceat(squares, self._begins, axis=1), 0.0))
            away += ITSELF * (self._owners == ends[first : first + at_once, None])
            best = np.argsort(away, axis=1, kind="stable")[:, :DRAWN]
            away = np.take_along_axis(away, best, axis=1)
            counts.append((away <= away[:, :1] + WITHIN).sum(axis=1))
            limits = [*self._begins.tolist(), len(self._at)]
            found += [
                [limits[track] + int(row[limits[track] : limits[track + 1]].argmin()) for track in tracks]
                for row, tracks in zip(squares, best.tolist(), strict=True)
            ]
        return np.array(found), np.concatenate(counts)

    def weight_of(self, instants: Ints) -> Vector:
        """Return the weights of instants of any shape, in that shape."""
        if self._weight is None:
            self._weight = self._weights() if len(self._logs.last) <= MOST_WEIGHED else np.ones(len(self._at))
        return np.asarray(self._weight[instants])

    def _write(self, where: Points, activity: Ints, pieces: Sequence[_Piece]) -> None:
        """Write the pieces into tracks, shape (K, length, 3 or 6) and (K, length), in place."""
        length = where.shape[1]
        flat, doing = where.reshape(-1, where.shape[2]), activity.reshape(-1)
        blend = np.clip(1.0 - np.arange(1, round(BLEND_S / self._step_s) + 1) * self._step_s / BLEND_S, 0.0, None)
        for piece in pieces:
            begin = piece.track * length + piece.behind
            nth = np.arange(piece.count.sum()) - np.repeat(np.cumsum(piece.count) - piece.count, piece.count)
            to, source = np.repeat(begin, piece.count) + nth, np.repeat(piece.instant, piece.count) + 1 + nth
            step = flat[begin - 1, :3] - self._logs.where[piece.instant, :3]
            step[~np.isfinite(step[:, :2]).all(axis=1)] = 0.0
            step = np.nan_to_num(step)  # a height may be unknown
            flat[to], doing[to] = self._logs.where[source], self._logs.activity[source]
            for later, weight in enumerate(blend.tolist()):
                there = later < piece.count
                flat[begin[there] + later, :3] += weight * step[there]


class _Choices:
    """What can follow where a log ends, each looked up once (ALIKE)."""

    def __init__(self, continuation: Continuation, ends: Points) -> None:
        self._continuation, self._ends = continuation, ends
        self._number: dict[tuple[int, ...], int] = {}
        self._instants: list[Ints] = []
        self._counts: list[int] = []

    def draw(self, end: Ints, times: Points, luck: Vector) -> Ints:
        """Return the number of an instant for each of N tracks.

        Args:
            end: Its end, shape (N,).
            times: The two times of its state, in units, shape (N, 2).
            luck: In [0, 1), shape (N,).
        """
        about = np.rint(times / ALIKE).astype(np.int64)
        keys = list(map(tuple, np.column_stack([end, about]).tolist()))
        if new := [key for key in dict.fromkeys(keys) if key not in self._number]:
            asked = np.array(new)
            states = np.hstack([self._ends[asked[:, 0]], asked[:, 1:] * ALIKE])
            instants, counts = self._continuation.nearest(states, asked[:, 0])
            self._number |= {key: len(self._counts) + number for number, key in enumerate(new)}
            self._instants += list(instants)
            self._counts += counts.tolist()
        number = np.array([self._number[key] for key in keys])
        instants = np.array(self._instants)[number]
        weight = self._continuation.weight_of(instants)
        weight[np.arange(weight.shape[1]) >= np.array(self._counts)[number][:, None]] = 0.0
        until = np.cumsum(weight, axis=1)
        which = (until < (luck * until[:, -1])[:, None]).sum(axis=1)
        return np.asarray(instants[np.arange(len(instants)), which])


class LoggedStates:
    """Tracks one behind the other.

    Attributes:
        where, activity: As of `Stretch`, shape (S, 3 or 6) and (S,).
        first, last: First and last sample of each track, shape (K,).
        kind: What the operator does and whether he stays, walks or is away, as a number, shape (S,).
        spell: For how many samples he has been at it, shape (S,).
    """

    def __init__(self, tracks: Sequence[Stretch], step_s: float) -> None:
        self.where = np.concatenate([track.where for track in tracks]) if tracks else np.empty((0, 3))
        self.activity = np.concatenate([np.empty(0, np.int64), *(track.activity for track in tracks)])
        lengths = np.array([len(track.where) for track in tracks], dtype=np.int64)
        self.first, self.last = np.cumsum(lengths) - lengths, np.cumsum(lengths) - 1
        self._begin, self._step_s = np.repeat(self.first, lengths), step_s
        xy = self.where[:, :2]
        self._away = np.asarray(~np.isfinite(xy).all(axis=1))
        speed = np.linalg.norm(np.diff(xy, axis=0, prepend=xy[:1]), axis=1) / step_s
        speed[self.first] = 0.0
        self.kind = np.where(self._away, 2, np.where(speed < STILL_M_S, 0, 1)) + 3 * (self.activity + 1)
        changed = np.diff(self.kind, prepend=-1) != 0
        changed[self.first] = True
        index = np.arange(len(self.kind))
        self.spell = index - np.maximum.accumulate(np.where(changed, index, 0))

    def states(self, at: Ints, kinds: int) -> Points:
        """Return where he is, how he moves and what of `kinds` he does at these samples (N,); shape (N, features)."""
        xy, away = self.where[at, :2], self._away[at]
        back = np.maximum(at - max(1, round(0.5 / self._step_s)), self._begin[at])
        speed = (xy - self.where[back, :2]) / (np.maximum(at - back, 1) * self._step_s)[:, None]
        speed[~np.isfinite(speed).all(axis=1)] = 0.0
        doing = (self.activity[at, None] == np.arange(kinds)) * (OTHER_TASK / np.sqrt(2.0))
        position = np.where(away[:, None], 0.0, xy)
        return np.hstack([position / NEAR_M, speed / NEAR_M_S, AWAY * away[:, None], doing])

    def differences(self, ends: Ints, begins: Ints) -> Floats:
        """Return how differently some tracks end and others begin, in units, shape (ends, begins)."""
        kinds, soon = 1 + int(self.activity.max(initial=-1)), max(1, round(0.5 / self._step_s))
        last, first = self.states(self.last[ends], kinds), self.states(self.first[begins], kinds)
        later = self.states(np.minimum(self.first + soon, self.last)[begins], kinds)
        first[:, 2:4] = later[:, 2:4]  # how fast he moves is known from there on
        squares = (last**2).sum(axis=1)[:, None] + (first**2).sum(axis=1) - 2.0 * last @ first.T
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))
