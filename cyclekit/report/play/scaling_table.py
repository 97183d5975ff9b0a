"""The scaling of a model on states of the operator, such as signals of people, as a table for the script.

Rows are points of the logged motions, columns states. Where s changes in a step between two points, the table holds
the place of the step.
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
    from cyclekit.schema import Floats, Ints, Singles

MAX_ENTRIES = 5_000_000
"""Maximum number of entries of a table: a larger one takes minutes to fill, and no page holds it."""
HALVINGS = 24
"""Number of halvings of the way between two points in which a step is sought."""


def scaling_table(
    model: OnStates, paths: list[Floats], tracks: OperatorTracks, arrays: dict[str, NDArray[Any]]
) -> dict[str, Any]:
    """Put the table (points, states), its steps, the state of each sample and the support into `arrays`.

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
    found: dict[str, list[NDArray[Any]]] = {"scaling": [], "support": [], "steps": [], "step_parts": []}
    first = 0
    for path in paths:
        pairs = np.repeat(path, len(states), axis=0), np.tile(states, (len(path), 1))
        scaling = model.scaling_in(*pairs).reshape(len(path), len(states))
        entry, part = _steps(model, path, states, scaling)
        found["scaling"].append(scaling.astype(np.float32).ravel())
        found["support"].append(model.near_logged(*pairs).astype(np.uint8))
        found["steps"].append((entry + first).astype(np.int32))
        found["step_parts"].append(part)
        first += scaling.size
    arrays |= {name: np.concatenate(parts) for name, parts in found.items()}
    arrays["who"] = numbers_in_steps(code)
    fastest = max(getattr(model, "levels", ()), default=1.0)
    return {"cells": len(states), "lags": False, "fastest": fastest, "moves": [], "fixed": "fixed_states"}


def _steps(model: OnStates, path: Floats, states: Floats, scaling: Floats) -> tuple[Ints, Singles]:
    """Return the entries (S,) after which s changes in one step, and the part of the way to the next point (S,)."""
    point, state = np.nonzero(np.diff(scaling, axis=0))
    before, after = scaling[point, state], scaling[point + 1, state]
    begin, way = path[point], path[point + 1] - path[point]
    low, high = np.zeros(len(point)), np.ones(len(point))
    sharp = np.ones(len(point), np.bool_)
    for _ in range(HALVINGS if len(point) else 0):
        middle = (low + high) / 2
        found = model.scaling_in(begin + way * middle[:, None], states[state])
        sharp &= (found == before) | (found == after)
        low, high = np.where(found == before, middle, low), np.where(found == before, high, middle)
    return (point * len(states) + state)[sharp], high[sharp].astype(np.float32)
