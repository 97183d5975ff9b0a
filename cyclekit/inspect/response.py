"""How the speed override follows the operator in time, as read from the logs of a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.scaling.response import RAMP_ROWS

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset


@dataclass(frozen=True)
class ResponseFacts:
    """The response of the safety system; None = not seen in the logs.

    Attributes:
        latency_s: Reaction time: from the crossing of a threshold to the beginning of the change.
        down_per_s, up_per_s: Change of the scaling per second; None where it jumps.
        hysteresis_m: How much farther away than where the robot slowed the operator is when it speeds up again.
        hold_s: How much later than it slows down the robot speeds up again.
        changes: Changes of level that were seen.
        rows: Rows of the robot's log in the shortest ramp, at its median rate; None without a ramp.
    """

    latency_s: float | None
    down_per_s: float | None
    up_per_s: float | None
    hysteresis_m: float | None
    hold_s: float | None
    changes: int
    rows: float | None

    @property
    def few_rows(self) -> bool:
        """Whether a rate is read from the share of rows between levels, as single ramps have too few rows."""
        return self.rows is not None and self.rows < RAMP_ROWS + 1


def response_facts(dataset: Dataset) -> ResponseFacts | None:
    """Return the response that was read at ingest; None where no change of level was seen."""
    read = dataset.card.dynamics
    if not read.changes:
        return None
    rates = [rate for rate in (read.ramp_down_per_s, read.ramp_up_per_s) if rate]
    rates_hz = [record.rate_hz for record in dataset.recordings if "robot" in record.tables and record.rate_hz]
    rows = None
    if rates and rates_hz and len(dataset.levels) > 1:
        rows = float(np.median(rates_hz)) * float(np.diff(dataset.levels).min()) / max(rates)
    return ResponseFacts(
        latency_s=read.latency_s,
        down_per_s=read.ramp_down_per_s,
        up_per_s=read.ramp_up_per_s,
        hysteresis_m=read.hysteresis_m,
        hold_s=read.hold_s,
        changes=read.changes,
        rows=rows,
    )
