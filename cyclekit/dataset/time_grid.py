"""Seconds turned into samples: how long something lasts is given in seconds, and counted at the rate of the data."""

from __future__ import annotations

USUAL_HZ = 10.0
"""Rate of a dataset where no other was asked for, and of the paper."""


def samples_in(seconds: float, rate_hz: float, *, least: int = 1) -> int:
    """Return how many samples at `rate_hz` last `seconds`, at least `least`."""
    return max(least, round(seconds * rate_hz))
