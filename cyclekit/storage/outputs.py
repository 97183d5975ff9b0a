"""Output places, checked before the work: one that cannot be written is refused in the first second.

The place is tried by a file without a name, since rights that are written down (of a network drive, of a read-only file
system, on Windows) do not say whether one can write. What is written there later is `atomic`'s business.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, CyclekitError
from cyclekit.storage.remote.folders import is_url, reach

if TYPE_CHECKING:
    from collections.abc import Sequence

_CURE = "Check the folder, its permissions and the free space."


def check_writable(place: Path | str | None, kinds: Sequence[str] = ()) -> None:
    """Refuse a file that could not be written, whether it exists already or not; its folders are made later.

    Args:
        place: The file, by path or URL; None = no file is wanted.
        kinds: Endings that are known, as `.json`; empty where any will do.

    Raises:
        ConfigError: The ending is none of `kinds`.
        CyclekitError: A folder has that name, or no file can be written there.
    """
    if place is None:
        return
    if kinds and (ending := Path(place).suffix.lower()) not in kinds:
        shown = f"the ending {ending!r} is not known" if ending else "its name has no ending that gives the format"
        raise ConfigError(f"{place}: {shown}", cure=f"End its name in {' or '.join(kinds)}.")
    if is_url(place):
        reach(str(place))
    elif (path := Path(place)).is_dir():
        raise CyclekitError(f"{path}: is a folder", cure="Give the name of a file in it.")
    else:
        _try(path, path.resolve().parent)


def check_writable_folder(place: Path | str) -> None:
    """Refuse a folder that could not be made, or in whose place nothing could be put.

    Args:
        place: The folder, by path or URL.

    Raises:
        CyclekitError: A file has that name, or nothing can be written there.
    """
    if is_url(place):
        reach(str(place))
        return
    path = Path(place)
    if path.exists() and not path.is_dir():
        raise CyclekitError(f"{path}: is a file, but a folder is needed", cure="Give --out a folder.")
    _try(path, path.resolve().parent)


def _try(path: Path, folder: Path) -> None:
    """Write into the nearest folder that exists."""
    try:
        while not folder.exists():
            folder = folder.parent
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise CyclekitError(f"{path}: cannot be written ({error.strerror or error})", cure=_CURE) from error
