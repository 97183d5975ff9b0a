"""A network for the script: its weights, and a table of the positions where it is certain.

The script evaluates the network near the edges of its levels, where single cycles are decided: no table that fits into
a page is fine enough there. Elsewhere the table saves the evaluation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.dataset.unknown_height import inputs_in_plane
from cyclekit.errors import EstimateError
from cyclekit.estimate.robot.safety import SURE, scaling_of
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.networks.weights import Weights

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.robot.safety import Dynamics, SafetyModel
    from cyclekit.schema import Floats, Ints

FEW_ENTRIES = 2_500_000
"""Maximum number of entries of the table, each an evaluation of the network: else the next coarser one is taken."""
EDGES_M, HEIGHT_M = (0.04, 0.05, 0.07, 0.1, 0.14, 0.2), 0.24
"""Distances between nodes on the floor that are tried, and distance between heights of nodes."""
PATH_S = 0.1
"""Nominal time between the points of a motion at which the table has rows."""
ASK = 255
"""Entry of the table where the network is to be evaluated."""
DOUBT = 1e-9
"""Maximum probability of all other levels for a level that the table holds in place of the network's answer: so small
that between two nodes and two points of a motion the level stays the likeliest."""
ENDS = 0.0, 1.0
"""Values of a network without levels that the table holds: where it is cut off, it is the same all around."""
PARTS = 8
"""Number of positions between two samples of an operator at which his cell is looked up."""
JUMP_M = 1.0
"""Distance between two samples from which on they belong to different tracks."""
FLAT = -1000
"""Height of the nodes for operators of unknown height, in place of a multiple of HEIGHT_M."""


def scaling_grid(
    model: SafetyModel, dynamics: Dynamics, paths: list[Floats], people_m: Floats, arrays: dict[str, NDArray[Any]]
) -> dict[str, object]:
    """Put the network, the table and its nodes into `arrays`; return facts of the rule.

    Args:
        model: The network.
        dynamics: How s follows it.
        paths: Points of each task at the rows of the table (points, 3).
        people_m: Positions of the operators, one after the other in time, shape (N, 3).
        arrays: Of the page.

    Raises:
        EstimateError: It is no network of feed-forward layers, or the table would be too large.
    """
    if not isinstance(model, TrainedModel) or not isinstance(model.weights, Weights) or model.weights.recurrent:
        raise EstimateError("the model is neither a rule nor a network of the present positions")
    for edge_m in EDGES_M:
        nodes = grid_nodes(people_m, edge_m)
        if sum(len(path) for path in paths) * len(nodes) <= FEW_ENTRIES:
            break
    else:
        raise EstimateError("the operator's positions and the robot's motions are too many for a table of the scaling")
    table = _table(model, paths, _positions(nodes, edge_m, people_m))
    arrays |= {"scaling": table, "nodes": nodes.astype(np.int16), "weights": _flat(model.weights)}
    without = model.card.scaling_without_operator
    heights = nodes[:, 2][nodes[:, 2] != FLAT]
    return {
        "grid": {"edge_m": edge_m, "height_m": HEIGHT_M, "layers": len(np.unique(heights)), "ask": ASK},
        "rows": [len(path) for path in paths],
        "network": {
            "widths": [model.weights.layers[0][0].shape[0], *(bias.size for _, bias in model.weights.layers)],
            "softmax_after": model.weights.softmax_after,
            "known": len(model.weights.known),
            "distance": model.weights.distance is not None,
        },
        "classifies": is_classifier(model.network),
        "book": list(model.levels) if is_classifier(model.network) else list(ENDS),
        "sure": SURE,
        "lags": bool(dynamics.hysteresis_m),
        "margin_m": dynamics.hysteresis_m or 0.0,
        "alone": 1.0 if without is None else without,
        "fastest": max(model.levels, default=1.0),
        "moves": [],
        "fixed": "fixed_table",
    }


def thinned(leg: NominalTask) -> Floats:
    """Return points of a motion PATH_S apart, shape (points, 3): rows of the table."""
    points = max(2, round(leg.nominal_s / PATH_S) + 1)
    phase = np.linspace(0.0, len(leg.xyz_m) - 1, points)
    return np.column_stack([np.interp(phase, np.arange(len(leg.xyz_m)), axis) for axis in leg.xyz_m.T])


def _flat(weights: Weights) -> NDArray[np.float32]:
    """Return weight (inputs, outputs) and bias of each layer, one after the other."""
    return np.concatenate([part.ravel() for layer in weights.layers for part in layer]).astype(np.float32)


def _table(model: TrainedModel, paths: list[Floats], where: Floats) -> NDArray[np.uint8]:
    """Return the table (points, nodes): the number of a value of the book, ASK where none is certain."""
    found = []
    for path in paths:
        robot_m, human_m = np.repeat(path, len(where), axis=0), np.tile(where, (len(path), 1))
        found.append(_entries(model, robot_m, human_m).reshape(len(path), len(where)))
    return stepwise(np.concatenate(found))


def _entries(model: TrainedModel, robot_m: Floats, human_m: Floats) -> NDArray[np.uint8]:
    if is_classifier(model.network):
        chance = model.probabilities(inputs_in_plane(np.column_stack([robot_m, human_m]).astype(np.float32)))
        number = chance.argmax(axis=1)
        np.put_along_axis(chance, number[:, None], 0.0, axis=1)
        sure = chance.sum(axis=1) <= DOUBT
    else:
        scaling = scaling_of(model, robot_m, human_m)
        number, sure = np.round(scaling), np.isin(scaling, ENDS)
    return np.where(sure, number, ASK).astype(np.uint8)


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


def stepwise(table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the differences from point to point instead of the values: they wrap, and take a third of the space."""
    return np.diff(table, axis=0, prepend=np.zeros_like(table[:1]))
