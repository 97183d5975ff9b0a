"""Files that end: a named pipe waits for a writer for ever, and a device may never end.

Whoever reads a file that it did not write itself asks here first.
"""

from __future__ import annotations

import errno
import stat
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
}


def regular(file: Path) -> Path:
    """Return `file` if it is a regular file, or a link to one.

    Raises:
        OSError: It is something else, or is not there.
    """
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, f"is {_KINDS.get(stat.S_IFMT(mode), 'something else')}, not a file", str(file))
    return file
