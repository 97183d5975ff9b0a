"""Finds conditions that tasks of one kind show together, such as `bring fixture_1` to `bring fixture_4`.

Tasks are of one kind if their names differ only in a number or a last letter. Alone each may wait too seldom to show
what it waits for. The task with a number then waits for that of the other kind with the same number. Every member has
to respect the condition, and several have to show it.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.task_model import NeedCard
from cyclekit.learning.coupling.conditions.alike import number_of
from cyclekit.learning.task_times.starts import HELD, MAX_CONDITIONS, gain, least_gain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.learning.task_times.starts import Waiting

MIN_MEMBERS = 2
"""Minimum number of tasks of a kind that respect a condition, and of those with a start that it decided."""

_Needs = dict[str, NeedCard]
"""A condition of each task of a kind, by its number."""


def find_with_alike(every: Sequence[Waiting], others: Sequence[NeedCard]) -> None:
    """Add the conditions that only tasks of one kind show together.

    Args:
        every: The tasks of one agent.
        others: Tasks of other agents that they may wait for.
    """
    kinds: dict[str, dict[str, Waiting]] = defaultdict(dict)
    for one in every:
        if named := number_of(one.task):
            kinds[named[0]][named[1]] = one
    needs: dict[tuple[str, str, int], _Needs] = defaultdict(dict)
    for need in others:
        if named := number_of(need.task):
            needs[need.agent, named[0], need.back][named[1]] = need
    for members in kinds.values():
        _learn(members, [some for some in needs.values() if len(some.keys() & members.keys()) >= MIN_MEMBERS])


def _learn(members: Mapping[str, Waiting], open_to: Sequence[_Needs]) -> None:
    for _ in range(MAX_CONDITIONS):
        tried = [(*_tried(members, needs), needs) for needs in open_to]
        best, numbers, needs = max(tried, key=lambda each: each[0], default=(-np.inf, [], {}))
        if best < least_gain(len(open_to), sum(len(members[number].seen) for number in numbers)):
            return
        for number in numbers:
            if needs[number] not in members[number].found:
                members[number].found.append(needs[number])
        open_to = [each for each in open_to if each is not needs]


def _tried(members: Mapping[str, Waiting], needs: _Needs) -> tuple[float, list[str]]:
    """Return the gain in regularity by a condition of a kind, and the numbers of the tasks that respect it."""
    times = {}
    early_s = next(iter(members.values())).early_s
    for number in members.keys() & needs.keys():
        one, need = members[number], needs[number]
        rival = [each for each in one.found if each and (each.agent, each.task) == (need.agent, need.task)]
        if need.task in one.barred or rival not in ([], [need]) or len(one.found) - len(rival) >= MAX_CONDITIONS:
            continue
        ends = one.ends_s(need)
        known = np.isfinite(ends)
        early = int((one.start_s[known] < ends[known] - one.early_s).sum())
        if known.any() and early <= (1.0 - HELD) * known.sum() + 0.5:
            times[number] = one.start_s, one.ready_s(need), ends
    numbers = sorted(times)
    showing = sum(_shows(*times[number]) for number in numbers)
    found = gain([times[number] for number in numbers], early_s) if showing >= MIN_MEMBERS else -np.inf
    return found, numbers


def _shows(start_s: np.ndarray, ready_s: np.ndarray, ends_s: np.ndarray) -> bool:
    """Return whether lags of a task are more regular with a condition that decided some of its starts."""
    with_it = np.fmax(ready_s, ends_s)
    decided = with_it > ready_s
    return bool(decided.any() and np.abs(start_s - with_it)[decided].mean() < np.abs(start_s - ready_s)[decided].mean())
