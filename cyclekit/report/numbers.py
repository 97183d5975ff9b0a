"""Numbers as text: rounded to their uncertainty, with their unit.

A number with an interval is rounded so that the interval's half-width shows one digit (two where it starts with 1);
a number without one shows three significant digits. `findings` computes the numbers.
"""

from __future__ import annotations

import math

UNKNOWN = "–"
_MINUS = "−"


def decimals_for(half_width: float) -> int:
    """Return the number of decimals for this uncertainty; negative means tens, hundreds."""
    if not math.isfinite(half_width) or half_width <= 0:
        return 2
    exponent = math.floor(math.log10(half_width))
    leading = half_width / 10**exponent
    return min(3, -exponent + (1 if leading < 1.95 else 0))


def fixed(value: float | None, decimals: int) -> str:
    """Write `value` with that many decimals; a dash when unknown, never "-0"."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    rounded = round(value, decimals)
    text = f"{abs(rounded):.{max(decimals, 0)}f}"
    return (_MINUS if rounded < 0 else "") + text


def significant(value: float | None, digits: int = 3) -> str:
    """Write `value` with that many significant digits, without exponent."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if value == 0:
        return "0"
    return fixed(value, digits - 1 - math.floor(math.log10(abs(value))))


def seconds(value: float | None) -> str:
    """Write a duration in seconds with one decimal below 100 s and none from 1000 s on, unit included."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{fixed(value, 1 if abs(value) < 1000 else 0)}\N{NO-BREAK SPACE}s"


def percent(fraction: float | None) -> str:
    """Write a fraction as per cent: one decimal below 10 %, none above."""
    if fraction is None or not math.isfinite(fraction):
        return UNKNOWN
    share = 100 * fraction
    if 99.5 <= share < 100:
        return "over 99\N{NO-BREAK SPACE}%"
    return f"{fixed(share, 1 if 0 < abs(share) < 9.95 else 0)}\N{NO-BREAK SPACE}%"


def signed_percent(fraction: float) -> str:
    """Write a difference as whole per cent with its sign; one decimal below 1 %."""
    share = 100 * fraction
    text = fixed(share, 0 if abs(share) >= 0.95 else 1)
    return f"{'+' if share > 0 and text.strip('0.') else ''}{text}\N{NO-BREAK SPACE}%"


def given(value: float) -> str:
    """Write a number that the user gave, without trailing zeros: 95, 27.5; at most two decimals."""
    return fixed(value, next((n for n in (0, 1) if round(value, n) == round(value, 2)), 2))


def with_uncertainty(value: float, low: float, high: float) -> tuple[str, str]:
    """Write a mean and its interval, both rounded to what the interval supports.

    Returns:
        The mean, and "low to high", without unit.
    """
    places = decimals_for((high - low) / 2)
    return fixed(value, places), f"{fixed(low, places)} to {fixed(high, places)}"


def count(value: int) -> str:
    """Write a whole number with narrow no-break spaces between thousands."""
    return f"{value:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
