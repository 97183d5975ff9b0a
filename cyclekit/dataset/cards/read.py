"""The one way from the text of a card to checked values, and the one translator of what is wrong with it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from cyclekit.dataset.cards.quantities import Card
from cyclekit.storage.files import regular

if TYPE_CHECKING:
    from pathlib import Path

AnyCard = TypeVar("AnyCard", bound=Card)

MAX_BYTES = 256 << 20
"""No card is larger: that of ten thousand recordings has some 20 MB."""
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


class BadCard(Exception):
    """Why a file is no such card; whoever opens it tells it as an error of its own, with the file and the cure."""


def read_json(file: Path, *, most_bytes: int = MAX_BYTES) -> dict[str, Any]:
    """Return the JSON object in a file.

    Raises:
        OSError: It cannot be read, or is no regular file.
        BadCard: It holds something else.
    """
    return parse_json(read_content(file, most_bytes=most_bytes))


def read_content(file: Path, *, most_bytes: int = MAX_BYTES) -> bytes:
    """Return what stands in a file.

    Raises:
        OSError: It cannot be read, or is no regular file.
        BadCard: It is too large for a card.
    """
    if regular(file).stat().st_size > most_bytes:
        raise BadCard(f"larger than {most_bytes >> 20} MB, which no card is")
    return file.read_bytes()


def parse_json(content: bytes) -> dict[str, Any]:
    """Return the JSON object in a text.

    Raises:
        BadCard: It is something else.
    """
    try:
        found = msgspec.json.decode(content)
    except UnicodeError as error:
        raise BadCard("no text in UTF-8") from error
    except RecursionError as error:
        raise BadCard("nested too deeply for JSON") from error
    except ValueError as error:
        raise BadCard(f"no JSON that can be read ({_plain(error)})") from error
    if not isinstance(found, dict):
        raise BadCard("no JSON object")
    return found


def checked(values: dict[str, Any], kind: type[AnyCard]) -> AnyCard:
    """Return JSON values as a card.

    Raises:
        BadCard: A value is missing or not of its kind; the message says which, and what was expected.
    """
    try:
        return msgspec.convert(values, kind)
    except (ValueError, OverflowError) as error:
        raise BadCard(_plain(error)) from error


def _plain(error: Exception) -> str:
    """Return what msgspec found wrong in our words, the place first: `executions[3].end_s: expected a number`."""
    text, _, where = str(error).partition(" - at `$")
    text = re.sub(r"Object missing required field `(\w+)`", r"\1 is missing", text)
    text = re.sub(r"`([a-z]+)(?: \| null)?`", lambda found: _WORDS.get(found[1], found[0]), text)
    where = where.removesuffix("`").removeprefix(".")
    text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
    return f"{where}: {text[:1].lower()}{text[1:]}" if where else text
