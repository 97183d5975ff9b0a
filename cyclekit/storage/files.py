"""Checks before a file is opened or created: a regular file, with a name that is not too long.

A named pipe waits for a writer forever, and a device may never end. Use these checks before reading a file from
elsewhere, or composing a file name.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from pathlib import Path

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
}
_MAX_BYTES = 200
"""Maximum length of a name, bytes: file systems allow 255; the rest is for prefix and suffix."""


def regular(file: Path) -> Path:
    """Return `file` if it is a regular file, or a link to one.

    Raises:
        OSError: It is something else, or does not exist.
    """
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, f"is {_KINDS.get(stat.S_IFMT(mode), 'something else')}, not a file", str(file))
    return file


def resolved(path: Path) -> Path:
    """Return a path with links resolved; a link to itself stays, and fails when it is opened.

    Raises:
        OSError: The path is relative, and the working directory does not exist.
    """
    return Path(os.path.realpath(path))


def shortened(name: str) -> str:
    """Return a name with room for a suffix; a long one is cut and made unique by a hash of the whole."""
    whole = name.encode("utf-8", "surrogateescape")
    if len(whole) <= _MAX_BYTES:
        return name
    return f"{whole[: _MAX_BYTES - 13].decode('utf-8', 'ignore')}-{hashlib.sha256(whole).hexdigest()[:12]}"
