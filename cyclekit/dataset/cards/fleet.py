"""`cell.json`: the stages done for a cell of a fleet, and its figures for the page of the fleet."""

from __future__ import annotations

from datetime import date
from typing import Literal

from msgspec import field

from cyclekit.dataset.cards.quantities import Card, Count, Duration, Fraction, Measure


class StageCard(Card, frozen=True, kw_only=True):
    """Result of a stage, its reason, and its time (ISO 8601)."""

    state: Literal["done", "unchanged", "failed", "skipped"]
    text: str
    at: str = ""


class MonthCard(Card, frozen=True, kw_only=True):
    """Mean cycle time and share lost to safety in the complete executions of one month (given by its first day)."""

    month: date
    executions: Count
    cycle_s: Duration
    lost_share: Measure | None = None


class FiguresCard(Card, frozen=True, kw_only=True):
    """Figures of a cell for the page of the fleet; None = unknown.

    Attributes:
        executions: Number of complete executions; None without a report.
        cycle_s: Their mean duration.
        lost_s: Time lost to safety per execution, mean over those in which it is known.
        lost_share: The same as a share of the duration.
        newest: Day of the newest log.
        set_aside_share: Share of all rows read that were set aside.
        safety_changed: Whether the safety function has changed since last month.
        habits_changed: Whether the operator's habits have changed.
        shifts: The changes, the most significant first.
        drift: Why changes are unknown; empty if they are known.
        model_doubt: Why the error of the model is large; empty if it is not, or there is no model.
        light: The traffic light of its report: level of the worst finding; empty without one.
        light_why: Its amber and red findings, one sentence each.
        months: The figures by month, the oldest first, if the days of the logs are known.
    """

    executions: Count | None = None
    cycle_s: Duration | None = None
    lost_s: Measure | None = None
    lost_share: Measure | None = None
    newest: date | None = None
    set_aside_share: Fraction | None = None
    safety_changed: bool | None = None
    habits_changed: bool | None = None
    shifts: tuple[str, ...] = ()
    drift: str = ""
    model_doubt: str = ""
    light: Literal["", "green", "amber", "red"] = ""
    light_why: tuple[str, ...] = ()
    months: tuple[MonthCard, ...] = ()


class CellLedger(Card, frozen=True, kw_only=True):
    """A cell of a fleet; its file begins with the stages, by which `guard` recognises it before it is replaced.

    Attributes:
        stages: Result of each stage.
        days: Day of the logs of each session.
        not_read: The first logs that could not be read, and why.
        not_read_more: Number of other logs that could not be read.
        figures: Figures for the page of the fleet.
        reported: Key that changes when the report must be written again; None without one.
        marks: Keys of other stages that change when the stage must be repeated.
        cell: Name of the cell.
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
        """The logs that could not be read, and why; empty if all were read."""
        more = f" and {self.not_read_more} more" if self.not_read_more else ""
        return "; ".join(self.not_read) + more
