"""Translates validation errors of msgspec for people who write files by hand."""

from __future__ import annotations

import re

_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "null",
}
_SHOWN = 160


def in_words(error: Exception) -> tuple[str, str]:
    """Return the position of an error (`executions[3].end_s`, empty for the whole value) and what was expected.

    Args:
        error: Error raised by msgspec.
    """
    text, _, where = str(error).partition(" - at `$")
    text = re.sub(r"Object missing required field `(\w+)`", r"\1 is missing", text)
    text = re.sub(r"`([a-z]+)(?: \| null)?`", lambda found: _WORDS.get(found[1], found[0]), text)
    text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
    return where.removesuffix("`").removeprefix("."), f"{text[:1].lower()}{text[1:]}"
