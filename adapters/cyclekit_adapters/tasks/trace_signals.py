"""Selection of the signals among the variables of a PLC trace: states and integers, but no measured real numbers.

A trace repeats every variable in every cycle. A real number would give an event per sample and describes no state.
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
    """Return whether a data type from a trace, such as `REAL32`, is a type of real numbers."""
    return _REAL.fullmatch(data_type.strip()) is not None


def are_states(values: Iterable[str]) -> bool:
    """Return whether all values of a variable are state words or integers; empty values are ignored."""
    texts = (value.strip() for value in values)
    return all(not value or value.lower() in _STATES or _WHOLE.fullmatch(value) for value in texts)


def left_out(names: Sequence[str]) -> list[str]:
    """Return a message that lists the variables left out; empty if there are none."""
    if not names:
        return []
    listed = ", ".join(repr(name[:60]) for name in names[:5]) + (", ..." if len(names) > 5 else "")
    return [f"{len(names)} variables of real numbers are left out, since they measure: {listed}"]
