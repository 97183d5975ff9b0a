"""What several people who are taken for one leave open: the robot's waits in an order that was never logged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.estimate.finding import Finding
from cyclekit.estimate.statistics.resample import Z95
from cyclekit.learning.coupling.several_people import several_people
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from cyclekit.dataset.dataset import Dataset


def open_wait(dataset: Dataset, executions: Collection[str], mean_s: float) -> float:
    """Return how far the robot's waits in another order may be off to either side, as a share of the cycle.

    In another order they may vanish or double, or differ as much as those of single executions. 0 where one person is
    seen at a time: then it is learned who waits for whom.

    Args:
        dataset: The logs.
        executions: The executions that count.
        mean_s: Their mean duration, s.
    """
    if not several_people(dataset.recordings):
        return 0.0
    tasks = dataset.tasks().filter(pl.col("execution").is_in(list(executions)))
    waits_s = tasks.group_by("execution").agg(pl.col("wait_s").fill_null(0.0).sum())["wait_s"].to_numpy()
    spread_s = Z95 * float(waits_s.std(ddof=1)) if len(waits_s) > 1 else 0.0
    return max(float(waits_s.mean()), spread_s) / mean_s if len(waits_s) else 0.0


def several_found(dataset: Dataset) -> Iterator[Finding]:
    """Yield a finding if the logs show several people at once."""
    if share := several_people(dataset.recordings):
        text = (
            f"in {percent(share)} of the samples with people several are seen at once; they are taken for "
            "one, the nearest "
            "to the TCP, so it is not learned who waits for whom: in other orders the robot's waits may vanish or "
            "double, which the interval of the mean covers"
        )
        yield Finding("several-people", "amber", text, "keep one person's track in the log", covered=False)
