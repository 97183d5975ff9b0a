"""A TOML file as plain values, with errors that name the file and the line.

What the values mean is the business of `config` and `sequences`.
"""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Any

from cyclekit.errors import ConfigError
from cyclekit.files import regular

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def read_toml(path: Path) -> dict[str, Any]:
    """Return the values of a TOML file.

    Raises:
        ConfigError: The file cannot be read or is no TOML.
    """
    try:
        return tomllib.loads(regular(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})", cure="Check the path.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid TOML ({error})", cure="Mend the line named above.") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deeply for TOML", cure="Check what the file is.") from error


def list_at(where: str, raw: Mapping[str, Any], key: str) -> list[Any]:
    """Return the list under `key`, empty when absent.

    Raises:
        ConfigError: It is something else.
    """
    value = raw.get(key, [])
    if not isinstance(value, list):
        raise ConfigError(f"{where}: {key} must be a list", cure=f"{key} = [ … ]")
    return value
