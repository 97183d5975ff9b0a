"""Temporary folders; those of killed processes are removed by the next run.

A folder is `cyclekit-XXXX` in the system's temporary folder. Its process holds the operating system's lock on a file in
it, which ends with the process. So a folder that can be locked is a leftover.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import lock_descriptor

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

_PREFIX, _LOCK = "cyclekit-", ".lock"
_YOUNG_S, _OLD_S = 10.0, 86400.0
"""Age, s, up to which a folder may not be locked yet; age above which a folder without a lock file is a leftover."""


class Scratch:
    """A folder that is removed by `remove`, at the end of its `with` block, or by the next run.

    Attributes:
        path: The folder.

    Raises:
        OSError: It cannot be created.
    """

    def __init__(self) -> None:
        """Create the folder, and remove those of dead processes."""
        sweep()
        self.path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        self._lock = (self.path / _LOCK).open("w", encoding="utf-8")
        with suppress(OSError):  # a file system without locks: no other process can lock it either
            lock_descriptor(self._lock.fileno(), blocking=False)

    def remove(self) -> None:
        """Remove the folder with its content."""
        self._lock.close()  # first: Windows removes no open file
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.remove()


def sweep() -> None:
    """Remove the folders of dead processes."""
    with suppress(OSError):
        for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
            with suppress(OSError):
                if _is_left(folder):
                    shutil.rmtree(folder, ignore_errors=True)


def _is_left(folder: Path) -> bool:
    about = folder.lstat()
    if folder.is_symlink() or not folder.is_dir() or (hasattr(os, "getuid") and about.st_uid != os.getuid()):
        return False
    age_s = time.time() - about.st_mtime
    if not (folder / _LOCK).is_file():
        return age_s > _OLD_S
    if age_s < _YOUNG_S:
        return False
    with (folder / _LOCK).open("r+", encoding="utf-8") as handle:
        try:
            return lock_descriptor(handle.fileno(), blocking=False)
        except OSError:  # a file system without locks: unknown
            return False
