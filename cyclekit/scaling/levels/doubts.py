"""Reasons why a speed scaling may not have discrete levels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.dataset.cards import note

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cyclekit.dataset.cards import Note

    Vector = NDArray[np.float64]

_MANY_LEVELS = 12
"""More levels than any safety configuration offers: then the values are not a staircase."""
_WIDE = 6.0
"""A cluster whose middle 90 % spread over more than this many eps is not a single level."""
_MUCH_UNKNOWN = 0.2
_LITTLE_HELD = 0.5
_CONTINUOUS = 0.35
"""So much of the time on slopes of many rates, and the scaling follows something that has no levels."""
_MUCH_NOISE = 0.15


def doubts(
    levels: Vector,
    share: Vector,
    spread: Vector,
    *,
    known: int,
    held: float,
    noise: float,
    slopes: tuple[float, float] = (0.0, 0.0),
) -> tuple[list[Note], bool]:
    """Say what speaks against a staircase.

    Args:
        levels: Shape (P,), ascending.
        share: Part of the known samples on each, shape (P,).
        spread: Width of each cluster in eps, shape (P,).
        known: Samples whose scaling is known.
        held: Part of them that lies on plateaus; those on ramps between levels are not counted.
        noise: Standard deviation of one sample.
        slopes: Part of them on ramps of one rate, which lead from level to level, and on slopes of many rates.

    Returns:
        The reasons, and whether it is a staircase nevertheless.
    """
    if known == 0:
        return [note("scaling-nowhere")], False
    if levels.size == 0 or noise > _MUCH_NOISE:
        return [note("levels-none")], False
    said, stairs = [], True
    if levels.size == 1:
        said.append(note("levels-one", level=float(levels[0])))
    if levels.size > _MANY_LEVELS:
        said.append(note("levels-many", levels=int(levels.size)))
        stairs = False
    wide = [f"{value:.2f}" for value, width in zip(levels, spread, strict=True) if width > _WIDE]
    if wide:
        said.append(note("levels-wide", values=", ".join(wide)))
        stairs = False
    on_ramp, varied = slopes
    if varied > _CONTINUOUS:
        said.append(note("scaling-continuous", varied=varied))
        stairs = False
    if (unknown := 1 - float(share.sum()) - on_ramp) > _MUCH_UNKNOWN:
        said.append(note("levels-left", unknown=unknown))
    if held < _LITTLE_HELD and stairs:
        said.append(note("levels-not-held", held=held))
        stairs = False
    return said, stairs
