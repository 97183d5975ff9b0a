"""Which variables of a PLC's trace are signals: states and whole numbers. What has fractions measures something.

A trace repeats every variable in every cycle; real numbers would become an event per sample and tell of no state.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_STATES = {"true", "false", "on", "off"}
_WHOLE = re.compile(r"[+-]?\d+")
_REAL = re.compile(r"(?:ADST_|System\.)?L?(?:REAL\d*|DOUBLE|SINGLE|FLOAT)", re.IGNORECASE)


def is_real(data_type: str) -> bool:
    """Tell whether a variable is one of real numbers by the type that its trace states, such as `REAL32`."""
    return _REAL.fullmatch(data_type.strip()) is not None


def are_states(values: Iterable[str]) -> bool:
    """Tell whether all values of a variable are words of states or whole numbers; empty ones say nothing."""
    told = (value.strip() for value in values)
    return all(not value or value.lower() in _STATES or _WHOLE.fullmatch(value) for value in told)


def left_out(names: Sequence[str]) -> list[str]:
    """Return the sentence that says which variables are left out; nothing where none is."""
    if not names:
        return []
    shown = ", ".join(name[:60] for name in names[:5]) + (", ..." if len(names) > 5 else "")
    return [f"{len(names)} variables of real numbers are left out, since they measure: {shown}"]
