"""Folders for the time of one piece of work, removed by the next run where the process was killed.

A folder is `cyclekit-XXXX` in the system's temporary folder. Its process holds the lock of a file in it. The lock is
the operating system's and ends with the process, however that dies. So what can be locked has been left behind.
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
"""Until when a folder may be about to be locked, and from when on one without a lock file is left from a version that
made none."""


class Scratch:
    """A folder that is removed by `remove`, at the end of its `with` block, or by the next run.

    Attributes:
        path: The folder.

    Raises:
        OSError: It cannot be made.
    """

    def __init__(self) -> None:
        """Make the folder, and remove those of processes that are gone."""
        sweep()
        self.path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        self._lock = (self.path / _LOCK).open("w", encoding="utf-8")
        with suppress(OSError):  # a file system without locks: nobody else can lock it either
            lock_descriptor(self._lock.fileno(), blocking=False)

    def remove(self) -> None:
        """Remove the folder with all that is in it."""
        self._lock.close()  # first: Windows removes no open file
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.remove()


def sweep() -> None:
    """Remove the folders of processes that are gone."""
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
        except OSError:  # a file system without locks: nothing can be said
            return False
