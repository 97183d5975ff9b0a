"""What a clock fit is, and the fits that need no arrays: a shared log, the cell file, epoch time, a common start.

A fit carries how it was found and how well: a report can then refuse a weak one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

from cyclekit.dataset.cards import ClockMethod

if TYPE_CHECKING:
    from cyclekit.adapter import ClockKind
    from cyclekit.config import Source

ASSUMED: Final = "assumed-common-start"
"""Nothing says how the clocks relate: the recordings are taken to start together."""
Method = ClockMethod


@dataclass(frozen=True)
class LogClock:
    """What is known of one log's clock: its kind and the time of its first row, seconds."""

    kind: ClockKind
    first_s: float


@dataclass(frozen=True)
class ClockFit:
    """t_other = rate * t_log + offset_s, and how that was found.

    Attributes:
        method: How; see docs/clocks.md.
        offset_s, rate: The line; of a fit made for a session t_other is session time, else the other log's time.
        warning: What a person must know before trusting it.
        residual_s: What the fit leaves unexplained, typically, seconds; None where nothing was left to check it by.
        events: Event pairs (or windows of motion) that the fit rests on.
        events_rejected: Events of the log that found no partner, or contradicted the others.
        correlation: Peak of the correlation, -1 to 1.
        second_best: Height of the second peak over that of the first; near 1 the fit is ambiguous.
        second_best_s: How far the second peak lies from the first, seconds.
        same_as: Recording whose clock this log shares.
    """

    method: Method
    offset_s: float
    rate: float = 1.0
    warning: str | None = None
    residual_s: float | None = None
    events: int | None = None
    events_rejected: int | None = None
    correlation: float | None = None
    second_best: float | None = None
    second_best_s: float | None = None
    same_as: str | None = None

    def since(self, start_s: float) -> ClockFit:
        """Return the fit onto the time that counts from `start_s` of the other log."""
        return replace(self, offset_s=self.offset_s - start_s)

    def to_json(self) -> dict[str, Any]:
        """Return what is known of the fit as plain JSON values, without the warning."""
        named = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "warning"}
        return {name: value for name, value in named.items() if value is not None}


def fit_clock(log: LogClock, master: LogClock, source: Source | None, *, same_log: bool = False) -> ClockFit:
    """Map the time of `log` to the time of its session, whose clock is `master`'s, without looking into the logs.

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
        "give clock_offset_s, sync or sees in cell.toml"
    )
    return ClockFit(ASSUMED, -log.first_s, 1.0, warning)
