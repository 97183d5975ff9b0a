"""A logged scaling that never changes is the override that was set, such as KUKA's $OV_PRO.

A safety controller that slows the robot by reduced mode, or stops it, leaves that override as it is. If the motion
shows slow-downs, the logged value is taken for the operator's speed slider, and the scaling is inferred.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.segmentation.stored_run import pieces

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.segmentation.stored_run import Run

SAME = 1e-6
"""Maximum difference of equal scalings."""
SLOW = 0.9
"""Maximum inferred scaling of a slowed robot."""
MIN_SLOW = 0.01
"""Minimum share of the inferred rows in which the robot is slow, for the logged scaling to have missed slow-downs."""


def never_changes(runs: Sequence[Run]) -> bool:
    """Return whether every run logs a scaling above zero that never changes within the run."""
    return bool(runs) and all(run.knows_scaling for run in runs) and all(_is_constant(run) for run in runs)


def slow_share(runs: Sequence[Run]) -> float:
    """Return the share of the rows with a known scaling in which runs are slow."""
    slow = known = 0
    for run in runs:
        for _, part in pieces(run):
            known += int(np.isfinite(part.scaling).sum())
            slow += int((part.scaling < SLOW).sum())
    return slow / max(known, 1)


def _is_constant(run: Run) -> bool:
    first = np.nan
    for _, part in pieces(run):
        scaling = part.scaling[np.isfinite(part.scaling)]
        if not len(scaling):
            continue
        first = float(scaling[0]) if np.isnan(first) else first
        if first <= 0.0 or np.abs(scaling - first).max() > SAME:
            return False
    return True
