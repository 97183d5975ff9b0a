"""One clock per session: how each log's time maps to session time.

Session time is the robot log's time, counted from its first row: t_session = rate * t_log + offset. Where nothing says
how two clocks relate, the recordings are taken to start together, and that is said aloud. Aligning on "operator near"
against "robot slows" would hide the reaction delay and is not done.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from cyclekit.adapter import ClockKind
    from cyclekit.config import Source

Method = Literal["own", "same-log", "cell-file", "epoch", "assumed-common-start"]


@dataclass(frozen=True)
class LogClock:
    """What is known of one log's clock: its kind and the time of its first row, seconds."""

    kind: ClockKind
    first_s: float


@dataclass(frozen=True)
class ClockFit:
    """t_session = rate * t_log + offset_s, and how that was found."""

    method: Method
    offset_s: float
    rate: float = 1.0
    warning: str | None = None


def fit_clock(log: LogClock, master: LogClock, source: Source | None, *, same_log: bool = False) -> ClockFit:
    """Map the time of `log` to the time of its session, whose clock is `master`'s.

    Args:
        log: The log to be placed.
        master: The session's robot log (or the only log there is).
        source: What the cell file says about `log`.
        same_log: `log` and `master` are tables of one file, so they share a clock by construction.
    """
    if same_log:
        return ClockFit("same-log", -master.first_s)
    if source is not None and source.clock_offset_s is not None:
        return ClockFit("cell-file", source.clock_offset_s - master.first_s, source.clock_rate)
    if log.kind == "epoch" and master.kind == "epoch":
        return ClockFit("epoch", -master.first_s)
    warning = (
        "nothing says how its clock relates to the robot's: both are taken to start together; "
        "give clock_offset_s in cell.toml"
    )
    return ClockFit("assumed-common-start", -log.first_s, 1.0, warning)
