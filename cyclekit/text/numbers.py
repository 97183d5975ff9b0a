"""Formats shares in per cent."""

from __future__ import annotations


def whole_percent(part: float) -> str:
    """Return a share in whole per cent: 40 %."""
    return f"{100 * part:.0f} %"


def exact_percent(part: float) -> str:
    """Return a share in per cent with at most four digits: 12.5 %."""
    return f"{100 * part:.4g} %"
