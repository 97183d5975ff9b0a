"""A part of a whole as per cent."""

from __future__ import annotations


def whole_percent(part: float) -> str:
    """Write a part as whole per cent: 40 %."""
    return f"{100 * part:.0f} %"


def exact_percent(part: float) -> str:
    """Write a part as per cent with what digits it has, four at most: 12.5 %."""
    return f"{100 * part:.4g} %"
