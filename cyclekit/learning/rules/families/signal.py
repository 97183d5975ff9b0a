"""A signal: slow while it has a value, such as the bit of a scanner's field."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import RegionCard, SignalCard
from cyclekit.learning.rules.families.family import Family

if TYPE_CHECKING:
    from cyclekit.learning.rules.cuts import LimitRows

SIGNALS = "signals"
"""Name of the requirement that rows hold signals."""


def _fit(rows: LimitRows, start: RegionCard | None) -> RegionCard:
    """Return the signal and value that explain best which rows are slow; empty if none explains anything."""
    del start
    tried = [
        RegionCard(signals=(SignalCard(signal=name, value=str(value), delay_s=delay_s),))
        for (name, delay_s), values in rows.positions.signals.items()
        for value in np.unique(values)
        if value
    ]
    return min([RegionCard(), *tried], key=rows.wrong)


SIGNAL = {"signal": Family(_fit, (SIGNALS,), may_lag=False)}
