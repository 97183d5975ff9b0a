"""Response of the speed override over time, from the logs of a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards import DynamicsCard, plain
from cyclekit.scaling.response import RAMP_ROWS

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset


@dataclass(frozen=True)
class ResponseFacts:
    """The response of the safety system.

    Attributes:
        read: The response found at ingest.
        rows: Number of rows of the robot log in the shortest ramp, at its median rate; None without a ramp.
    """

    read: DynamicsCard
    rows: float | None

    @property
    def few_rows(self) -> bool:
        """Whether a rate comes from the share of rows between levels, as single ramps have too few rows."""
        return self.rows is not None and self.rows < RAMP_ROWS + 1

    def to_dict(self) -> dict[str, float | None]:
        """Return plain JSON values."""
        told = {
            name.removeprefix("ramp_"): value
            for name, value in plain(self.read, nulls=True).items()
            if name != "spread_m"
        }
        return {**told, "rows": self.rows}


def response_facts(dataset: Dataset) -> ResponseFacts | None:
    """Return the response found at ingest; None without changes of level."""
    read = dataset.card.dynamics
    if not read.changes:
        return None
    rates = [rate for rate in (read.ramp_down_per_s, read.ramp_up_per_s) if rate]
    rates_hz = [record.rate_hz for record in dataset.recordings if "robot" in record.tables and record.rate_hz]
    rows = None
    if rates and rates_hz and len(dataset.levels) > 1:
        rows = float(np.median(rates_hz)) * float(np.diff(dataset.levels).min()) / max(rates)
    return ResponseFacts(read, rows)
