"""Presence: slow while an operator is anywhere in the cell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import RegionCard
from cyclekit.learning.rules.families.family import Family

if TYPE_CHECKING:
    from cyclekit.learning.rules.cuts import LimitRows


def _fit(rows: LimitRows, start: RegionCard | None) -> RegionCard:
    del start
    present = np.isfinite(rows.positions.floor_m[:, 0])
    slow = float(rows.weight[present & rows.slow].sum())
    return RegionCard(anywhere=2 * slow > float(rows.weight[present].sum()))


PRESENCE = {"presence": Family(_fit, may_lag=False)}
