"""Parses durations: `105s`, `1min 45s`, `0.5 min`, `500ms`, `105`."""

from __future__ import annotations

import math
import re

from cyclekit.text.numbers import given

LONGEST_S = 1e7
"""Longest duration, s: four months, a limit of what can be a cycle or a takt time."""
_UNITS = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0}
_PART = re.compile(r"\s*((?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?)\s*(ms|min|s|h)?(?![a-z.])", re.ASCII)


def seconds_in(text: str) -> float:
    """Return a duration in seconds; a number without a unit is in seconds.

    Args:
        text: One or more numbers with units, each unit smaller than the previous one: `1min 45s`.

    Raises:
        ValueError: It is no positive duration; the message shows the text and the format.
    """
    word, at, total, last = text.strip().lower(), 0, 0.0, math.inf
    while at < len(word):
        part = _PART.match(word, at)
        unit = None if part is None else _UNITS.get(part[2] or "s")
        if part is None or unit is None or unit >= last or (part[2] is None and (at or part.end() < len(word))):
            msg = f"{text!r} is not a duration; write it as 14s, 1min 45s, 0.5min or 500ms"
            raise ValueError(msg)
        total, last, at = total + float(part[1]) * unit, unit, part.end()
    if not 0 < total <= LONGEST_S:
        msg = f"{text!r} is not a positive duration of at most {given(LONGEST_S)} s"
        raise ValueError(msg)
    return total
