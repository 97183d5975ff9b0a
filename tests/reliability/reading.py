"""A log read as a command reads it, and what came of it: how long, and which exceptions are none of ours."""

from __future__ import annotations

import signal
import time
import traceback
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.registry import adapter_named, adapters
from cyclekit.ingest.validate.validate import examined

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.adapter import ReadOptions

READ, PARTLY, REFUSED, FOREIGN = "read", "read, rows set aside", "refused", "foreign exception"
LIMIT_S = 20.0


class TooLong(BaseException):
    """It took longer than any log may."""


@dataclass(frozen=True)
class Result:
    """What came of reading.

    Attributes:
        outcome: READ, PARTLY, REFUSED or FOREIGN.
        seconds: How long it took.
        why: The refusal, or the end of the traceback.
    """

    outcome: str
    seconds: float
    why: str = ""


def read_log(path: Path, adapter: str, options: ReadOptions) -> Result:
    """Let every adapter look at a log, and the named one read it."""
    begin = time.perf_counter()

    def done(outcome: str, why: str = "") -> Result:
        return Result(outcome, time.perf_counter() - begin, why)

    try:
        with _limited(3 * LIMIT_S):
            for entry in adapters().values():
                assert entry.adapter.recognises(path) in (True, False)
            log = examined(adapter_named(adapter).adapter.read(path, options))
    except (LogError, ConfigError) as error:
        return done(REFUSED, str(error))
    except (Exception, TooLong):
        return done(FOREIGN, "".join(traceback.format_exc().splitlines(keepends=True)[-6:]))
    set_aside = log.set_aside is not None and log.set_aside.height
    return done(PARTLY if set_aside or any("cut" in text for text in log.warnings) else READ)


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
