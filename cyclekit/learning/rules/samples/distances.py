"""Distances between robot and operator that a safety function may use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from cyclekit.schema import Vector


TO_TCP, TO_TCP_FLAT = "distance TCP to operator", "distance TCP to operator on the floor"
TO_BASE, TO_LINK = "distance robot base to operator on the floor", "distance nearest link to operator"

DISTANCES: Mapping[str, Callable[[NDArray[np.float64], NDArray[np.float64]], Vector]] = {
    TO_TCP: lambda robot, human: _norm(robot - human),
    TO_TCP_FLAT: lambda robot, human: _norm((robot - human)[:, :2]),
    TO_BASE: lambda _robot, human: _norm(human[:, :2]),
}
"""Distances gamma by name, from TCP (N, 3) and operator (N, 3) in the base frame, m; shape (N,)."""


def to_links(points_m: NDArray[np.float64], human_m: NDArray[np.float64]) -> Vector:
    """Return the distance of the nearest link, shape (N,), m.

    Args:
        points_m: Joints from base to TCP, shape (N, J, 3), m; links are the line segments between them.
        human_m: The operator, shape (N, 3), m.
    """
    start, way = points_m[:, :-1], np.diff(points_m, axis=1)
    to_human = human_m[:, None] - start
    part = np.einsum("nji,nji->nj", to_human, way) / np.maximum(np.einsum("nji,nji->nj", way, way), 1e-12)
    apart = to_human - np.clip(part, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(apart, axis=2).min(axis=1))


def _norm(way: NDArray[np.float64]) -> Vector:
    return np.asarray(np.linalg.norm(way, axis=1))
