"""Self-labelling: the levels of a speed scaling, and the level of every sample.

The entry point is `staircase`. `plateaus`, `dbscan` and `kmeans` find the values, `clusters` turns them into levels,
and `labels` assigns samples to them.
"""

from __future__ import annotations

from cyclekit.scaling.levels.clusters import FINDERS
from cyclekit.scaling.levels.dbscan import UNKNOWN, dbscan_1d
from cyclekit.scaling.levels.labels import TOLERANCE, label, label_in_time, unbroken
from cyclekit.scaling.levels.staircase import PLATEAU, Staircase, find_staircase, second_opinion

__all__ = [
    "FINDERS", "PLATEAU", "TOLERANCE", "UNKNOWN", "Staircase", "dbscan_1d", "find_staircase", "label", "label_in_time",
    "second_opinion", "unbroken",
]  # fmt: skip
