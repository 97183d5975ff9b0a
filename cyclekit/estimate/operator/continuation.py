"""Continuation of operator tracks: logged tracks extended by stretches of other logged tracks, to any length.

A cycle may take longer than any log of the operator. At its end, a track continues with a stretch of another track that
begins in the same state: task, position, velocity, and how long the operator has been at it (or away). One of the most
similar tracks is drawn. A logged execution ends when the robot has finished, which depends on what the operator did
before and not on what he does next. So what followed the same state elsewhere is an unbiased draw, whatever the length
of the execution that it comes from. (A block bootstrap with matched blocks: Carlstein, Do, Hall, Hesterberg and Künsch,
Bernoulli 4, 1998.) Nothing that only a log's end knows may enter the state, or ends match ends: a task that the end
cuts (he walks, or is away, before it) is unknown and may be any; how long a task has lasted that began before its log
is unknown too; and the time since the start of the cycle does not count, as all that is as late as the end of a log is
near an end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Ints, Points, Vector

NEAR_M = 0.4
"""Distance between two positions, m, that counts as one unit of difference between states."""
NEAR_M_S = 0.5
"""Difference in velocity, m/s, that counts as one unit."""
ELAPSED = 2.0
"""Units per natural logarithm of the ratio of times at the task; times below 1 s count as 1 s."""
OTHER_TASK = 5.0
"""Units of difference between two tasks of the operator."""
ITSELF = 5.0
"""Units added for a stretch of the track that ends, as it should not repeat itself, and for one within a task or
absence that began before its log, as it has lasted longer than is known."""
AWAY = 100.0
"""Units of difference between an absent and a present operator."""
STILL_M_S = 0.2
"""Speed below which the operator counts as stationary, m/s."""
LONG_S = 60.0
"""Maximum time at a task, s, that states distinguish."""
TIME_GRID = 0.5
"""Grid of the two times, units: ends of one log in the same grid cell share their candidates."""
EVERY_S = 0.5
"""Time between the instants of a track at which a stretch may begin, s."""
MIN_S = 1.0
"""Minimum time from such an instant to the end of its track, s."""
CANDIDATES = 15
"""Maximum number of tracks, the most similar ones, from which a stretch is drawn."""
MAX_EXCESS = 1.5
"""Maximum difference of a candidate beyond that of the best one, units."""
BLEND_S = 1.0
"""Time over which the jump between two tracks is smoothed, s; at most the length of the shortest stretch."""
EVEN = 1e-6
"""Units by which equally similar stretches differ, so that another end takes others of them; of no other effect."""
AT_ONCE = 2_000_000
"""Maximum number of differences between states in memory at once."""


@dataclass(frozen=True)
class Stretch:
    """Logged track of one operator from the start of a cycle: x_h (and g_h), (T, 3 or 6), and activity, (T,)."""

    where: Points
    activity: Ints


@dataclass(frozen=True)
class _Piece:
    """One splice of N tracks, shape (N,) each: track, its samples so far, instant it continues after, samples added."""

    track: Ints
    behind: Ints
    instant: Ints
    count: Ints


class Continuation:
    """Stretches of logged tracks that can continue a track, looked up by state."""

    def __init__(self, tracks: Sequence[Stretch], step_s: float) -> None:
        """Compute the states of all logged tracks.

        Args:
            tracks: One per execution, from its start.
            step_s: Time between samples.
        """
        self._step_s = step_s
        self._logs = logs = LoggedStates(tracks, step_s)
        self._kinds = 1 + int(logs.activity.max(initial=-1))
        every, least = max(1, round(EVERY_S / step_s)), max(1, round(MIN_S / step_s))
        instants = [np.arange(begin, end + 1 - least, every) for begin, end in zip(logs.first, logs.last, strict=True)]
        self._owner = np.repeat(np.arange(len(instants)), [len(some) for some in instants])
        self._at = np.concatenate([np.empty(0, np.int64), *instants])
        self._states = np.hstack([logs.states(self._at, self._kinds), self._elapsed(logs.spell[self._at])[:, None]])
        self._known = (logs.activity[self._at] >= 0) * (0.5 * OTHER_TASK**2)
        since = self._at - logs.spell[self._at]
        self._begun_before = ITSELF**2 * (since == logs.first[self._owner])
        self._begins = np.unique(since, return_index=True)[1]
        self._owners = self._owner[self._begins]

    def extend(
        self, begun: Sequence[Stretch], owners: Sequence[int], length: int, *, seed: int = 0
    ) -> tuple[Points, Ints]:
        """Continue tracks to `length` samples each.

        Args:
            begun: K tracks, each of at least one sample.
            owners: Logged track that each one ends with, -1: none; it may continue with itself at a penalty (ITSELF).
            length: Samples per track.
            seed: Seed of the draw.

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
        """Return the pieces to append: each splice extends all tracks that are too short."""
        logs, rng, pieces = self._logs, np.random.default_rng(seed), []
        back = round(LONG_S / self._step_s)
        ends = LoggedStates([Stretch(track.where[-back:], track.activity[-back:]) for track in begun], self._step_s)
        choices = _Choices(self, np.vstack([logs.states(logs.last, self._kinds), ends.states(ends.last, self._kinds)]))
        filled, spell, kind = (
            np.array([len(track.where) for track in begun]),
            ends.spell[ends.last],
            ends.kind[ends.last],
        )
        end = np.where(owners >= 0, owners, len(logs.last) + np.arange(len(begun)))  # number among all ends
        while len(short := np.flatnonzero(filled < length)):
            uniform = rng.random(len(begun))[short]  # does not depend on the length of the other tracks
            source = choices.draw(end[short], self._elapsed(spell[short]), uniform)
            owner, instant = self._owner[source], self._at[source]
            last = logs.last[owner]
            count = last - instant
            pieces.append(_Piece(short, filled[short], instant, np.minimum(count, length - filled[short])))
            goes_on = np.where(kind[short] == logs.kind[instant], spell[short], 0) + count
            spell[short] = np.where(logs.spell[last] < count, logs.spell[last], goes_on)
            kind[short], end[short] = logs.kind[last], owner
            filled[short] += count
        return pieces

    def _elapsed(self, spell: Ints) -> Vector:
        """Return times at the task in units, shape (N,), from samples (N,)."""
        return np.asarray(ELAPSED * np.log(np.clip(spell * self._step_s, 1.0, LONG_S)))

    def nearest(self, states: Points, ends: Ints) -> tuple[Ints, Ints]:
        """Return the most similar instant of each of CANDIDATES tracks, for each state (N, features).

        Args:
            states: The operator's state.
            ends: Logged track that ends there, shape (N,).

        Returns:
            Numbers of instants, most similar first, shape (N, tracks), and how many are similar enough, shape (N,).
        """
        found, counts = [], []
        doing = slice(-1 - self._kinds, -1)
        at_once = max(1, AT_ONCE // len(self._at))
        for first in range(0, len(states), at_once):
            some = states[first : first + at_once]
            squares = (some**2).sum(axis=1)[:, None] + (self._states**2).sum(axis=1) - 2.0 * some @ self._states.T
            unknown = np.asarray(~some[:, doing].any(axis=1), dtype=np.float64)
            squares += self._begun_before - unknown[:, None] * self._known  # a task that is not known may be any
            squares += ITSELF**2 * (self._states[:, -1] < some[:, -1:] - TIME_GRID)
            away = np.sqrt(np.maximum(np.minimum.reduceat(squares, self._begins, axis=1), 0.0))
            away += ITSELF * (self._owners == ends[first : first + at_once, None])
            away += (
                EVEN * np.modf(0.618 * np.arange(len(self._begins)) + 0.755 * ends[first : first + at_once, None])[0]
            )
            best = np.argsort(away, axis=1, kind="stable")[:, :CANDIDATES]
            away = np.take_along_axis(away, best, axis=1)
            counts.append((away <= away[:, :1] + MAX_EXCESS).sum(axis=1))
            limits = [*self._begins.tolist(), len(self._at)]
            found += [
                [limits[track] + int(row[limits[track] : limits[track + 1]].argmin()) for track in tracks]
                for row, tracks in zip(squares, best.tolist(), strict=True)
            ]
        return np.array(found), np.concatenate(counts)

    def _write(self, where: Points, activity: Ints, pieces: Sequence[_Piece]) -> None:
        """Write the pieces into tracks, shape (K, length, 3 or 6) and (K, length), in place."""
        length = where.shape[1]
        flat, doing = where.reshape(-1, where.shape[2]), activity.reshape(-1)
        for piece in pieces:
            begin = piece.track * length + piece.behind
            nth = np.arange(piece.count.sum()) - np.repeat(np.cumsum(piece.count) - piece.count, piece.count)
            to, source = np.repeat(begin, piece.count) + nth, np.repeat(piece.instant, piece.count) + 1 + nth
            jump_m = flat[begin - 1, :3] - self._logs.where[piece.instant, :3]
            flat[to], doing[to] = self._logs.where[source], self._logs.activity[source]
            smooth(flat, begin, piece.count, jump_m, self._step_s)


def smooth(where: Points, first: Ints, count: Ints, jump_m: Points, step_s: float) -> None:
    """Smooth the jumps at samples `first` (N,) over BLEND_S or the next `count` (N,) samples, in place.

    Args:
        where: Positions, shape (S, 3 or more), m.
        first: First sample after each jump.
        count: Number of samples that belong together from there on.
        jump_m: Position before the jump minus that after it, shape (N, 3); an unknown part is not smoothed.
        step_s: Time between samples.
    """
    jump_m = np.nan_to_num(jump_m) * np.isfinite(jump_m[:, :2]).all(axis=1, keepdims=True)  # a height may be unknown
    for later in range(round(BLEND_S / step_s)):
        there = later < count
        where[first[there] + later, :3] += max(1.0 - (later + 1) * step_s / BLEND_S, 0.0) * jump_m[there]


class _Choices:
    """The candidates that can follow the end of a log, looked up once per end and grid cell of times (TIME_GRID)."""

    def __init__(self, continuation: Continuation, ends: Points) -> None:
        self._continuation, self._ends = continuation, ends
        self._number: dict[tuple[int, int], int] = {}
        self._instants: list[Ints] = []
        self._counts: list[int] = []

    def draw(self, end: Ints, elapsed: Vector, uniform: Vector) -> Ints:
        """Draw an instant for each of N tracks and return its number.

        Args:
            end: Number of the end of the track, shape (N,).
            elapsed: Time at its task, in units, shape (N,).
            uniform: Uniform random numbers in [0, 1), shape (N,).
        """
        about = np.rint(elapsed / TIME_GRID).astype(np.int64)
        keys = list(map(tuple, np.column_stack([end, about]).tolist()))
        if new := [key for key in dict.fromkeys(keys) if key not in self._number]:
            missing = np.array(new)
            states = np.hstack([self._ends[missing[:, 0]], missing[:, 1:] * TIME_GRID])
            instants, counts = self._continuation.nearest(states, missing[:, 0])
            self._number |= {key: len(self._counts) + number for number, key in enumerate(new)}
            self._instants += list(instants)
            self._counts += counts.tolist()
        number = np.array([self._number[key] for key in keys])
        instants = np.array(self._instants)[number]
        which = (uniform * np.array(self._counts)[number]).astype(np.int64)
        return np.asarray(instants[np.arange(len(instants)), which])


class LoggedStates:
    """Tracks concatenated, with the state of each of S samples.

    Attributes:
        where, activity: As in `Stretch`, shape (S, 3 or 6) and (S,).
        first, last: First and last sample of each track, shape (K,).
        kind: Number for the activity combined with stationary, walking or away, shape (S,).
        spell: Number of samples since `kind` last changed, shape (S,).
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
        """Return position, velocity, absence and activity (one of `kinds`) at samples (N,), units, (N, features)."""
        xy, away = self.where[at, :2], self._away[at]
        back = np.maximum(at - max(1, round(0.5 / self._step_s)), self._begin[at])
        speed = (xy - self.where[back, :2]) / (np.maximum(at - back, 1) * self._step_s)[:, None]
        speed[~np.isfinite(speed).all(axis=1)] = 0.0
        doing = (self.activity[at, None] == np.arange(kinds)) * (OTHER_TASK / np.sqrt(2.0))
        position = np.where(away[:, None], 0.0, xy)
        return np.hstack([position / NEAR_M, speed / NEAR_M_S, AWAY * away[:, None], doing])
