"""The length units that trackers state in their files, as they spell them.

Files that have one unit, or none, do not come here.
"""

from __future__ import annotations

METRES = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "in": 0.0254}
_WORDS = {
    **{"millimeters": "mm", "millimetres": "mm", "centimeters": "cm", "centimetres": "cm"},
    **{"meters": "m", "metres": "m", "meter": "m", "metre": "m", "inches": "in"},
}


def unit_of(text: str) -> str:
    """Return the unit by its sign where `text` is one or its word, else `text` in lower case."""
    plain = text.strip().lower()
    return _WORDS.get(plain, plain)
