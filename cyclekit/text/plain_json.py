"""Writes a JSON document as text; NaN and infinity become null, because JSON has neither."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import PurePath

from cyclekit.text.plain_text import CONTROL


def json_text(document: object, *, ascii_only: bool = False) -> str:
    """Return `document` as indented JSON; tuples become lists, types unknown to JSON become strings.

    Args:
        document: Dictionaries, sequences and values; NaN and infinities become null, keys become strings.
        ascii_only: Escape all other characters, for terminals of unknown encoding.
    """
    text = json.dumps(finite(document), indent=2, ensure_ascii=ascii_only, allow_nan=False, default=str)
    return CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)  # a terminal may show these


def plain_values(value: object) -> object:
    """Return a value with JSON types: texts for paths and keys, lists for tuples, objects for dataclasses."""
    if isinstance(value, PurePath):
        return str(value)
    if is_dataclass(value):
        return {each.name: plain_values(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain_values(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(entry) for entry in value]
    return value


def finite(value: object) -> object:
    """Return a document with null for NaN and infinities, lists for tuples, and texts for keys."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value
