"""Self-labelling of a dataset: its speed scaling in unbroken stretches of time, and the staircase in it.

`scaling.levels` finds levels in a series of values; here it is decided which values belong together in time (one
execution, no gap) and whether the cell file has fixed the levels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.time_grid import stretches
from cyclekit.scaling.levels import Staircase, find_staircase

if TYPE_CHECKING:
    from cyclekit.dataset.cards import Note
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Ints


def scaling_in_time(frame: pl.DataFrame, rate_hz: float) -> tuple[Floats, Ints]:
    """Return the scaling of every row of SAMPLES (NaN = unknown) and its stretch, shape (N,) each."""
    return frame["scaling"].fill_null(np.nan).to_numpy(), stretches(frame, rate_hz)


def fixed_levels(dataset: Dataset) -> tuple[float, ...] | None:
    """Return the levels that the cell file of the dataset fixes, None where it leaves them to be found."""
    return dataset.card.settings.levels or None


def without_slider(dataset: Dataset, frame: pl.DataFrame) -> tuple[pl.DataFrame, Note | None]:
    """Return the rows with the operator's slider taken out of their scaling, where it differs between executions.

    Args:
        dataset: Whose rows.
        frame: All rows of some executions; an execution's slider is seen in its own rows.

    Returns:
        The rows, and what was done; the same rows and None where no slider is seen.
    """
    found = staircase_of(dataset, frame)
    if found.slider is None:
        return frame, None
    said = next(one for one in found.warnings if one.code == "levels-with-slider")
    return frame.with_columns(scaling=pl.col("scaling") / pl.Series(found.slider).fill_nan(None)), said


def staircase_of(dataset: Dataset, frame: pl.DataFrame, method: str = "plateau") -> Staircase:
    """Find the staircase in rows of a dataset, or label them by the levels that its cell file fixes.

    Args:
        dataset: Whose rows.
        frame: Table SAMPLES or a part of it, rows of one execution together and in order of time.
        method: `plateau` or one of `steps.FINDERS`.
    """
    scaling, run = scaling_in_time(frame, dataset.rate_hz)
    return find_staircase(scaling, run=run, method=method, levels=fixed_levels(dataset), rate_hz=dataset.rate_hz)
