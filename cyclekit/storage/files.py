"""What a file must be like before it is opened or made: one that ends, with a name that fits.

A named pipe waits for a writer for ever, and a device may never end. Whoever reads a file that it did not write itself,
or makes a name out of other names, asks here first.
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
_MOST_BYTES = 200
"""File systems take names of 255 bytes; this leaves room for what is put before and behind one."""


def regular(file: Path) -> Path:
    """Return `file` if it is a regular file, or a link to one.

    Raises:
        OSError: It is something else, or is not there.
    """
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, f"is {_KINDS.get(stat.S_IFMT(mode), 'something else')}, not a file", str(file))
    return file


def resolved(path: Path) -> Path:
    """Return a path without links; a link that leads back to itself stays, and fails where it is opened.

    Raises:
        OSError: The path is relative, and the working directory is gone.
    """
    return Path(os.path.realpath(path))


def shortened(name: str) -> str:
    """Return a name with room for an ending; a long one is cut, and a hash of the whole keeps it apart from others."""
    whole = name.encode("utf-8", "surrogateescape")
    if len(whole) <= _MOST_BYTES:
        return name
    return f"{whole[: _MOST_BYTES - 13].decode('utf-8', 'ignore')}-{hashlib.sha256(whole).hexdigest()[:12]}"
