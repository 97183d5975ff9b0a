"""Keys of `[sources.map]` for self-describing logs, checked.

An unknown key or word is refused, with the nearest known one. The adapters define the keys.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, UnknownName

if TYPE_CHECKING:
    from cyclekit.adapter import ReadOptions


def words(options: ReadOptions, adapter: str, known: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the given keys, each with one of its words listed in `known`.

    Raises:
        ConfigError: A key or a word is unknown.
    """
    where = f"[sources.map] of a {adapter} log"
    found = {}
    for key, value in options.map.items():
        if key not in known:
            raise UnknownName(where, "key", key, known)
        if not isinstance(value, str):
            raise ConfigError(f"{where}: {key} = {value!r} is not a text", cure=f"One of: {', '.join(known[key])}.")
        if value not in known[key]:
            raise UnknownName(where, key, value, known[key])
        found[key] = value
    return found


def split_names(options: ReadOptions, adapter: str, key: str) -> tuple[tuple[str, ...], dict[str, object]]:
    """Return the names under `key` (an array of texts), and the other keys.

    Raises:
        ConfigError: The value of `key` is not a list of texts.
    """
    rest = dict(options.map)
    value = rest.pop(key, ())
    if isinstance(value, str) or not isinstance(value, Sequence) or not all(isinstance(item, str) for item in value):
        where = f"[sources.map] of a {adapter} log"
        raise ConfigError(f"{where}: {key} = {value!r} is not a list of names", cure=f'For example {key} = ["A", "B"].')
    return tuple(str(item) for item in value), rest
