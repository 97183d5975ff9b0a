"""Whether whole executions speak against what was learned on who waits for whom.

Single waits may obey a condition of a kind that the learner knows, and whole executions still go otherwise: where a
zone is for one at a time, the k-th visit of one agent follows now and then the k-th of the other. So what counts is how
far the durations of whole executions, each with its own order, are from their rollouts. How waits are found is left to
`coupling` and `task_times`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit

from cyclekit.dataset.cards.notes import UNPROVEN, note
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.dataset.cards import Note

FEWEST = 3
"""Minimum number of executions: fewer give no standard error."""
CHANCE = 0.05
"""Maximum probability by chance. A level of statistics: for a cell with a zone for one at a time it is 0.006 and less,
for six in which the waits are right above 0.7, so half and twice of it decide the same."""


def unproven(with_waits: Mapping[str, float], without: Mapping[str, float]) -> Note | None:
    """Return a note if squared errors are larger with the learned waits than without, by more than chance; else None.

    Args:
        with_waits: Logarithm of logged over mean rolled-out duration, by execution.
        without: The same where waits are a part of the work.
    """
    names = sorted(with_waits.keys() & without.keys())
    if len(names) < FEWEST:
        return None
    off = np.array([[each[name] for name in names] for each in (with_waits, without)])
    squares = (off - off.mean(axis=1, keepdims=True)) ** 2  # an estimate is corrected by the mean
    worse = squares[0] - squares[1]
    error = worse.std(ddof=1) / len(names) ** 0.5
    if worse.mean() <= float(stdtrit(len(names) - 1, 1.0 - CHANCE)) * error:
        return None
    scatter, other = np.sqrt(squares.mean(axis=1)).tolist()
    text = (
        f"what was learned on who waits for whom is not used: {len(names)} logged executions are off by "
        f"{percent(scatter, 1)} from their rollouts with these waits, and by {percent(other, 1)} with waits "
        "as a part of the work"
    )
    return note(UNPROVEN, text=text)
