"""Elements of a JSON log, one at a time, up to the point where the file is damaged.

A skeleton dump is one array or object with thousands of frames. Reading it frame by frame needs memory for a few frames
only, and a truncated dump still yields every frame before the cut. `NaN` and `Infinity`, which JSON forbids but
recorders write, are accepted. The adapters interpret the elements.
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
_LONGEST = 1 << 25
"""Maximum number of characters of one element: no tracker writes a longer frame; a longer one is garbled."""
_NEAR_END = 1 << 16
"""Number of characters: invalid JSON farther than this from the end of the text read is garbled, not cut."""


class BrokenJson(ValueError):
    """The text is no valid JSON from character `at` on: it was cut or garbled."""

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
    """Yield the elements of the outermost array (key "") or the members of the outermost object, in order.

    Args:
        pieces: The document, split anywhere.
        inside: Member of the outermost object whose array is also split: each of its elements is yielded under this
            key.

    Raises:
        BrokenJson: The document ends early or is garbled; everything yielded before is complete.
    """
    text = _Text(pieces)
    yield from _walk(text, inside, "")
    if text.next():
        rest = text.shown().strip("\0")
        if rest:
            raise BrokenJson(text.place, f"{rest!r} follows the end of the document")


def documents(pieces: Iterable[str]) -> Iterator[object]:
    """Yield consecutive documents: JSON lines, or objects written one after the other.

    Raises:
        BrokenJson: A document is cut or garbled; everything yielded before is complete.
    """
    text = _Text(pieces)
    while text.next():
        if not text.shown().strip("\0"):
            return
        yield text.value()


class _Text:
    """Reader of the document, which keeps the text that was read but not yet consumed."""

    def __init__(self, pieces: Iterable[str]) -> None:
        self._pieces = iter(pieces)
        self._text, self._at, self._gone = "", 0, 0

    @property
    def place(self) -> int:
        """Number of characters consumed."""
        return self._gone + self._at

    def shown(self) -> str:
        """Return the next few characters without consuming them."""
        return self._text[self._at :][:20]

    def next(self) -> str:
        """Return the next non-space character without consuming it; "" at the end."""
        while True:
            found = _SPACE.match(self._text, self._at)
            self._at = found.end() if found else self._at
            if self._at < len(self._text):
                return self._text[self._at]
            if not self._more():
                return ""

    def take(self, character: str) -> bool:
        """Consume the next character if it equals `character`; return whether it does."""
        if self.next() != character:
            return False
        self._at += 1
        return True

    def value(self) -> object:
        """Consume and return one complete value."""
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
            except ValueError:  # an integer of thousands of digits
                wrong = 0
            else:
                length, cut = end - self._at, end + len("e+") >= len(self._text)  # the rest of a number may follow
                if not cut or not isinstance(value, int | float) or not self._more():
                    told = self._text[self._at : self._at + length]
                    self._at += length
                    return _readable(value) if "\\ud" in told or "\\uD" in told else value
                continue
            garbled = wrong < len(self._text) - _NEAR_END or len(self._text) - self._at > _LONGEST
            if garbled or not self._more():
                raise BrokenJson(self.place, "the document is cut or garbled")

    def _more(self) -> bool:
        """Read at least as much text as is waiting; return whether there was any."""
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


def _readable(value: object) -> object:
    """Return a value with U+FFFD for halves of surrogate pairs, which JSON can write and no text can hold."""
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    if isinstance(value, list):
        return [_readable(one) for one in value]
    if isinstance(value, dict):
        return {_readable(key): _readable(inner) for key, inner in value.items()}
    return value


def number(value: object) -> float | None:
    """Return a JSON value as a finite number; None for null, NaN, text, or a number beyond floats."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if abs(found) < _BEYOND else None  # NaN compares false


_BEYOND = 1e300


def point(value: object) -> Place | None:
    """Return a JSON array of three finite numbers; None for anything else, or a coordinate outside of Earth's scale."""
    if not isinstance(value, list) or len(value) != 3:
        return None
    x, y, z = number(value[0]), number(value[1]), number(value[2])
    if x is None or y is None or z is None or max(abs(x), abs(y), abs(z)) > _EARTH:
        return None
    return x, y, z


def points(values: Sequence[object]) -> NDArray[np.float64]:
    """Return `point` of each value, shape (N, 3); NaN where it is None."""
    try:
        plain = np.array(values)
    except ValueError:  # of different lengths
        plain = np.array([])
    if plain.ndim == 2 and plain.shape[1] == 3 and plain.dtype.kind in "if":  # numbers only: converted at once
        found = plain.astype(np.float64)
        found[~(np.abs(found) <= _EARTH).all(axis=1)] = np.nan
        return found
    nowhere = (math.nan, math.nan, math.nan)
    return np.array([point(value) or nowhere for value in values], np.float64).reshape(-1, 3)


_EARTH = 1e10
