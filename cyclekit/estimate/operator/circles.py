"""Logged operator tracks joined to closed circles, which a cycle may enter at any instant.

This is for an operator whose behaviour does not depend on the phase of the cycle. Each log is followed by the log whose
beginning matches its end best, until all logs form closed circles. Tracks start at even steps along the circles, so
that each second of the logs meets each part of the program equally often. With a few start instants per log, the end
of a log never met the beginning of a program, and the mean depended more on which operators were logged. Each log
follows exactly one: the assignment of least total difference (Kuhn, Naval Research Logistics Quarterly 2, 1955).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.estimate.operator.continuation import ITSELF, LoggedStates, Stretch, smooth

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.schema import Ints, Points

AT_ONCE = 1000
"""Maximum number of logs in one assignment; more are split into groups of neighbours."""


class TrackStarts(NamedTuple):
    """Tracks that start at some instant of a log.

    Attributes:
        where: x_h (and g_h), shape (entries, length, 3 or 6).
        activity: Shape (entries, length).
        owner: Number of the log in which each track starts, shape (entries,); in the order of the circles.
        begin: Sample of that log with which each track starts, shape (entries,).
        logged: Samples until the end of that log, or of the last log that really followed it, shape (entries,).
    """

    where: Points
    activity: Ints
    owner: Ints
    begin: Ints
    logged: Ints


def start_tracks(
    logs: Sequence[Stretch], step_s: float, *, entries: int, length: int, after: Mapping[int, int] | None = None
) -> TrackStarts:
    """Join logs to circles and start tracks at even steps along them.

    Args:
        logs: One per execution, each of at least one sample.
        step_s: Time between samples.
        entries: Number of tracks.
        length: Samples per track.
        after: Number of the log that really followed a log, by the number of the latter: these stay together.
    """
    really = dict(after or {})
    preceded = set(really.values())
    circles = _circles(_followers(logs, step_s, really), [k for k in range(len(logs)) if k not in preceded])
    order = np.array([k for circle in circles for k in circle])
    sizes = np.array([len(logs[k].where) for k in order])
    last = np.cumsum(sizes)  # one past the end of each log
    first = last - sizes
    of = np.repeat(np.arange(len(circles)), [len(circle) for circle in circles])
    begin, count = first[np.unique(of, return_index=True)[1]], np.bincount(of, sizes).astype(np.int64)
    where, activity = (np.concatenate([getattr(logs[k], part) for k in order]) for part in ("where", "activity"))
    joined = np.array([k not in preceded for k in order])
    before = np.where(first == begin[of], begin[of] + count[of], first) - 1
    before, begins = before[joined], first[joined]
    smooth(where, begins, sizes[joined], where[before, :3] - where[begins, :3], step_s)
    ends = last.copy()  # end of what this operator really did
    for n in np.flatnonzero([k in really for k in order])[::-1].tolist():
        ends[n] = ends[n + 1]
    at = np.arange(entries) * len(where) // entries
    log = np.searchsorted(first, at, side="right") - 1
    since, turn = at - begin[of[log]], count[of[log]]
    rows = begin[of[log], None] + (since[:, None] + np.arange(length)) % turn[:, None]
    return TrackStarts(where[rows], activity[rows], order[log], at - first[log], ends[log] - at)


def mixed_starts(kinds: Sequence[TrackStarts], share: float | None) -> TrackStarts:
    """Return tracks that start with their execution and, this share of them, anywhere; None: all of both kinds."""
    counts = [len(kind.owner) for kind in kinds]
    if share is not None:
        counts = [counts[1] - round(share * counts[1]), round(share * counts[1])]
    chosen = [
        [part[np.arange(count) * len(part) // count] for part in kind]
        for kind, count in zip(kinds, counts, strict=True)
    ]
    return TrackStarts(*(np.concatenate(pair) for pair in zip(*chosen, strict=True)))


def _followers(logs: Sequence[Stretch], step_s: float, really: Mapping[int, int]) -> dict[int, int]:
    """Return the follower of each log: the one that really followed, else the assigned one."""
    ends = [k for k in range(len(logs)) if k not in really]
    from scipy.optimize import linear_sum_assignment  # slow to import, and coupled cells need none

    begins = sorted(set(range(len(logs))) - set(really.values()))
    head = {begin: begin for begin in begins}  # last log of each chain of really following logs -> its first
    for begin in begins:
        k = begin
        while k in really:
            k = really[k]
        head[k] = begin
    states, found = LoggedStates(logs, step_s), dict(really)
    for some in np.array_split(np.arange(len(ends)), -(-len(ends) // AT_ONCE)):
        mine, theirs = np.array(ends)[some], np.array(begins)[some]
        differs = states.differences(mine, theirs)
        differs[np.array([head[k] for k in mine.tolist()])[:, None] == theirs] += ITSELF + differs.max()
        found |= {int(mine[i]): int(theirs[j]) for i, j in zip(*linear_sum_assignment(differs), strict=True)}
    return found


def _circles(follower: Mapping[int, int], heads: Sequence[int]) -> list[list[int]]:
    """Return the closed circles of logs, each starting at a log that no other log really preceded."""
    circles: list[list[int]] = []
    seen: set[int] = set()
    for head in heads:
        k, circle = head, []
        while k not in seen:
            seen.add(k)
            circle.append(k)
            k = follower[k]
        circles += [circle] if circle else []
    return circles
