"""The scaling of a model without a rule of positions, such as trees or signals of people, as a table for the script.

Rows are points of the logged motions, columns cells of operator positions or states, those of `transit`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.estimate.safety import Follower, OnStates, scaling_of
from cyclekit.estimate.spread import logged_support
from cyclekit.estimate.transit import cells_of
from cyclekit.estimate.walk import FINE_STEP_S
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.report.play.scaling_grid import stepwise

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.nominal import NominalTask
    from cyclekit.estimate.safety import Dynamics, SafetyModel
    from cyclekit.estimate.tracks import OperatorTracks
    from cyclekit.schema import Floats, Vector

MAX_ENTRIES = 20_000_000
"""Maximum number of entries of a table: a larger one takes minutes to fill, and no page holds it."""
PATH_S, HUMAN_M = 0.1, 0.03
"""Nominal time between the points of a motion, and edge of the cells, where the operator's position counts."""
GRID = 200
"""Number of steps from 0 to 1 to which s is rounded; levels of the model are exact."""


def thinned(legs: Mapping[str, NominalTask]) -> dict[str, NominalTask]:
    """Return the tasks with points PATH_S apart: rows of the table."""
    return {name: replace(leg, xyz_m=_thin(leg)) for name, leg in legs.items()}


def _thin(leg: NominalTask) -> Floats:
    points = max(2, round(leg.nominal_s / PATH_S) + 1)
    phase = np.linspace(0.0, len(leg.xyz_m) - 1, points)
    return np.column_stack([np.interp(phase, np.arange(len(leg.xyz_m)), axis) for axis in leg.xyz_m.T])


def scaling_table(
    model: SafetyModel,
    dynamics: Dynamics,
    dataset: Dataset,
    paths: list[Floats],
    tracks: OperatorTracks,
    arrays: dict[str, NDArray[Any]],
) -> dict[str, Any]:
    """Put the table (points, cells), the cell of each sample and the support into `arrays`; return facts of the rule.

    Args:
        model: What gives the scaling.
        dynamics: How s follows it: with hysteresis there are two tables.
        dataset: The logs.
        paths: Points of each task, as `thinned`.
        tracks: The operators.
        arrays: Of the page.

    Raises:
        EstimateError: The table would be too large.
    """
    code, cells = cells_of(tracks, HUMAN_M)
    entries = sum(len(path) for path in paths) * len(cells)
    if entries > MAX_ENTRIES:
        raise EstimateError(f"a table of its scaling would have {entries / 1e6:.0f} million entries")
    known = model if isinstance(model, OnStates) else logged_support(dataset)
    lags, levels = _lags(model, dynamics), tuple(getattr(model, "levels", ()))
    book = np.unique([*levels[: 255 - GRID], *np.linspace(0.0, 1.0, GRID + 1)])
    found: dict[str, list[NDArray[np.uint8]]] = {"scaling": [], "rising": [], "support": []}
    for robot_m, human_m in _pairs(paths, cells):
        asked = _bounds(model, dynamics, robot_m, human_m) if lags else [scaling_of(model, robot_m, human_m)]
        for name, scaling in zip(("scaling", "rising"), asked, strict=False):
            found[name].append(_nearest(book, scaling).reshape(-1, len(cells)))
        found["support"].append(known.near_logged(robot_m, human_m).astype(np.uint8).reshape(-1, len(cells)))
    arrays |= {name: stepwise(np.concatenate(parts)) for name, parts in found.items() if parts}
    arrays |= {"values": book.astype(np.float32), "people_cells": code.astype(np.uint16).ravel()}
    facts: dict[str, Any] = {"cells": len(cells), "lags": lags, "fastest": max(levels, default=1.0), "moves": []}
    if isinstance(model, OnStates):
        return {**facts, "holds": True, "absent": None, "fixed": "fixed_states"}
    return {**facts, "holds": False, "absent": len(cells) - 1, "fixed": "fixed_table"}


def _lags(model: SafetyModel, dynamics: Dynamics) -> bool:
    if isinstance(model, RuleSafety):
        return model.lags
    return not isinstance(model, OnStates) and bool(dynamics.hysteresis_m)


def _pairs(paths: list[Floats], cells: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield each point of a task with each cell, task by task."""
    for path in paths:
        yield np.repeat(path, len(cells), axis=0), np.tile(cells, (len(path), 1))


def _bounds(model: SafetyModel, dynamics: Dynamics, robot_m: Floats, human_m: Floats) -> list[Vector]:
    """Return the value to which s must fall, and the value to which it may rise."""
    rising, falling = Follower(model, dynamics, FINE_STEP_S).bounds(robot_m, human_m)
    return [np.maximum(falling, rising), rising]


def _nearest(book: Vector, values: Vector) -> NDArray[np.uint8]:
    """Return the index of the nearest value in an ascending book of at most 256."""
    middles = (book[1:] + book[:-1]) / 2
    return np.searchsorted(middles, np.clip(values, 0.0, 1.0)).astype(np.uint8)
