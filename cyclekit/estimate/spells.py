"""What an operator known by states does next: logged courses continued by stretches of other logged courses.

A course that ends goes on as one that was in the same state for as long. All spells of a state that lasted so long are
drawn alike, those that ended right then as those that went on: the nearest instant of each log would be the end of
every spell that fell short, and people would come and go too often. Of spells as long as only a few, the few longest
are one. A stretch may be as short as a sample: that a log goes on for longer often means that somebody came. How long a
spell at the beginning of a log has lasted is not known; it is drawn where there is no other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.continuation import Stretch
    from cyclekit.schema import Bools, Ints, Points

LONGEST = 10
"""So many longest spells of a state go on alike."""


class Spells:
    """Spells of states in logged courses, and what came after each."""

    def __init__(self, tracks: Sequence[Stretch]) -> None:
        """Remember all logged courses, one per execution; `activity` is the number of the state."""
        self._where = np.concatenate([track.where for track in tracks])
        self._state = np.concatenate([track.activity for track in tracks])
        lengths = np.array([len(track.activity) for track in tracks], np.int64)
        last = np.repeat(np.cumsum(lengths) - 1, lengths)
        first = np.zeros(len(last), np.bool_)
        first[np.cumsum(lengths) - lengths] = True
        begin = np.flatnonzero(first | (np.diff(self._state, prepend=-2) != 0))
        end = np.append(begin[1:], len(last)) - 1
        self._last, self._spell = last, np.arange(len(last)) - np.repeat(begin, end - begin + 1)
        reach = np.minimum(end, last[begin] - 1) - begin
        self._of = {
            state: _longest_first(begin, reach, first[begin], mine)
            for state in np.unique(self._state).tolist()
            if (mine := (self._state[begin] == state) & (reach >= 0)).any()
        }
        self._any = _longest_first(begin, reach, first[begin], reach >= 0)

    def extend(self, begun: Sequence[Stretch], length: int, *, seed: int = 0) -> tuple[Points, Ints]:
        """Return tracks continued to `length` samples, shape (K, length, 3 + D), and their states, (K, length)."""
        rng = np.random.default_rng(seed)
        where = np.empty((len(begun), length, begun[0].where.shape[1]))
        state = np.empty((len(begun), length), np.int64)
        for k, track in enumerate(begun):
            filled = min(len(track.activity), length)
            where[k, :filled], state[k, :filled] = track.where[:filled], track.activity[:filled]
            now, since = int(track.activity[-1]), _since(track.activity)
            while filled < length and len(self._any[0]):
                begin, reach = self._of.get(now, self._any)
                alike = max(int(np.searchsorted(-reach, -since, side="right")), min(LONGEST, len(reach)))
                drawn = int(rng.random() * alike)
                at = int(begin[drawn] + min(since, reach[alike - 1]))
                end = int(self._last[at])
                count = min(end - at, length - filled)
                where[k, filled : filled + count] = self._where[at + 1 : at + 1 + count]
                state[k, filled : filled + count] = self._state[at + 1 : at + 1 + count]
                filled += count
                in_it = int(self._spell[end]) < end - at or self._state[at] != now
                since, now = int(self._spell[end]) if in_it else since + end - at, int(self._state[end])
            where[k, filled:], state[k, filled:] = where[k, filled - 1], now
        return where, state


def _longest_first(begin: Ints, reach: Ints, unknown: Bools, mine: Bools) -> tuple[Ints, Ints]:
    """Return beginnings and last usable instants of some spells; those of unknown length where there is no other."""
    some = np.flatnonzero(mine & ~unknown) if (mine & ~unknown).any() else np.flatnonzero(mine)
    order = some[np.argsort(-reach[some], kind="stable")]
    return begin[order], reach[order]


def _since(state: Ints) -> int:
    """Return for how many samples the last state has held."""
    changed = np.flatnonzero(np.diff(state) != 0)
    return len(state) - 1 - (int(changed[-1]) + 1 if len(changed) else 0)
