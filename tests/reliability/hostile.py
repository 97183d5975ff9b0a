"""An ingest of something hostile in a process of its own, with little memory and little time; and what came of it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reliability.explosives import Maker

MEMORY_MIB = 1536
RESERVED_MIB = 2560
"""Addresses that threads set aside for memory they never touch (64 MiB each, and more below Arrow and polars): they
count where the system limits a process, and not in what it has in use."""
LIMIT_S = 60.0


@dataclass(frozen=True)
class Outcome:
    """What came of an ingest.

    Attributes:
        code: Exit code; None where it had to be stopped, negative where a signal ended it.
        said: Standard error.
        seconds: How long it took.
        peak_mib: Most memory in use at once; None where the process died.
    """

    code: int | None
    said: str
    seconds: float
    peak_mib: int | None

    @property
    def fault(self) -> str:
        """Return what is wrong with it, empty if it ingested or gave one message."""
        if self.code is None:
            return f"no end after {self.seconds:.0f} s"
        if self.code not in (0, 1) or "Traceback" in self.said:
            return f"exit code {self.code}: {self.said[-300:]}"
        if self.code == 1 and (not self.said.startswith("error: ") or self.said.count("error: ") != 1):
            return f"not one message: {self.said[:300]}"
        if self.peak_mib is None or self.peak_mib > MEMORY_MIB:
            return f"{self.peak_mib} MiB"
        return ""


def context() -> Any:
    """Return where fresh processes come from: one that has imported everything and done nothing."""
    fresh = multiprocessing.get_context("forkserver")
    fresh.set_forkserver_preload(["cyclekit.ingest.ingest", "cyclekit.cli", "cyclekit_adapters.rosbag"])
    return fresh


def _limited_ingest(words: list[str], said: str, peak: str) -> None:
    from cyclekit.cli import run
    from cyclekit.ingest.registry import adapters

    adapters()
    with Path(said).open("wb") as file, Path(os.devnull).open("wb") as silence:
        os.dup2(silence.fileno(), 1)
        os.dup2(file.fileno(), 2)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + ((MEMORY_MIB + RESERVED_MIB) << 20)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        code = run(words)
    status = Path("/proc/self/status").read_text().splitlines()
    Path(peak).write_text(next(line.split()[1] for line in status if line.startswith("VmHWM")))
    os._exit(code)


def ingest_hostile(make: Maker, fresh: Any, *, limit_s: float = LIMIT_S) -> Outcome:
    """Make a bomb, ingest it in a process of `fresh` under limits, and remove it."""
    with tempfile.TemporaryDirectory() as place:
        folder, said, peak = Path(place) / "logs", Path(place) / "said", Path(place) / "peak"
        folder.mkdir()
        words = ["ingest", str(make(folder)), "--out", str(Path(place) / "dataset"), "--quiet"]
        begin = time.perf_counter()
        process = fresh.Process(target=_limited_ingest, args=(words, str(said), str(peak)))
        process.start()
        process.join(limit_s)
        code, seconds = process.exitcode, time.perf_counter() - begin
        process.kill()
        process.join()
        subprocess.run(["rm", "-rf", str(folder)], check=True)  # also what is nested too deeply for Python
        text, used = "", None
        with contextlib.suppress(OSError):
            text = said.read_bytes().decode("utf-8", "replace")
            used = int(peak.read_text()) >> 10
    return Outcome(code, text, seconds, used)
