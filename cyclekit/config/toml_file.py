"""A TOML file as plain values, with errors that name the file and the line.

What the values mean is the business of `config` and `sequences`.
"""

from __future__ import annotations

import json
import tomllib
from typing import TYPE_CHECKING, Any

from cyclekit.errors import ConfigError
from cyclekit.storage.files import regular
from cyclekit.text.plain_text import all_in_one_line

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def read_toml(path: Path) -> dict[str, Any]:
    """Return the values of a TOML file; names in it are one line each, controls in them escaped.

    Raises:
        ConfigError: The file cannot be read or is no TOML.
    """
    try:
        content = regular(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})", cure="Check the path.") from error
    try:
        return all_in_one_line(tomllib.loads(content.decode("utf-8-sig").replace("\r\n", "\n")))
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        seen = f"{path}: line {line} is no text in UTF-8 (byte 0x{content[error.start]:02x})"
        raise ConfigError(seen, cure="Save the file in the encoding UTF-8.") from error
    except tomllib.TOMLDecodeError as error:
        cure = "Mend the line named above." if "at line" in str(error) else "Close what is open at the end of the file."
        raise ConfigError(f"{path}: not valid TOML ({error})", cure=cure) from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deeply for TOML", cure="Check what the file is.") from error


def list_at(where: str, raw: Mapping[str, Any], key: str) -> list[Any]:
    """Return the list under `key`, empty when absent.

    Raises:
        ConfigError: It is something else.
    """
    value = raw.get(key, [])
    if not isinstance(value, list):
        cure = f"Begin each of them with [[{key}]]." if isinstance(value, dict) else f"{key} = [{_as_toml(value)}]"
        raise ConfigError(f"{where}: {key} must be a list", cure=cure)
    return value


def _as_toml(value: object) -> str:
    """Return a value as TOML writes it."""
    return json.dumps(value, ensure_ascii=False, default=str)
