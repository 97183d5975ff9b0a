"""`write_replay`: executions as a Rerun recording, in 3-D and over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import place_of, trained_of
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.replay.layout import Focus
from cyclekit.replay.recording import ReplayFacts
from cyclekit.replay.recording import write_replay as record


@checked
def write_replay(
    dataset: Dataset | Place,
    execution: str | int | Sequence[str | int],
    out: Place,
    *,
    model: TrainedModel | Place | None = None,
    at: Focus = "slowdown",
    other_cell: bool = False,
    progress: Progress | None = None,
) -> ReplayFacts:
    """Write the replay of one or several executions.

    Args:
        dataset: A dataset, its folder or its URL.
        execution: Name, or number counted from 1; or several of them.
        out: The .rrd file; an existing one is replaced when the new one is complete.
        model: Model of problem `now`: its prediction and zones, by its rule if it has one, are shown with the log.
        at: Start of the playback: `slowdown` (the largest), `error` (the model's largest), or a time in s.
        other_cell: Accept a model of another cell.
        progress: Called with the fraction done and a text.

    Raises:
        UnknownName: The dataset has no such execution.
        ModelError: The model is of another cell.
        CyclekitError: Too many executions, `at` is after the end, or the file cannot be written.
    """
    file = Path(out)
    check_output(file, "replay", [place_of(dataset), place_of(model)], endings=(".rrd",))
    opened = Dataset.of(dataset)
    trained = None if model is None else predictor_of(trained_of(model))
    names = [execution] if isinstance(execution, str | int) else execution
    asked = list(map(str, names))
    return record(opened, asked, file, model=trained, at=at, other_cell=other_cell, progress=progress)
