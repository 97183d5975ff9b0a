"""Numbers as text for tables, sentences, pictures and the page: only this module rounds what people read.

The text is plain: blanks that break, a hyphen as the minus. The page sets it (`report.template`), nothing else does.

Durations show two decimals below 10 s, one below 1000 s and none above. Durations that stand beside each other show the
decimals of the longest (`decimals_of`), and a difference is that of the numbers shown (`difference`). A minus never
stands before a zero, an interval never has two equal ends, and what is unknown is a dash.
"""

from __future__ import annotations

import contextlib
import math
import re

UNKNOWN = "–"
_SPEC = re.compile(r"(\+?)\.(\d)([fg%])")


def decimals_of(*values_s: float | None) -> int:
    """Return the number of decimals of durations that are shown beside each other, s."""
    longest_s = max((abs(value) for value in values_s if value is not None and math.isfinite(value)), default=0.0)
    return 2 if round(longest_s, 2) < 10 else 1 if round(longest_s, 1) < 1000 else 0


def fixed(value: float | None, decimals: int) -> str:
    """Write a number with that many decimals; a negative number of them means tens, hundreds."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    with contextlib.suppress(OverflowError):  # the largest numbers stay as they are
        value = round(float(value), decimals)
    rounded = float(value)
    return ("-" if rounded < 0 else "") + f"{abs(rounded):.{max(decimals, 0)}f}"


def signed(value: float | None, decimals: int) -> str:
    """Write a difference with its sign: +0.3, -0.3, 0.0."""
    text = fixed(value, decimals)
    return f"+{text}" if value is not None and value > 0 and text.strip(f"0.{UNKNOWN}") else text


def significant(value: float | None, digits: int = 3) -> str:
    """Write a number with that many significant digits, without exponent."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if value == 0:
        return "0"
    return fixed(value, digits - 1 - math.floor(math.log10(abs(value))))


def compact(value: float | None, digits: int = 4) -> str:
    """Write a number with the digits that it has, at most `digits` significant ones: 0.25, 500."""
    text = significant(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text else text


def given(value: float) -> str:
    """Write a number that somebody chose, without trailing zeros: 95, 27.5, 1e-05 as 0.00001; at most six digits.

    What is no number is shown as it was given: nan, inf.
    """
    return compact(value, 6) if math.isfinite(value) else str(float(value))


def scientific(value: float | None, decimals: int = 2) -> str:
    """Write an error, such as a mean squared one, for a table in a terminal: 3.19e-04."""
    return UNKNOWN if value is None or not math.isfinite(value) else f"{value + 0.0:.{decimals}e}"


def error_text(value: float | None) -> str:
    """Write an error with three significant digits, a very small one as 3.19 · 10⁻⁴."""
    if value is None or not 0 < abs(value) < 1e-3:
        return significant(value)
    mantissa, exponent = f"{value:.2e}".split("e")
    power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa} · 10{power}"


def difference(first: float, second: float, decimals: int) -> float:
    """Return `first - second` as the numbers shown differ, so that a reader who subtracts finds the same."""
    return round(round(float(first), decimals) - round(float(second), decimals), max(decimals, 0))


def seconds(value: float | None, *beside: float | None) -> str:
    """Write a duration with its unit, and with the decimals of those that it stands beside."""
    text = fixed(value, decimals_of(value, *beside))
    return text if text == UNKNOWN else f"{text} s"


def span(low: float | None, high: float | None, decimals: int) -> str:
    """Write a range: 12.3 to 14.5; one number where both ends look alike."""
    ends = fixed(low, decimals), fixed(high, decimals)
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def interval(low: float, high: float, decimals: int) -> str:
    """Write an interval of confidence, 12.3 to 14.5, or `± under 0.1` where it is too narrow for two ends."""
    if fixed(low, decimals) == fixed(high, decimals) != UNKNOWN:
        return f"± under {fixed(10.0**-decimals, decimals)}"
    return span(low, high, decimals)


