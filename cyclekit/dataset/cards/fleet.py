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


class FiguresCard(Card, frozen=True, kw_only=True):
    """Figures of a cell; None = unknown. See `cyclekit.fleet.figures.Figures`.

    Attributes:
        cycle_s: Mean duration of complete executions.
        lost_s, lost_share: Lost to safety in an execution.
        newest: Day of the newest log.
        set_aside_share: Part of all rows read that were set aside.
        shifts: What has changed since last month, the clearest first.
        drift: Why nothing can be said of that.
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


class CellLedger(Card, frozen=True, kw_only=True):
    """A cell of a fleet.

    Attributes:
        cell: Its name.
        stages: What came of each stage.
        days: Day of the logs of each session.
        figures: For the page of the fleet.
        reported: Changes when the report must be written again; None without one.
    """

    cell: str = ""
    stages: dict[str, StageCard] = field(default_factory=dict)
    days: dict[str, date] = field(default_factory=dict)
    figures: FiguresCard = FiguresCard()
    reported: str | None = None
