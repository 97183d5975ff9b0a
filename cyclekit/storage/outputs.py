"""Check output paths before the work starts, so that a path that cannot be written fails at once.

The check writes an unnamed temporary file, since permission bits are not reliable (network drives, read-only file
systems, Windows). The output is later written by `atomic`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, CyclekitError
from cyclekit.storage.atomic import write_errors
from cyclekit.storage.remote.folders import check_reachable, is_url

if TYPE_CHECKING:
    from collections.abc import Sequence


def check_writable(place: Path | str | None, kinds: Sequence[str] = ()) -> None:
    """Raise an error if a file cannot be written, whether or not it exists; its folders are created later.

    Args:
        place: The file, as path or URL; None = no file.
        kinds: Supported suffixes, such as `.json`; empty = any.

    Raises:
        ConfigError: The suffix is not one of `kinds`.
        CyclekitError: It is a folder, or cannot be written.
    """
    if place is None:
        return
    if kinds and (ending := Path(place).suffix.lower()) not in kinds:
        shown = f"the ending {ending!r} is not known" if ending else "its name has no ending that gives the format"
        raise ConfigError(f"{place}: {shown}", cure=f"End its name in {' or '.join(kinds)}.")
    if is_url(place):
        check_reachable(str(place))
    elif (path := Path(place)).is_dir():
        raise CyclekitError(f"{path}: is a folder", cure="Give the name of a file in it.")
    else:
        _try(path, path.resolve().parent)


def check_writable_folder(place: Path | str) -> None:
    """Raise an error if a folder cannot be created or replaced.

    Args:
        place: The folder, as path or URL.

    Raises:
        CyclekitError: It is a file, or cannot be written.
    """
    if is_url(place):
        check_reachable(str(place))
        return
    path = Path(place)
    if path.exists() and not path.is_dir():
        raise CyclekitError(f"{path}: is a file, but a folder is needed", cure="Give --out a folder.")
    _try(path, path.resolve().parent)


def _try(path: Path, folder: Path) -> None:
    """Write a temporary file into the nearest existing folder."""
    with write_errors(path):
        while not folder.exists():
            folder = folder.parent
        with tempfile.TemporaryFile(dir=folder):
            pass
