"""Types of the values in cards, with units and limits.

JSON has no NaN and no infinity, so every number is finite. The limits are far outside of real values; they keep
arithmetic with the numbers of a damaged or forged card from overflowing.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from msgspec import Meta, Struct

from cyclekit.config.cells import FARTHEST_M

Seconds = Annotated[float, Meta(ge=-1e19, le=1e19)]
"""A time or a difference of times, s; the limit allows nanoseconds that were read as seconds."""
Duration = Annotated[float, Meta(ge=0.0, le=1e19)]
"""A duration, s."""
WEEK_S = 604_800.0
"""Longest lag or work of an agent, s, and LONGEST_DELAY_S of a safety function: limits of what can be, far beyond any
cell, so that a damaged or forged number is refused where it is read. Half or twice of them changes no real card."""
LONGEST_DELAY_S = 600.0
SLOWEST_RAMP = 1e-4
"""Slowest change of the scaling, 1/s, as `WEEK_S`: from stop to full speed in three hours."""
Lag = Annotated[float, Meta(ge=-WEEK_S, le=WEEK_S)]
"""A time from an event to what follows, s; negative = before it."""
Work = Annotated[float, Meta(ge=0.0, le=WEEK_S)]
"""A duration of a task or of work, s."""
Delay = Annotated[float, Meta(ge=0.0, le=LONGEST_DELAY_S)]
"""A reaction time of the safety function, s."""
SignedDelay = Annotated[float, Meta(ge=-LONGEST_DELAY_S, le=LONGEST_DELAY_S)]
"""The same as measured, s; negative if a clock is off."""
Ramp = Annotated[float, Meta(ge=SLOWEST_RAMP, le=1e6)]
"""A rate of change of the scaling, 1/s."""
Metres = Annotated[float, Meta(ge=-FARTHEST_M, le=FARTHEST_M)]
"""A coordinate, m."""
Length = Annotated[float, Meta(ge=0.0, le=2.0 * FARTHEST_M)]
"""A distance, radius or size, m."""
Measure = Annotated[float, Meta(ge=-1e15, le=1e15)]
"""A number that nothing is computed from but figures, or of a network."""
Hertz = Annotated[float, Meta(gt=0.0, le=1e6)]
"""A sampling rate, 1/s."""
Scaling = Annotated[float, Meta(ge=-0.5, le=1.5)]
"""A speed scaling: fraction of the programmed speed. Logged values may lie a little outside of 0 to 1."""
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
"""A share of a whole."""
Count = Annotated[int, Meta(ge=0, le=2**53)]
"""A number of items."""
Positive = Annotated[int, Meta(ge=1, le=2**31)]
"""A number of items, at least one."""
Digest = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
"""A BLAKE3 or SHA-256 checksum, hexadecimal."""
Name = Annotated[str, Meta(min_length=1)]
"""A name, not empty."""

Point = tuple[Metres, Metres, Metres]
"""x, y, z, m."""
Rotation = tuple[Point, Point, Point]
"""Rows of a rotation matrix."""


class Card(Struct, frozen=True, kw_only=True):
    """Base of all cards: immutable, and unknown keys are ignored."""


def ascending(values: tuple[float, ...]) -> tuple[float, ...]:
    """Return the values if they are strictly ascending.

    Raises:
        ValueError: They are not.
    """
    if any(a >= b for a, b in pairwise(values)):
        msg = "levels must be ascending"
        raise ValueError(msg)
    return values