def with_interval(value: float, low: float, high: float, decimals: int, unit: str = "s") -> str:
    """Write a number and its interval of confidence: 94.4 s (95 % CI 92.9 to 95.8 s)."""
    return f"{fixed(value, decimals)} {unit} (95 % CI {interval(low, high, decimals)} {unit})"


def percent(fraction: float | None, decimals: int | None = None) -> str:
    """Write a fraction in per cent; only 0 shows as 0 %, and only 1 as 100 %.

    Args:
        fraction: The fraction.
        decimals: Number of decimals; None: one below 10 %, none above.
    """
    if fraction is None or not math.isfinite(fraction):
        return UNKNOWN
    share = 100 * float(fraction)
    digits = _decimals(fraction, decimals)
    text, least = fixed(share, digits), 10.0**-digits
    if share < 100 and text == fixed(100, digits):
        text = f"over {fixed(100 - least, digits)}"
    if share > 0 and text == fixed(0, digits):
        text = f"under {fixed(least, digits)}"
    return f"{text} %"


def percent_interval(low: float, high: float, decimals: int | None = None) -> str:
    """Write an interval of confidence in per cent, 92 to over 99 %, or `± under 1 %`, like `interval`."""
    ends = percent(low, decimals), percent(high, decimals)
    if ends[0] == ends[1] != f"{UNKNOWN} %":
        digits = _decimals(low, decimals)
        return f"± under {fixed(10.0**-digits, digits)} %"
    return f"{ends[0].removesuffix(' %')} to {ends[1]}"


def _decimals(fraction: float, decimals: int | None) -> int:
    return (1 if 0 < abs(fraction) < 0.0995 else 0) if decimals is None else decimals


def signed_percent(fraction: float, decimals: int | None = None) -> str:
    """Write a difference in per cent with its sign; by default whole ones, and one decimal below 1 %."""
    share = 100 * fraction
    digits = (0 if abs(share) >= 0.95 else 1) if decimals is None else decimals
    return f"{signed(share, digits)} %"


def whole_percent(part: float) -> str:
    """Write a level in whole per cent: 40 %."""
    return f"{fixed(100 * part, 0)} %"


def exact_percent(part: float, digits: int = 4) -> str:
    """Write a fraction in per cent with the digits that it has, at most `digits`: 12.5 %."""
    return f"{compact(100 * part, digits)} %"


def count(number: int) -> str:
    """Write a whole number with blanks between thousands."""
    return f"{number:,}".replace(",", " ")


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Write a number of things: `1 cell`, `2 cells`."""
    return f"{count(number)} {noun if number == 1 else plural or f'{noun}s'}"


def duration(value_s: float) -> str:
    """Write a length of time for a remark: `0.8 s`, `12 s`, `3 min 5 s`, `1 h 20 min`."""
    if value_s < 119.5:
        return f"{fixed(value_s, 1 if value_s < 9.95 else 0)} s"
    minutes, rest = divmod(round(value_s), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def megabytes(size: int) -> str:
    """Write the size of a file: `12 kB`, `1.4 MB`."""
    return f"{fixed(size / 1e6, 1)} MB" if size >= 1_000_000 else f"{max(1, round(size / 1e3))} kB"


def by_spec(value: float, spec: str) -> str:
    """Write a number as a format specification asks: `.1f`, `+.2f`, `.0%`, `.3g`; the sentences of notes hold them.

    Raises:
        ValueError: The specification is none of these.
    """
    found = _SPEC.fullmatch(spec)
    if found is None:
        msg = f"{spec!r} is no format of a number"
        raise ValueError(msg)
    sign, digits, kind = found[1], int(found[2]), found[3]
    if kind == "g":
        return compact(value, digits)
    if kind == "%":
        return (signed_percent if sign else percent)(value, digits or None)
    return (signed if sign else fixed)(value, digits)
