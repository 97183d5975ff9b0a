"""The scaling of a network on a grid that the script interpolates: points of the motions by operator positions.

A classifier's scaling is nearly a step, which no coarse grid can locate. So the table holds the log-odds of its levels,
which are smooth across the step, and the script turns interpolated log-odds into the scaling.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.dataset.unknown_height import in_plane
from cyclekit.errors import EstimateError
from cyclekit.estimate.safety import SURE, Classifier, Follower, OnStates, around, scaling_of
from cyclekit.estimate.walk import FINE_STEP_S
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.networks.trees import Trees
from cyclekit.learning.rules.safety import RuleSafety

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.estimate.safety import Dynamics, SafetyModel
    from cyclekit.schema import Floats, Ints

FEW_ENTRIES, FEW_BYTES = 7_000_000, 1_300_000
"""Maximum number of entries of a grid, and of its bytes when compressed: else the next coarser one is taken."""
EDGES_M, HEIGHT_M = (0.04, 0.05, 0.07, 0.1, 0.14), 0.24
"""Distances between nodes on the floor that are tried, and distance between heights of nodes."""
CERTAIN = 16.0
"""Maximum size of the log-odds in the table: larger ones are cut off."""
STEPS = 100
"""Number of steps into which the range of the table's values is divided."""
PARTS = 8
"""Number of positions between two samples of an operator at which his cell is looked up."""
JUMP_M = 1.0
"""Distance between two samples from which on they belong to different tracks."""
FLAT = -1000
"""Height of the nodes for operators of unknown height, in place of a multiple of HEIGHT_M."""


def smooth(model: SafetyModel) -> bool:
    """Return whether a model's scaling can be interpolated: a network's can; rules and trees have steps."""
    if isinstance(model, (OnStates, RuleSafety)):
        return False
    return not isinstance(getattr(model, "weights", None), Trees)


def scaling_grid(
    model: SafetyModel, dynamics: Dynamics, paths: list[Floats], people_m: Floats, arrays: dict[str, NDArray[Any]]
) -> dict[str, object]:
    """Put the table, its nodes and its values into `arrays`; return facts of the rule.

    Args:
        model: The network.
        dynamics: How s follows it: with hysteresis there are two tables.
        paths: Points of each task (points, 3).
        people_m: Positions of the operators, one after the other in time, shape (N, 3).
        arrays: Of the page.

    Raises:
        EstimateError: The table would be too large.
    """
    book = _book(model)
    for edge_m in EDGES_M:
        nodes = grid_nodes(people_m, edge_m)
        if sum(len(path) for path in paths) * len(nodes) * max(len(book) - 1, 1) > FEW_ENTRIES:
            continue
        found = _tables(model, dynamics, paths, _positions(nodes, edge_m, people_m))
        size = sum(len(zlib.compress(table.tobytes(), 1)) for table in found.values())
        if size <= FEW_BYTES:
            break
    else:
        raise EstimateError("the operator's positions and the robot's motions are too many for a table of the scaling")
    arrays |= found
    arrays["nodes"] = nodes.astype(np.int16)
    without = model.card.scaling_without_operator
    heights = nodes[:, 2][nodes[:, 2] != FLAT]
    return {
        "grid": {"edge_m": edge_m, "height_m": HEIGHT_M, "layers": len(np.unique(heights)), "steps": STEPS},
        "book": book,
        "certain": CERTAIN,
        "lags": bool(dynamics.hysteresis_m),
        "alone": 1.0 if without is None else without,
        "fastest": max(book, default=1.0),
        "moves": [],
        "fixed": "fixed_table",
    }


def _tables(model: SafetyModel, dynamics: Dynamics, paths: list[Floats], where: Floats) -> dict[str, NDArray[np.uint8]]:
    """Return each table (tables of log-odds or one of s, points, nodes), as steps from point to point."""
    found: dict[str, list[NDArray[np.uint8]]] = {}
    for path in paths:
        robot_m, human_m = np.repeat(path, len(where), axis=0), np.tile(where, (len(path), 1))
        for name, values in _values(model, dynamics, robot_m, human_m).items():
            steps = np.round(values * STEPS).astype(np.uint8)
            found.setdefault(name, []).append(steps.reshape(len(path), len(where), -1).transpose(2, 0, 1))
    joined = {name: np.concatenate(parts, axis=1) for name, parts in found.items()}
    return {name: np.array([stepwise(table) for table in tables]) for name, tables in joined.items()}


