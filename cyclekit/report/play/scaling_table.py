"""The scaling of a model on states of the operator, such as signals of people, as a table for the script.

Rows are points of the logged motions, columns states.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.estimate.cycle.transit import cells_of
from cyclekit.report.play.packed import numbers_in_steps
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.robot.safety import OnStates
    from cyclekit.schema import Floats

MAX_ENTRIES = 5_000_000
"""Maximum number of entries of a table: a larger one takes minutes to fill, and no page holds it."""


def scaling_table(
    model: OnStates, paths: list[Floats], tracks: OperatorTracks, arrays: dict[str, NDArray[Any]]
) -> dict[str, Any]:
    """Put the table (points, states), the state of each sample and the support into `arrays`.

    Args:
        model: What gives the scaling.
        paths: Points of each task.
        tracks: The operators.
        arrays: Of the page.

    Returns:
        Facts of the rule.

    Raises:
        EstimateError: The table would be too large.
    """
    code, states = cells_of(tracks)
    entries = sum(len(path) for path in paths) * len(states)
    if entries > MAX_ENTRIES:
        raise EstimateError(f"a table of its scaling would have {fixed(entries / 1e6, 0)} million entries")
    found: dict[str, list[NDArray[Any]]] = {"scaling": [], "support": []}
    for path in paths:
        pairs = np.repeat(path, len(states), axis=0), np.tile(states, (len(path), 1))
        scaling = model.scaling_in(*pairs).reshape(len(path), len(states))
        found["scaling"].append(scaling.astype(np.float32).ravel())
        found["support"].append(model.near_logged(*pairs).astype(np.uint8))
    arrays |= {name: np.concatenate(parts) for name, parts in found.items()}
    arrays["who"] = numbers_in_steps(code)
    fastest = max(getattr(model, "levels", ()), default=1.0)
    return {"cells": len(states), "lags": False, "fastest": fastest, "moves": [], "fixed": "fixed_states"}
