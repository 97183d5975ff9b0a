"""`find_levels`: the staircase in a dataset's speed scaling."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.api.arguments import Place, checked
from cyclekit.api.given import path_of, place_of
from cyclekit.dataset.cards import texts
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.errors import UnknownName
from cyclekit.learning.labelling import fixed_levels, scaling_in_time
from cyclekit.scaling.levels import find_staircase, second_opinion
from cyclekit.scaling.levels.clusters import FINDERS
from cyclekit.scaling.levels.staircase import PLATEAU
from cyclekit.scaling.override_log import override_rows
from cyclekit.text.numbers import compact
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from cyclekit.schema import Floats, Ints


@dataclass(frozen=True, repr=False)
class ScalingLevels(Result):
    """The levels of the speed scaling; as a frame one row per level, ascending.

    Attributes:
        method: Method by which they were found.
        levels: The levels, ascending; rounded if within their error.
        means: Mean of the samples on each level; empty if unknown.
        share: Share of the samples on each level.
        noise: Standard deviation of a sample on a level; None if unknown.
        is_staircase: Whether the scaling is a staircase at all.
        picture: File of the picture; None if not drawn.
        warnings: Limits of the answer, one sentence each.
    """

    method: str
    levels: tuple[float, ...]
    means: tuple[float, ...]
    share: tuple[float, ...]
    noise: float | None
    is_staircase: bool
    picture: Path | None = None
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        document = {"method": self.method, "count": len(self.levels), **super().to_dict()}
        return {name: value for name, value in document.items() if name != "warnings"}

    def _frame_rows(self) -> list[dict[str, object]]:
        every = zip(self.levels, self.means or self.levels, self.share, strict=True)
        return [{"level": level, "mean": mean, "share": share} for level, mean, share in every]

    def _lines(self) -> list[str]:
        return [f"{len(self.levels)} levels by {self.method}: {', '.join(map(compact, self.levels))}"]


@checked
def find_levels(dataset: Dataset | Place, *, method: str = "plateau", picture: Place | None = None) -> ScalingLevels:
    """Find the number and values of the levels of the speed scaling; levels fixed in the cell file are used as given.

    Args:
        dataset: A dataset, its folder or its URL.
        method: Name of the method in `scaling.levels.FINDERS`; `plateau` uses the order in time.
        picture: Also draw the levels: a .svg, .png or .pdf file.

    Raises:
        UnknownName: There is no such method.
        DatasetError: There is no dataset, or it has neither positions nor an override.
        OutputError: The picture would replace the dataset, or a file that is not a picture of cyclekit.
    """
    if method not in (PLATEAU, *FINDERS):
        raise UnknownName("levels", "method", method, (PLATEAU, *FINDERS))
    file = path_of(picture)
    check_output(file, "picture", [place_of(dataset)], option="--picture", endings=(".svg", ".png", ".pdf"))
    opened = Dataset.of(dataset)
    values, run, rate_hz = _in_time(opened)
    found = find_staircase(values, run=run, method=method, levels=fixed_levels(opened), rate_hz=rate_hz)
    other = second_opinion(values, found) if method == "plateau" else None
    if file is not None:
        from cyclekit.plots.levels import draw_levels  # local, as importing matplotlib takes long

        draw_levels(file, values, found, rate_hz=rate_hz)
    means = () if found.means is None else tuple(map(float, found.means))
    warnings = tuple(texts([*found.warnings, *([other] if other else [])]))
    levels, share = tuple(map(float, found.levels)), tuple(map(float, found.share))
    return ScalingLevels(method, levels, means, share, found.noise, found.is_staircase, file, warnings)


def _in_time(dataset: Dataset) -> tuple[Floats, Ints, float]:
    """Return the scaling of all samples and their stretches, shape (N,) each, and their rate.

    For a dataset without positions it is the override logged by a safety system, at that log's rate.
    """
    logs = [] if dataset.positions else [dataset.recorded(one.id, "safety") for one in dataset.recordings]
    overrides = [rows for log in logs if log is not None and (rows := override_rows(log)) is not None]
    if not overrides:
        dataset.require_positions()
        frame = dataset.samples(columns=["execution", "t_s", "scaling"])
        return *scaling_in_time(frame, dataset.rate_hz), dataset.rate_hz
    first = np.cumsum([0, *(rows.run[-1] + 1 for rows in overrides[:-1])])
    run = np.concatenate([rows.run + at for rows, at in zip(overrides, first.tolist(), strict=True)])
    return np.concatenate([rows.override for rows in overrides]), run, overrides[0].rate_hz
