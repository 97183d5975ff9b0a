"""`read_safety_function`: levels, thresholds and zones, read back from logs and network."""

from __future__ import annotations

from cyclekit.api.arguments import Place, checked
from cyclekit.api.given import path_of, place_of, trained_of
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.safety_function.answer import SafetyFunction, read_zones
from cyclekit.learning.safety_function.picture import zones_svg
from cyclekit.storage.atomic import write_text


@checked
def read_safety_function(
    model: TrainedModel | Place,
    dataset: Dataset | Place,
    *,
    out: Place | None = None,
    seed: int = 0,
    other_cell: bool = False,
) -> SafetyFunction:
    """Read the safety function back: thresholds in metres where a distance explains it, a map of the floor else.

    Args:
        model: A model of problem `now` with levels, its folder or its URL.
        dataset: Logs with positions and scaling.
        out: Also draw it here, `.svg`.
        seed: Of the resampling behind the intervals.
        other_cell: Ask a model of another cell too.

    Raises:
        ModelError: The model predicts something else than the present scaling, knows no levels, or is of another cell.
        DatasetError: Too few samples have positions and a scaling.
    """
    file = path_of(out)
    check_output(file, "picture", [place_of(model), place_of(dataset)], endings=(".svg",))
    found = read_zones(trained_of(model), Dataset.of(dataset), seed=seed, other_cell=other_cell)
    if file is not None:
        write_text(file, zones_svg(found))
    return found