def grid_nodes(people_m: Floats, edge_m: float) -> Ints:
    """Return the corners (N, 3) of all cells that operators cross, as multiples of `edge_m` (x, y) and HEIGHT_M.

    Heights that are nearly alike share one layer of nodes, 0; nodes for unknown heights have the height FLAT.

    Args:
        people_m: Positions of the operators, one after the other in time, shape (N, 3); NaN where unknown.
        edge_m: Distance between nodes on the floor.
    """
    steps = np.diff(people_m, axis=0)
    alike = np.hypot(steps[:, 0], steps[:, 1]) < JUMP_M
    parts = np.arange(1, PARTS)[:, None, None] / PARTS
    between = (people_m[:-1][alike] + steps[alike] * parts).reshape(-1, 3)
    every = np.concatenate([people_m, between])
    every = every[np.isfinite(every[:, 0])]
    known = np.isfinite(every[:, 2])
    heights_m = every[known, 2]
    cells = np.full((len(every), 3), FLAT)
    cells[:, :2] = np.floor(every[:, :2] / edge_m)
    layered = len(heights_m) > 0 and float(np.ptp(heights_m)) > HEIGHT_M / 4
    cells[known, 2] = np.floor(heights_m / HEIGHT_M) if layered else 0
    cells = np.unique(cells, axis=0)
    found = [cells + np.array([x, y, 0]) for x in (0, 1) for y in (0, 1)]
    if layered:
        found += [some[some[:, 2] != FLAT] + np.array([0, 0, 1]) for some in found]
    return np.unique(np.concatenate(found), axis=0)


def _positions(nodes: Ints, edge_m: float, people_m: Floats) -> Floats:
    """Return the positions of nodes (N, 3), m; the height is NaN if operators there have none."""
    found: Floats = nodes * np.array([edge_m, edge_m, HEIGHT_M])
    known = nodes[:, 2] != FLAT
    if len(np.unique(nodes[known, 2])) == 1:
        found[known, 2] = np.nanmean(people_m[:, 2])
    found[~known, 2] = np.nan
    return found


def _book(model: SafetyModel) -> list[float]:
    """Return the levels of a classifier, ascending; of other networks nothing."""
    return list(model.levels) if isinstance(model, Classifier) and is_classifier(model.network) else []


def _values(model: SafetyModel, dynamics: Dynamics, robot_m: Floats, human_m: Floats) -> dict[str, Floats]:
    """Return what the tables hold for pairs of positions, 0 to 1: s (N, 1); of a classifier log-odds (N, P - 1).

    With hysteresis, `scaling` is the value down to which s must fall, and `rising` that up to which it may rise.
    """
    if not isinstance(model, Classifier) or not is_classifier(model.network):
        if not dynamics.hysteresis_m:
            return {"scaling": scaling_of(model, robot_m, human_m)[:, None]}
        rising, falling = Follower(model, dynamics, FINE_STEP_S).bounds(robot_m, human_m)
        return {"scaling": np.maximum(falling, rising)[:, None], "rising": rising[:, None]}
    human_m = in_plane(robot_m, human_m)
    log_odds, sure = _log_odds(model, robot_m, human_m)
    if not dynamics.hysteresis_m:
        return {"scaling": log_odds}
    falling, rising, near = log_odds.copy(), log_odds.copy(), np.flatnonzero(~sure)
    for moved_m in around(robot_m[near], human_m[near], dynamics.hysteresis_m / 2):
        moved, _ = _log_odds(model, robot_m[near], moved_m)
        falling[near], rising[near] = np.maximum(falling[near], moved), np.minimum(rising[near], moved)
    return {"scaling": falling, "rising": rising}


def _log_odds(model: Classifier, robot_m: Floats, human_m: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the log-odds that s is above each level but the last (N, P - 1), and whether one level is sure (N,).

    The log-odds are cut off at CERTAIN, and scaled so that 0 is certainly not and 1 certainly.
    """
    found = model.probabilities(np.column_stack([robot_m, human_m]).astype(np.float32))
    least = np.finfo(np.float64).tiny
    above = np.cumsum(found[:, ::-1], axis=1)[:, ::-1][:, 1:]
    below = np.cumsum(found, axis=1)[:, :-1]
    log_odds = np.log(np.maximum(above, least)) - np.log(np.maximum(below, least))
    return (np.clip(log_odds / CERTAIN, -1.0, 1.0) + 1.0) / 2.0, found.max(axis=1) >= SURE


def stepwise(table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the differences from point to point instead of the values: they wrap, and take a third of the space."""
    return np.diff(table, axis=0, prepend=np.zeros_like(table[:1]))
