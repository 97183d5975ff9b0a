"""The elements of a JSON log, one at a time, and as many as are whole.

A skeleton dump is one array or object around thousands of frames. Taken apart frame by frame it needs memory for a few
frames, whatever its size, and a dump that was cut while being written still gives every frame before the cut. `NaN` and
`Infinity`, which recorders write and JSON forbids, are understood. What an element means is the adapters' business.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import LogError
from cyclekit_adapters.text.text_blocks import characters_of

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

Place = tuple[float, float, float]
_DECODER = json.JSONDecoder()
_SPACE = re.compile(r"[ \t\r\n]*")
_CLOSE = {"[": "]", "{": "}"}
_LONGEST = 1 << 26
"""Characters of one element: no frame of any tracker is longer, and what goes on so long is garbled."""
_NEAR_END = 1 << 16
"""An element that is no JSON is garbled, not cut, where that shows further from the end of what was read than this."""


class BrokenJson(ValueError):
    """The text stops being JSON at the character `at`: it was cut, or garbled there."""

    def __init__(self, at: int, cause: str) -> None:
        super().__init__(f"{cause} at character {at}")
        self.at = at


def json_pieces(path: Path) -> Iterator[str]:
    """Yield the text of a JSON log in pieces.

    Raises:
        LogError: It cannot be opened, or is not text.
    """
    try:
        yield from characters_of(path)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error


def parts(pieces: Iterable[str], *, inside: str | None = None) -> Iterator[tuple[str, object]]:
    """Yield the elements of the outermost array (named "") or the members of the outermost object, in their order.

    Args:
        pieces: The document, cut anywhere.
        inside: Member of the outermost object whose array is taken apart as well: its elements come one by one, each
            under this name.

    Raises:
        BrokenJson: The document ends or is garbled; what was yielded before is whole.
    """
    text = _Text(pieces)
    yield from _walk(text, inside, "")
    if text.next():
        rest = text.shown().strip("\0")
        if rest:
            raise BrokenJson(text.place, f"{rest!r} follows the end of the document")


def documents(pieces: Iterable[str]) -> Iterator[object]:
    """Yield one document after the other: JSON lines, or whole objects written one behind the other.

    Raises:
        BrokenJson: One is cut or garbled; what was yielded before is whole.
    """
    text = _Text(pieces)
    while text.next():
        if not text.shown().strip("\0"):
            return
        yield text.value()


class _Text:
    """The document: what was read of it and not yet taken."""

    def __init__(self, pieces: Iterable[str]) -> None:
        self._pieces = iter(pieces)
        self._text, self._at, self._gone = "", 0, 0

    @property
    def place(self) -> int:
        """Return the number of characters taken."""
        return self._gone + self._at

    def shown(self) -> str:
        """Return the next few characters."""
        return self._text[self._at :][:20]

    def next(self) -> str:
        """Return the next character that is no space, "" at the end; it is not taken."""
        while True:
            found = _SPACE.match(self._text, self._at)
            self._at = found.end() if found else self._at
            if self._at < len(self._text):
                return self._text[self._at]
            if not self._more():
                return ""

    def take(self, character: str) -> bool:
        """Take the next character if it is this one."""
        if self.next() != character:
            return False
        self._at += 1
        return True

    def value(self) -> object:
        """Take a whole value."""
        self.next()
        while True:
            try:
                value, end = _DECODER.raw_decode(self._text, self._at)
            except RecursionError:
                raise BrokenJson(self.place, "nested too deeply") from None
            except StopIteration:
                wrong = len(self._text)
            except json.JSONDecodeError as error:
                wrong = error.pos
            except ValueError:  # a whole number of thousands of digits
                wrong = 0
            else:
                length, cut = end - self._at, end + len("e+") >= len(self._text)  # of a number the rest may follow
                if not cut or not isinstance(value, int | float) or not self._more():
                    self._at += length
                    return value
                continue
            garbled = wrong < len(self._text) - _NEAR_END or len(self._text) - self._at > _LONGEST
            if garbled or not self._more():
                raise BrokenJson(self.place, "the document is cut or garbled")

    def _more(self) -> bool:
        """Read on, at least as much again as is waiting; tell whether there was anything."""
        waiting, wanted = [self._text[self._at :]], len(self._text) - self._at
        self._gone, self._at = self._gone + self._at, 0
        for piece in self._pieces:
            waiting.append(piece)
            wanted -= len(piece)
            if wanted < 0:
                break
        before, self._text = len(waiting[0]), "".join(waiting)
        return len(self._text) > before


def _walk(text: _Text, inside: str | None, name: str) -> Generator[tuple[str, object], None, None]:
    close = _CLOSE.get(text.next())
    if close is None:
        raise BrokenJson(text.place, "neither an array nor an object begins")
    text.take(text.next())
    if text.take(close):
        return
    while True:
        key = name
        if close == "}":
            raw = text.value()
            if not isinstance(raw, str) or not text.take(":"):
                raise BrokenJson(text.place, "a key and a colon are missing")
            key = raw
        if close == "}" and key == inside and text.next() == "[":
            yield from _walk(text, None, key)
        else:
            yield key, text.value()
        if text.take(close):
            return
        if not text.take(","):
            raise BrokenJson(text.place, "the document is cut or garbled")


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


def points(values: Sequence[object]) -> NDArray[np.float64]:
    """Return what `point` makes of each value, shape (N, 3), NaN where it makes nothing."""
    try:
        plain = np.array(values)
    except ValueError:  # of different lengths
        plain = np.array([])
    if plain.ndim == 2 and plain.shape[1] == 3 and plain.dtype.kind in "if":  # nothing but numbers: at once
        found = plain.astype(np.float64)
        found[~(np.abs(found) <= _EARTH).all(axis=1)] = np.nan
        return found
    nowhere = (math.nan, math.nan, math.nan)
    return np.array([point(value) or nowhere for value in values], np.float64).reshape(-1, 3)


_EARTH = 1e10
