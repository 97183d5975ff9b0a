"""Which of many logged executions or gaps are learned from: as many as allowed, spread over all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Ints

RUN = 8
"""Number of executions that follow each other in a subset: parts may come on from one to the next."""


def evenly(count: int, most: int) -> Ints:
    """Return numbers of `count` things, evenly spaced: all of them, or `most` if there are more."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def in_runs(count: int, most: int) -> Ints:
    """Return the same in runs of RUN that follow each other; `most` is a multiple of RUN."""
    if count <= most:
        return np.arange(count)
    starts = np.linspace(0, count - RUN, most // RUN).astype(np.int64)
    return np.asarray((starts[:, None] + np.arange(RUN)).ravel())
