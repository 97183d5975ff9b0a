"""Logged operators joined to circles, which a cycle may enter at any instant.

An operator who comes and goes as he likes is the same at any time. So the logs are laid one behind the other: each ends
where another one begins that fits it best, until all of them form closed circles. Entered at even steps, each second
of the logs meets each part of the program equally often; entered at some instants of each log alone, its end never
met the beginning of a program, and which operators were logged moved the mean more. Each log follows exactly one: the
assignment of least total difference (Kuhn, Naval Research Logistics Quarterly 2, 1955).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from cyclekit.estimate.continuation import BLEND_S, ITSELF, LoggedStates, Stretch

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.schema import Ints, Points

AT_ONCE = 1000
"""So many logs are assigned to each other at once; of more, neighbours."""


class Entered(NamedTuple):
    """Tracks that enter logs.

    Attributes:
        where: x_h (and g_h), shape (entries, length, 3 or 6).
        activity: Shape (entries, length).
        owner: Which log each enters, shape (entries,); circles one behind the other.
        logged: Samples until the end of that log, or of the last one that really followed it, shape (entries,).
    """

    where: Points
    activity: Ints
    owner: Ints
    logged: Ints


def enter(
    logs: Sequence[Stretch], step_s: float, *, entries: int, length: int, after: Mapping[int, int] | None = None
) -> Entered:
    """Join logs to circles and enter these at even steps.

    Args:
        logs: One per execution, each of one sample or more.
        step_s: Time between samples.
        entries: How many tracks are wanted.
        length: Samples of each.
        after: Which log really followed which, by number: these stay together.
    """
    really = dict(after or {})
    preceded = set(really.values())
    circles = _circles(_followers(logs, step_s, really), [k for k in range(len(logs)) if k not in preceded])
    order = np.array([k for circle in circles for k in circle])
    sizes = np.array([len(logs[k].where) for k in order])
    last = np.cumsum(sizes)  # one behind each log
    first = last - sizes
    of = np.repeat(np.arange(len(circles)), [len(circle) for circle in circles])
    begin, count = first[np.unique(of, return_index=True)[1]], np.bincount(of, sizes).astype(np.int64)
    where, activity = (np.concatenate([getattr(logs[k], part) for k in order]) for part in ("where", "activity"))
    joined = np.array([k not in preceded for k in order])
    before = np.where(first == begin[of], begin[of] + count[of], first) - 1
    _smooth(where, before[joined], first[joined], sizes[joined], step_s)
    ends = last.copy()  # of what the operator really did
    for n in np.flatnonzero([k in really for k in order])[::-1].tolist():
        ends[n] = ends[n + 1]
    at = np.arange(entries) * len(where) // entries
    log = np.searchsorted(first, at, side="right") - 1
    since, turn = at - begin[of[log]], count[of[log]]
    rows = begin[of[log], None] + (since[:, None] + np.arange(length)) % turn[:, None]
    return Entered(where[rows], activity[rows], order[log], ends[log] - at)


def _followers(logs: Sequence[Stretch], step_s: float, really: Mapping[int, int]) -> dict[int, int]:
    """Return which log follows each: the one that really did, else the one that is assigned to it."""
    ends = [k for k in range(len(logs)) if k not in really]
    begins = sorted(set(range(len(logs))) - set(really.values()))
    head = {begin: begin for begin in begins}  # where each chain of logs that really followed each other began
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
    """Return the closed circles of logs, each from a log on that no other one really preceded."""
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


def _smooth(where: Points, before: Ints, first: Ints, sizes: Ints, step_s: float) -> None:
    """Smooth the steps between samples `before` and `first`, over BLEND_S or the log that begins there, in place."""
    step = where[before, :3] - where[first, :3]
    step[~np.isfinite(step[:, :2]).all(axis=1)] = 0.0
    step = np.nan_to_num(step)  # a height may be unknown
    for later in range(round(BLEND_S / step_s)):
        there = later < sizes
        where[first[there] + later, :3] += max(1.0 - (later + 1) * step_s / BLEND_S, 0.0) * step[there]
