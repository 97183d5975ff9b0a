"""The figures of a cell for the page of the fleet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset.cards import FiguresCard, MonthCard
from cyclekit.ingest.validate.lost_rows import NO_LOSS
from cyclekit.learning.evaluation.drift import Drift
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import date

    from cyclekit.dataset.dataset import Dataset


def figures_of(dataset: Dataset, drift: Drift | str, days: Mapping[str, date], model_doubt: str = "") -> FiguresCard:
    """Return the figures of a dataset.

    Args:
        dataset: All logs of the cell.
        drift: Drift since last month, or the reason why it is unknown.
        days: The day of every session.
        model_doubt: Reason for a large model error; empty if the error is not large.
    """
    whole = dataset.executions.filter("complete")
    lost = dataset.tasks().group_by("execution").agg(
        pl.col("safety_loss_s").sum(), pl.col("safety_loss_s").is_null().any().alias("unknown")
    )  # fmt: skip
    known = whole.join(lost.filter(~pl.col("unknown")), on="execution")
    duration_s, lost_s = float(known["duration_s"].sum()), float(known["safety_loss_s"].sum())
    read = sum(one.rows_read for one in dataset.recordings)
    aside = sum(part.count for one in dataset.recordings for part in one.rows_set_aside if part.reason not in NO_LOSS)
    changes: dict[str, object] = {"drift": drift}
    if isinstance(drift, Drift):
        named = sorted((s for s in (*drift.safety, *drift.habits) if s.changed), key=lambda shift: -abs(shift.z))
        changes = {
            "safety_changed": drift.safety_changed,
            "habits_changed": drift.habits_changed,
            "shifts": tuple(
                f"{shift.what}: {fixed(shift.before, 3)} -> {fixed(shift.after, 3)}" for shift in named[:3]
            ),
        }
    return FiguresCard(
        executions=whole.height,
        cycle_s=float(whole["duration_s"].sum()) / whole.height if whole.height else None,
        lost_s=lost_s / known.height if known.height else None,
        lost_share=lost_s / duration_s if duration_s > 0 else None,
        newest=max(days.values(), default=None),
        set_aside_share=aside / read if read else 0.0,
        model_doubt=model_doubt,
        months=_months(whole.join(known.select("execution", "safety_loss_s"), on="execution", how="left"), days),
        **changes,  # type: ignore[arg-type]
    )


def _months(whole: pl.DataFrame, days: Mapping[str, date]) -> tuple[MonthCard, ...]:
    """Return figures by month, from executions with known day; the loss of a month is unknown if any is unknown."""
    first = {session: day.replace(day=1) for session, day in days.items()}
    months = pl.DataFrame(
        {"session": list(first), "month": list(first.values())}, schema={"session": pl.String, "month": pl.Date}
    )
    seconds = pl.col("duration_s").sum()
    lost = pl.when(pl.col("safety_loss_s").null_count() == 0).then(pl.col("safety_loss_s").sum() / seconds)
    found = whole.join(months, on="session").group_by("month").agg(
        executions=pl.len(), cycle_s=seconds / pl.len(), lost_share=lost
    )  # fmt: skip
    return tuple(MonthCard(**row) for row in found.sort("month").iter_rows(named=True))
