"""Conversion of a card from text to checked values and back, with one translation of errors."""

from __future__ import annotations

from dataclasses import is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar, cast

import msgspec

from cyclekit.dataset.cards.quantities import Card
from cyclekit.storage.files import regular
from cyclekit.text.expected import in_words

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

Typed = TypeVar("Typed")

MAX_BYTES = 256 << 20
"""Maximum size of a card, bytes: that of ten thousand recordings has some 20 MB."""


class BadCard(Exception):
    """Why a file is no valid card; the caller raises its own error, with the file and the cure."""


def read_json(file: Path, *, most_bytes: int = MAX_BYTES) -> dict[str, object]:
    """Return the JSON object in a file.

    Raises:
        OSError: It cannot be read, or is no regular file.
        BadCard: It holds no JSON object.
    """
    return parse_json(read_content(file, most_bytes=most_bytes))


def read_content(file: Path, *, most_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file.

    Raises:
        OSError: It cannot be read, or is no regular file.
        BadCard: It is too large for a card.
    """
    if regular(file).stat().st_size > most_bytes:
        raise BadCard(f"larger than {most_bytes >> 20} MB, too large for a card")
    return file.read_bytes()


def parse_json(content: bytes) -> dict[str, object]:
    """Return the JSON object in a text.

    Raises:
        BadCard: The text is no JSON object.
    """
    try:
        found = msgspec.json.decode(content)
    except UnicodeError as error:
        raise BadCard("not text in UTF-8") from error
    except RecursionError as error:
        raise BadCard("nested too deeply for JSON") from error
    except ValueError as error:
        raise BadCard(f"not valid JSON ({_plain(error)})") from error
    if not isinstance(found, dict):
        raise BadCard("not a JSON object")
    return found


def checked(values: Mapping[str, object], kind: type[Typed]) -> Typed:
    """Return JSON values as a card, or as part of one.

    Raises:
        BadCard: A value is missing or invalid; the message names it, and what was expected.
    """
    try:
        return msgspec.convert(values, kind)
    except (ValueError, OverflowError) as error:
        raise BadCard(_plain(error)) from error


def plain(card: Card, *, nulls: bool = False) -> dict[str, Any]:
    """Return a card as JSON values.

    Args:
        card: The card.
        nulls: Write null for unknown values; else they are left out.
    """
    if nulls:
        return cast("dict[str, Any]", msgspec.to_builtins(card))
    return {
        name: _value(value)
        for name, default, value in zip(
            card.__struct_fields__, _defaults(type(card)), msgspec.structs.astuple(card), strict=True
        )
        if value is not msgspec.UNSET and not (value is None and default is None)
    }


@cache
def _defaults(kind: type[Card]) -> tuple[object, ...]:
    return tuple(one.default for one in msgspec.structs.fields(kind))


def _value(value: Any) -> Any:  # noqa: ANN401 - any value of a card
    if isinstance(value, Card):
        return plain(value)
    if is_dataclass(value):
        return {name: _value(one) for name, one in vars(value).items() if one is not None}
    if isinstance(value, dict):
        return {key: _value(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_value(one) for one in value]
    return value


def _plain(error: Exception) -> str:
    """Return an error of msgspec in plain words, the place first: `executions[3].end_s: expected a number`."""
    where, said = in_words(error)
    return f"{where}: {said}" if where else said
