"""The elements of a JSON log, one at a time, and as many as are whole.

A skeleton dump is one array or object around thousands of frames. Taken apart frame by frame it needs memory for one
frame beside the text, and a dump that was cut while being written still gives every frame before the cut. `NaN` and
`Infinity`, which recorders write and JSON forbids, are understood. What an element means is the adapters' business.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.text_blocks import encoding_of

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator
    from pathlib import Path

Place = tuple[float, float, float]
_DECODER = json.JSONDecoder()
_SPACE = re.compile(r"[ \t\r\n]*")
_CLOSE = {"[": "]", "{": "}"}


class BrokenJson(ValueError):
    """The text stops being JSON at the character `at`: it was cut, or garbled there."""

    def __init__(self, at: int, cause: str) -> None:
        super().__init__(f"{cause} at character {at}")
        self.at = at


def json_text(path: Path) -> str:
    """Return the whole text of a JSON log.

    Raises:
        LogError: It cannot be opened, or is no text.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its rights.") from error
    encoding = encoding_of(raw[:4096])
    if encoding is None:
        raise DamagedLog(path, "not a text file: it begins with NUL bytes", cure="Check the copy.")
    return raw.decode(encoding, "replace")


def parts(text: str, *, inside: str | None = None) -> Iterator[tuple[str, object]]:
    """Yield the elements of the outermost array (named "") or the members of the outermost object, in their order.

    Args:
        text: The whole document.
        inside: Member of the outermost object whose array is taken apart as well: its elements come one by one, each
            under this name.

    Raises:
        BrokenJson: The document ends or is garbled; what was yielded before is whole.
    """
    at = yield from _walk(text, _skip(text, 0), inside, "")
    if rest := text[_skip(text, at) :][:20].strip("\0"):
        raise BrokenJson(at, f"{rest!r} follows the end of the document")


def _walk(text: str, at: int, inside: str | None, name: str) -> Generator[tuple[str, object], None, int]:
    close = _CLOSE.get(text[at : at + 1])
    if close is None:
        raise BrokenJson(at, "neither an array nor an object begins")
    at = _skip(text, at + 1)
    if text[at : at + 1] == close:
        return at + 1
    while True:
        key = name
        if close == "}":
            raw, at = _value(text, at)
            at = _skip(text, at)
            if not isinstance(raw, str) or text[at : at + 1] != ":":
                raise BrokenJson(at, "a key and a colon are missing")
            key, at = raw, _skip(text, at + 1)
        if close == "}" and key == inside and text[at : at + 1] == "[":
            at = yield from _walk(text, at, None, key)
        else:
            value, at = _value(text, at)
            yield key, value
        at = _skip(text, at)
        if text[at : at + 1] == close:
            return at + 1
        if text[at : at + 1] != ",":
            raise BrokenJson(at, "the document is cut or garbled")
        at = _skip(text, at + 1)


def _skip(text: str, at: int) -> int:
    found = _SPACE.match(text, at)
    return found.end() if found else at


def _value(text: str, at: int) -> tuple[object, int]:
    try:
        return _DECODER.raw_decode(text, at)
    except RecursionError:
        raise BrokenJson(at, "nested too deeply") from None
    except (ValueError, StopIteration):  # also a whole number of thousands of digits
        raise BrokenJson(at, "the document is cut or garbled") from None


def number(value: object) -> float | None:
    """Return a JSON value as a finite number, None where it is none (null, NaN, text, a number beyond floats)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if abs(found) < _BEYOND else None  # NaN compares false


_BEYOND = 1e300


def point(value: object) -> Place | None:
    """Return a JSON array of three finite numbers, None where it is none or lies nowhere on Earth."""
    if not isinstance(value, list) or len(value) != 3:
        return None
    x, y, z = number(value[0]), number(value[1]), number(value[2])
    if x is None or y is None or z is None or max(abs(x), abs(y), abs(z)) > _EARTH:
        return None
    return x, y, z


_EARTH = 1e10
