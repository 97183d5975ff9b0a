"""Memory available to this process: that of the machine, or less under a limit.

A library that gets no memory aborts the process without a message. Check here before reading large data.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

_CGROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def memory_limit_bytes() -> int | None:
    """Return the maximum memory of this process, bytes (under a `ulimit`, what is left of it); None = unknown."""
    known = [count for count in (_machine(), _container(), _process()) if count is not None]
    return min(known, default=None)


def _machine() -> int | None:
    if sys.platform == "win32":
        return _windows()
    with suppress(OSError, ValueError, AttributeError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _windows() -> int | None:
    import ctypes

    class Status(ctypes.Structure):
        """MEMORYSTATUSEX."""

        _fields_ = (
            ("length", ctypes.c_uint32),
            ("load", ctypes.c_uint32),
            *((name, ctypes.c_uint64) for name in ("total", "free", "pages", "free_pages", "room", "left", "more")),
        )

    status = Status()
    status.length = ctypes.sizeof(Status)
    library = getattr(ctypes, "windll", None)
    if library is None or not library.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):
        return None
    return int(status.total)


def _container() -> int | None:
    for file in _CGROUPS:
        with suppress(OSError, ValueError):  # no file, or "max"
            return int(Path(file).read_text(encoding="ascii"))
    return None


def _process() -> int | None:
    """Return what is left of the limit on the address space of this process (`ulimit -v`), bytes."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY:
        return None
    taken = 0
    with suppress(OSError, ValueError):
        taken = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    return max(most - taken, 0)
