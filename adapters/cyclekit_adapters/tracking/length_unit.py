"""Length units in the spelling of trackers' files.

Only for files in which the unit varies.
"""

from __future__ import annotations

METRES = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "in": 0.0254}
_WORDS = {
    **{"millimeters": "mm", "millimetres": "mm", "centimeters": "cm", "centimetres": "cm"},
    **{"meters": "m", "metres": "m", "meter": "m", "metre": "m", "inches": "in"},
}


def unit_of(text: str) -> str:
    """Return the symbol of the unit given as symbol or word; any other `text` in lower case."""
    plain = text.strip().lower()
    return _WORDS.get(plain, plain)
