"""Self-labelling: the levels of a speed scaling, and the level of every sample.

`staircase` asks, `plateaus`, `dbscan`, `kmeans` and `mixtures` find, `levels` and `labels` make of it what is used.
"""

from __future__ import annotations

from cyclekit.scaling.levels.dbscan import UNKNOWN, dbscan_1d
from cyclekit.scaling.levels.labels import TOLERANCE, label, label_in_time, unbroken
from cyclekit.scaling.levels.staircase import METHODS, Staircase, find_staircase, second_opinion

__all__ = [
    "METHODS", "TOLERANCE", "UNKNOWN", "Staircase", "dbscan_1d", "find_staircase", "label", "label_in_time",
    "second_opinion", "unbroken",
]  # fmt: skip
