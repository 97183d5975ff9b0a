"""Finds waits for parts that no task list tells of, such as those of a conveyor.

A task that begins with a part starts a lag after both its agent and the part are there. Parts come one after the other,
so a robot that comes back late waits less: `coupling.unseen_parts` learns their gaps from the waits, and how many wait.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.task_model import PartsCard
from cyclekit.learning.coupling.events.part_visits import PartVisits
from cyclekit.learning.coupling.parts.part_chains import succession
from cyclekit.learning.coupling.parts.unseen_parts import part_arrivals

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.task_times.starts import Waiting
    from cyclekit.schema import Vector

OWN = 0.1
"""Quantile of the lags that counts as lag without a wait."""
MIN_WAIT_S, MIN_STEPS = 1.0, 2.0
"""Minimum of the usual wait for a part, s, and in steps of the times: in whole seconds any lag may look like a wait."""


def find_unseen_parts(one: Waiting) -> tuple[PartsCard | None, Vector]:
    """Return the parts that a task waits for, None if its starts show none, and its lags after them, shape (N,), s."""
    ready_s = np.minimum(one.ready_s(), one.start_s)
    lags_s = one.start_s - one.ready_s()
    numbers, first, row = np.unique([each.run.number for each in one.seen], return_index=True, return_inverse=True)
    runs = [one.seen[n].run for n in first]
    nth = np.array([each.nth for each in one.seen])
    came, left = np.full((2, len(numbers), nth.max() + 1), np.nan)
    came[row, nth], left[row, nth] = ready_s, one.start_s
    visits = PartVisits(came, left, float(np.quantile(one.start_s - ready_s, OWN)))
    waited = visits.waited[row, nth]
    step_s = float(np.diff(np.unique(np.round(one.start_s, 3))).min(initial=np.inf))
    least_s = max(MIN_WAIT_S, MIN_STEPS * step_s)
    is_long = waited.any() and np.median(lags_s[waited]) - visits.own_s > least_s
    begins_s = [run.begin_s for run in runs]
    ends_s = [run.begin_s + run.duration_s for run in runs]
    order = succession([run.session for run in runs], numbers.tolist(), begins_s, ends_s)
    found = part_arrivals(visits, order) if is_long else None
    if found is None:
        return None, lags_s
    first_s, gap_s = (_equally_probable(some) for some in (found.first_s, found.gap_s))
    lags_s = np.where(waited, visits.own_s, lags_s)
    return PartsCard(first_s=first_s, gap_s=gap_s, buffer=found.buffer), lags_s


def _equally_probable(quantiles_s: Sequence[float]) -> tuple[float, ...]:
    """Return the middles between quantiles at evenly spaced levels."""
    if len(quantiles_s) == 1:
        return tuple(quantiles_s)
    return tuple(np.round(0.5 * (np.array(quantiles_s[1:]) + np.array(quantiles_s[:-1])), 4).tolist())
