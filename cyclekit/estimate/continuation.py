"""What the operator does next: logged tracks continued by stretches of other logged tracks, for as long as asked.

A cycle may take longer than any log of the operator. Where a track ends, it goes on with a stretch of another track
that begins in the same state: what the operator does, where he is, how he moves, and for how long he has been at it
(or away). Of the tracks that come nearest one is drawn. A logged execution ends when the robot is done, which depends
on what the operator did before and not on what he does next; so what followed the same state elsewhere is a fair draw
of what follows here, however long or short the execution was that it comes from. (A block bootstrap with matched
blocks: Carlstein, Do, Hall, Hesterberg and Künsch, Bernoulli 4, 1998.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]
    Whole = NDArray[np.int64]

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
EVERY_S = 0.5
"""Instants of a track at which a stretch may begin are so far apart,"""
LEAST_S = 1.0
"""... and the last one is so long before its end."""
NEIGHBOURS = 32
"""Instants that are looked at for one continuation,"""
DRAWN = 5
"""... of which the best ones of so many tracks can be drawn,"""
WITHIN = 1.0
"""... if they are no farther than the best one by so many units."""
BLEND_S = 1.0
"""The step between two tracks is smoothed over this time."""


@dataclass(frozen=True)
class Stretch:
    """What was logged of one operator from the start of a cycle: x_h (and g_h), (T, 3 or 6), and activity, (T,)."""

    where: Points
    activity: Whole


class Continuation:
    """Stretches that can follow, by state."""

    def __init__(self, tracks: Sequence[Stretch], step_s: float, *, phase_free: bool) -> None:
        """Remember the states of all logged tracks.

        Args:
            tracks: One per execution, from its start.
            step_s: Time between samples.
            phase_free: The operator's habits do not begin with the cycle.
        """
        self._tracks, self._step_s = tracks, step_s
        self._kinds = 1 + max((int(track.activity.max(initial=-1)) for track in tracks), default=0)
        lengths = np.array([len(track.where) for track in tracks])
        self._latest_s = None if phase_free else float(np.quantile(lengths, 0.5)) * step_s
        every, least = max(1, round(EVERY_S / step_s)), max(1, round(LEAST_S / step_s))
        states, owners, instants = [], [], []
        for number, track in enumerate(tracks):
            at = np.arange(0, len(track.where) - least, every)
            states.append(self._states(track, at, np.asarray(at * step_s, dtype=np.float64)))
            owners.append(np.full(len(at), number))
            instants.append(at)
        self._owner, self._at = np.concatenate(owners), np.concatenate(instants)
        self._tree = cKDTree(np.concatenate(states)) if len(self._owner) else None

    def extend(
        self, begun: Sequence[Stretch], owners: Sequence[int], length: int, *, seed: int = 0
    ) -> tuple[Points, Whole]:
        """Continue tracks to `length` samples each.

        Args:
            begun: K tracks, each of one sample or more.
            owners: Which of the remembered tracks each ends with; itself it goes on with at need (ITSELF).
            length: Samples wanted.
            seed: Same seed, same draw.

        Returns:
            x_h (and g_h), shape (K, length, 3 or 6), and activity, shape (K, length).
        """
        rng = np.random.default_rng(seed)
        where = np.full((len(begun), length, begun[0].where.shape[1]), np.nan)
        activity = np.full((len(begun), length), -1, dtype=np.int64)
        filled, last = np.array([min(len(track.where), length) for track in begun]), np.array(owners)
        for k, track in enumerate(begun):
            where[k, : filled[k]], activity[k, : filled[k]] = track.where[: filled[k]], track.activity[: filled[k]]
        while len(short := np.flatnonzero(filled < length)):
            chosen = self._chosen(where, activity, filled, last, rng)
            for k, source in zip(short.tolist(), chosen.tolist(), strict=True):
                filled[k] += self._append(where[k], activity[k], int(filled[k]), source)
                last[k] = self._owner[source] if source >= 0 else last[k]
        return where, activity

    def _chosen(self, where: Points, activity: Whole, filled: Whole, last: Whole, rng: np.random.Generator) -> Whole:
        """Return for each track that is too short the instant that it goes on with, as an index; -1: there is none."""
        short = np.flatnonzero(filled < where.shape[1])
        if self._tree is None:
            return np.full(len(short), -1)
        back = round(60.0 / self._step_s)  # for longer than a minute nobody needs to know how long
        states = []
        for k in short.tolist():
            end = int(filled[k])
            recent = slice(max(0, end - back), end)
            track = Stretch(where[k, recent], activity[k, recent])
            states.append(
                self._states(track, np.array([len(track.where) - 1]), np.full(1, end * self._step_s, dtype=np.float64))
            )
        many = min(NEIGHBOURS, len(self._owner))
        far, found = self._tree.query(np.concatenate(states), k=many)
        far, found = far.reshape(len(short), many), found.reshape(len(short), many)
        chosen = np.empty(len(short), dtype=np.int64)
        for row in range(len(short)):
            owners, first = np.unique(self._owner[found[row]], return_index=True)
            away = far[row, first] + ITSELF * (owners == last[short[row]])
            order = np.argsort(away, kind="stable")[:DRAWN]
            best = first[order[away[order] <= away[order[0]] + WITHIN]]
            chosen[row] = found[row, rng.choice(best)]
        return chosen

    def _append(self, where: Points, activity: Whole, end: int, source: int) -> int:
        """Write the stretch that begins at this instant behind sample `end`; return how many samples it has."""
        if source < 0:
            where[end:], activity[end:] = where[end - 1], activity[end - 1]
            return len(where) - end
        track, at = self._tracks[self._owner[source]], int(self._at[source]) + 1
        count = min(len(track.where) - at, len(where) - end)
        where[end : end + count] = track.where[at : at + count]
        activity[end : end + count] = track.activity[at : at + count]
        step = where[end - 1, :3] - track.where[at - 1, :3]
        if np.isfinite(step[:2]).all():
            step = np.nan_to_num(step)  # a height may be unknown
            blend = np.clip(1.0 - np.arange(1, count + 1) * self._step_s / BLEND_S, 0.0, None)
            where[end : end + count, :3] += blend[:, None] * step
        return count

    def _states(self, track: Stretch, at: Whole, since_s: Vector) -> Points:
        """Return the states of a track at these instants (N,), `since_s` after the cycle began; shape (N, features)."""
        xy = track.where[:, :2]
        there = np.asarray(np.isfinite(xy).all(axis=1))
        back = np.maximum(at - max(1, round(0.5 / self._step_s)), 0)
        speed = (xy[at] - xy[back]) / (np.maximum(at - back, 1) * self._step_s)[:, None]
        speed[~np.isfinite(speed).all(axis=1)] = 0.0
        away = ~there[at]
        position = np.where(away[:, None], 0.0, np.nan_to_num(xy[at]))
        doing = np.zeros((len(at), self._kinds))
        known = track.activity[at] >= 0
        doing[np.flatnonzero(known), track.activity[at][known]] = OTHER_TASK / np.sqrt(2.0)
        parts = [
            position / NEAR_M,
            np.where(away[:, None], 0.0, speed) / NEAR_M_S,
            ELAPSED * np.log(np.maximum(_elapsed(track, self._step_s)[at], 1.0))[:, None],
            AWAY * away[:, None],
            doing,
        ]
        if self._latest_s is not None:
            parts.append(np.minimum(since_s, self._latest_s)[:, None] / PHASE_S)
        return np.concatenate(parts, axis=1)


def _elapsed(track: Stretch, step_s: float) -> Vector:
    """Return for how long the operator has been at what he does at each sample (T,), s: staying, walking or away."""
    xy = track.where[:, :2]
    speed = np.linalg.norm(np.diff(xy, axis=0, prepend=xy[:1]), axis=1) / step_s
    away = np.asarray(np.isnan(xy).any(axis=1))
    kind = np.where(away, 2, np.where(speed < STILL_M_S, 0, 1)).astype(np.int64)
    changed = np.flatnonzero((np.diff(kind, prepend=-1) != 0) | (np.diff(track.activity, prepend=-2) != 0))
    index = np.arange(len(kind))
    return np.asarray((index - changed[np.searchsorted(changed, index, side="right") - 1]) * step_s)
