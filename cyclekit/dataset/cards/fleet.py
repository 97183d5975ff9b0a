"""`cell.json`: what was done for a cell of a fleet, stage by stage, and its figures for the page of the fleet."""

from __future__ import annotations

from datetime import date
from typing import Literal

from msgspec import field

from cyclekit.dataset.cards.quantities import Card, Count, Duration, Fraction


class StageCard(Card, frozen=True, kw_only=True):
    """What came of a stage, why, and when (ISO 8601)."""

    state: Literal["done", "unchanged", "failed", "skipped"]
    text: str
    at: str = ""


class MonthCard(Card, frozen=True, kw_only=True):
    """Mean cycle time and part of it lost to safety in the complete executions of one month (its first day)."""

    month: date
    executions: Count
    cycle_s: Duration
    lost_share: float | None = None


class FiguresCard(Card, frozen=True, kw_only=True):
    """Figures of a cell for the page of the fleet; None = unknown.

    Attributes:
        executions: Complete executions; None without a report.
        cycle_s: Their mean duration.
        lost_s: Time lost to safety in an execution, mean over those in which it is known.
        lost_share: The same as part of the duration.
        newest: Day of the newest log.
        set_aside_share: Part of all rows read that were set aside.
        safety_changed: Whether the safety function is another one since last month.
        habits_changed: Whether the operator's habits are.
        shifts: What has changed, the clearest first.
        drift: Why nothing can be said of it; empty where something can.
        model_doubt: Why the error of the model is large; empty where it is not, or there is no model.
        months: The same month by month, where the days of the logs are known; the oldest first.
    """

    executions: Count | None = None
    cycle_s: Duration | None = None
    lost_s: float | None = None
    lost_share: float | None = None
    newest: date | None = None
    set_aside_share: Fraction | None = None
    safety_changed: bool | None = None
    habits_changed: bool | None = None
    shifts: tuple[str, ...] = ()
    drift: str = ""
    model_doubt: str = ""
    months: tuple[MonthCard, ...] = ()


class CellLedger(Card, frozen=True, kw_only=True):
    """A cell of a fleet; its file begins with the stages, by which it is known before it is replaced (`guard`).

    Attributes:
        stages: What came of each stage.
        days: Day of the logs of each session.
        not_read: The first logs that could not be read, and why.
        not_read_more: How many others could not.
        figures: For the page of the fleet.
        reported: Changes when the report must be written again; None without one.
        marks: Of other stages: changes when the stage must be done again.
        cell: Its name.
    """

    stages: dict[str, StageCard] = field(default_factory=dict)
    days: dict[str, date] = field(default_factory=dict)
    not_read: tuple[str, ...] = ()
    not_read_more: Count = 0
    figures: FiguresCard = FiguresCard()
    reported: str | None = None
    marks: dict[str, str] = field(default_factory=dict)
    cell: str = ""

    @property
    def unread(self) -> str:
        """The logs that could not be read, and why; empty where all could."""
        more = f" and {self.not_read_more} more" if self.not_read_more else ""
        return "; ".join(self.not_read) + more
