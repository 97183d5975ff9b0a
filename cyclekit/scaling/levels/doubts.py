"""Reasons why a speed scaling may not have discrete levels, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

_MANY_LEVELS = 12
"""More levels than any safety configuration offers: then the values are not a staircase."""
_WIDE = 6.0
"""A cluster whose middle 90 % spread over more than this many eps is not a single level."""
_MUCH_UNKNOWN = 0.2
_LITTLE_HELD = 0.5
_MUCH_NOISE = 0.15
REGRESSION = "learn it by regression: --network regressor"


def doubts(
    levels: Vector, share: Vector, spread: Vector, *, known: int, held: float, noise: float
) -> tuple[list[str], bool]:
    """Say what speaks against a staircase.

    Args:
        levels: Shape (P,), ascending.
        share: Part of the known samples on each, shape (P,).
        spread: Width of each cluster in eps, shape (P,).
        known: Samples whose scaling is known.
        held: Part of them that lies on plateaus.
        noise: Standard deviation of one sample.

    Returns:
        One sentence each, and whether it is a staircase nevertheless.
    """
    if known == 0:
        return ["the scaling is unknown everywhere"], False
    if levels.size == 0 or noise > _MUCH_NOISE:
        none = "no value of the scaling is held long enough to be a level"
        return [f"{none}: a continuous function, or none at all; {REGRESSION}"], False
    said, stairs = [], True
    if levels.size == 1:
        said.append(f"only one level, {levels[0]:.2f}: the logs show no slow-down, or no full speed")
    if levels.size > _MANY_LEVELS:
        said.append(f"{levels.size} levels are too many for discrete levels: a continuous function; {REGRESSION}")
        stairs = False
    wide = [f"{value:.2f}" for value, width in zip(levels, spread, strict=True) if width > _WIDE]
    if wide:
        said.append(f"values around {', '.join(wide)} form no clear level: a continuous function; {REGRESSION}")
        stairs = False
    if (unknown := 1 - float(share.sum())) > _MUCH_UNKNOWN:
        said.append(f"{unknown:.0%} of the known samples are on no level: ramps, or no discrete levels")
    if held < _LITTLE_HELD and stairs:
        said.append(f"only {held:.0%} of the known samples are held: probably a continuous function; {REGRESSION}")
        stairs = False
    return said, stairs
