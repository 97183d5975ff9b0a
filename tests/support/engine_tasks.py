"""What workers do in the tests of the engines: at the top of a module, so that every process can import it."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def square(number: int) -> int:
    """Return the square, or fail for a negative number."""
    if number < 0:
        msg = f"{number} is negative"
        raise ValueError(msg)
    return number * number


def environment(_: int) -> tuple[int, str, str]:
    """Return the process and how many threads its libraries may use."""
    return os.getpid(), os.environ.get("POLARS_MAX_THREADS", ""), os.environ.get("OMP_NUM_THREADS", "")


def dies_once(marker: str) -> str:
    """Kill the process in the middle of the work, the first time that it is asked for this file."""
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
    return marker


def dies_always(number: int) -> int:
    """Kill the process at number 3."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
    return number
