"""A TOML file as checked values, with errors that name the file, the key, the expected value and the cure.

`read_toml` parses; `to_dataclass` converts a table to a frozen dataclass. msgspec checks each value against the type of
its field; its errors are converted to messages here.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeGuard, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from cyclekit.errors import ConfigError, UnknownName
from cyclekit.storage.files import regular
from cyclekit.text.expected import in_words
from cyclekit.text.plain_text import all_in_one_line

if TYPE_CHECKING:
    from dataclasses import Field

Table = TypeVar("Table")
_PAGE = "docs/commands.md (of a fleet: docs/fleet.md) shows the keys and their values."


def read_toml(path: Path | str, example: str = "") -> dict[str, object]:
    """Return the values of a TOML file; line breaks and control characters in names are escaped.

    Args:
        path: The file.
        example: Such a file as the cure where there is none; empty: the path is to be checked.

    Raises:
        ConfigError: The file cannot be read or is not TOML.
    """
    try:
        content = regular(Path(path)).read_bytes()
    except FileNotFoundError as error:
        seen = "no such file" if example else f"cannot be read ({error.strerror})"
        raise ConfigError(f"{path}: {seen}", cure=example or "Check the path.") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})", cure="Check the path.") from error
    try:
        return all_in_one_line(tomllib.loads(content.decode("utf-8-sig").replace("\r\n", "\n")))
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        seen = f"{path}: line {line} is not text in UTF-8 (byte 0x{content[error.start]:02x})"
        raise ConfigError(seen, cure="Save the file in the encoding UTF-8.") from error
    except tomllib.TOMLDecodeError as error:
        cure = (
            "Correct the line named above."
            if "at line" in str(error)
            else "Close the string, list or table that is open at the end of the file."
        )
        raise ConfigError(f"{path}: not valid TOML ({error})", cure=cure) from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deeply for TOML", cure="Check the file.") from error


def to_dataclass(where: str, raw: object, kind: type[Table], **given: object) -> Table:
    """Return a table as a dataclass; nested tables become the dataclasses of its fields.

    Args:
        where: File and table, for messages.
        raw: The table.
        kind: A dataclass whose fields are the keys; msgspec checks the values, `Meta(examples=…)` gives the cure.
        given: Fields that do not come from the file; they are not valid keys.

    Raises:
        UnknownName: A key, or the value of an enumeration, is unknown.
        ConfigError: A key is missing, or its value has the wrong type or is rejected by the dataclass.
    """
    hints = get_type_hints(kind, include_extras=True)
    keys = [each for each in fields(kind) if each.name not in given]  # type: ignore[arg-type]
    known = [each.name for each in keys]
    for key in require_table(where, raw):
        if key not in known:
            raise UnknownName(where, "key", str(key), known)
    values: dict[str, object] = {}
    for each in keys:
        if each.name in require_table(where, raw):
            values[each.name] = _value(where, each, require_table(where, raw)[each.name], hints[each.name])
        elif each.default is MISSING and each.default_factory is MISSING:
            raise ConfigError(f"{where}: no {each.name!r}", cure=f"Add {each.name} = …")
    try:
        return kind(**values, **given)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}", cure=_PAGE) from error


def require_table(where: str, raw: object) -> Mapping[str, Any]:
    """Return `raw`, which must be a table.

    Raises:
        ConfigError: It is something else.
    """
    if not isinstance(raw, Mapping):
        raise ConfigError(f"{where}: {raw!r} must be a table", cure=_PAGE)
    return raw


def require_list(where: str, raw: Mapping[str, Any], key: str) -> list[Any]:
    """Return the list under `key`; empty if absent.

    Raises:
        ConfigError: It is something else.
    """
    value = raw.get(key, [])
    if not isinstance(value, list):
        cure = f"Begin each of them with [[{key}]]." if isinstance(value, dict) else f"{key} = [{_as_toml(value)}]"
        raise ConfigError(f"{where}: {key} must be a list", cure=cure)
    return value


def refuse_twice(where: str, kind: str, names: list[str]) -> None:
    """Raise an error if a name occurs twice.

    Raises:
        ConfigError: A name occurs twice.
    """
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigError(
            f"{where}: {kind} name {twice[0]!r} is used twice", cure=f"Give each {kind} a name of its own."
        )


def _value(where: str, each: Field[Any], value: object, hint: Any) -> Any:  # noqa: ANN401 - a type, and what it says
    if get_origin(hint) in (Union, UnionType):  # optional key: TOML has no null
        (hint,) = (kind for kind in get_args(hint) if kind is not NoneType)
    origin, inner = get_origin(hint), get_args(hint)
    if _is_table(hint):
        return value if isinstance(value, hint) else to_dataclass(f"{where} {each.name}", value, hint)
    if origin is tuple and _is_table(inner[0]):
        entries = require_list(where, {each.name: value}, each.name)
        return tuple(to_dataclass(f"{where} {each.name}[{i}]", entry, inner[0]) for i, entry in enumerate(entries))
    if origin is Mapping and _is_table(inner[1]):
        tables = require_table(f"{where} [{each.name}]", value).items()
        return {name: to_dataclass(f"{where} [{each.name}.{name}]", entry, inner[1]) for name, entry in tables}
    if origin is Literal and value not in inner:
        raise UnknownName(where, f"value of {each.name}", str(value), inner)
    try:
        return msgspec.convert(value, hint)
    except (ValueError, OverflowError) as error:
        if origin is tuple and not isinstance(value, list):
            require_list(where, {each.name: value}, each.name)
        at, said = in_words(error)
        raise ConfigError(f"{where}: {each.name}{at} = {value!r}: {said}", cure=_cure(each, value, hint)) from error


def _is_table(kind: object) -> TypeGuard[type]:
    return isinstance(kind, type) and is_dataclass(kind)


def _cure(each: Field[Any], value: object, hint: Any) -> str:  # noqa: ANN401 - a type
    """Return a valid line: an example of the type, the value as text, or the default."""
    found = [meta.examples[0] for meta in getattr(hint, "__metadata__", ()) if getattr(meta, "examples", None)]
    if not found and hint is str:
        found = [str(value)]
    if not found and isinstance(each.default, str | int | float):
        found = [each.default]
    return f"{each.name} = {_as_toml(found[0])}" if found else _PAGE


def _as_toml(value: object) -> str:
    """Return a value in TOML syntax."""
    return json.dumps(value, ensure_ascii=False, default=str)
