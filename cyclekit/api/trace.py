"""`trace_sample`: the lines of the logs that a sample was made of."""

from __future__ import annotations

from cyclekit.api.arguments import Place, checked
from cyclekit.api.given import dataset_of
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.trace import Trace, trace


@checked
def trace_sample(dataset: Dataset | Place, execution: str, at_s: float = 0.001, *, logs: Place | None = None) -> Trace:
    """Say which lines of which logs a sample was made of.

    Args:
        dataset: A dataset, its folder or its URL.
        execution: Name of the execution, or its number from 1.
        at_s: Time since the execution began, s.
        logs: Folder of the logs, or the log itself, to show the lines.

    Raises:
        UnknownName: There is no such execution.
        DatasetError: It has no samples, or the time is after its end.
    """
    return trace(dataset_of(dataset), execution, at_s, logs=logs)
