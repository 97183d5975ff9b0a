"""The figures of a cell for the page of the fleet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.learning.evaluation.drift import Drift

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.dataset.dataset import Dataset


@dataclass(frozen=True)
class Figures:
    """What the page says of a cell; None = unknown.

    Attributes:
        executions: Complete executions.
        cycle_s: Their mean duration.
        lost_s: Time lost to safety in an execution, mean over those in which it is known.
        lost_share: The same as part of the duration.
        newest: Day of the newest log, ISO.
        set_aside_share: Part of all rows read that were set aside.
        safety_changed: Whether the safety function is another one since last month.
        habits_changed: Whether the operator's habits are.
        shifts: What has changed, the clearest first.
        drift: Why nothing can be said of it; empty where something can.
        model_doubt: Why the error of the model is large; empty where it is not, or there is no model.
    """

    executions: int
    cycle_s: float | None
    lost_s: float | None
    lost_share: float | None
    newest: str | None
    set_aside_share: float
    safety_changed: bool | None = None
    habits_changed: bool | None = None
    shifts: tuple[str, ...] = ()
    drift: str = ""
    model_doubt: str = ""


def figures_of(dataset: Dataset, drift: Drift | str, days: Mapping[str, str], model_doubt: str = "") -> Figures:
    """Return the figures of a dataset.

    Args:
        dataset: All logs of the cell.
        drift: Since last month, or why that is not known.
        days: The day of every session, ISO.
        model_doubt: Why the error of the model is large; empty where it is not.
    """
    whole = dataset.executions.filter("complete")
    lost = dataset.tasks().group_by("execution").agg(
        pl.col("safety_loss_s").sum(), pl.col("safety_loss_s").is_null().any().alias("unknown")
    )  # fmt: skip
    known = whole.join(lost.filter(~pl.col("unknown")), on="execution")
    duration_s, lost_s = float(known["duration_s"].sum()), float(known["safety_loss_s"].sum())
    read = sum(int(entry["rows_read"]) for entry in dataset.recordings)
    aside = sum(part["count"] for entry in dataset.recordings for part in entry["rows_set_aside"])
    changes: dict[str, object] = {"drift": drift}
    if isinstance(drift, Drift):
        named = sorted((s for s in (*drift.safety, *drift.habits) if s.changed), key=lambda shift: -abs(shift.z))
        changes = {
            "safety_changed": drift.safety_changed,
            "habits_changed": drift.habits_changed,
            "shifts": tuple(f"{shift.what}: {shift.before:.3f} -> {shift.after:.3f}" for shift in named[:3]),
        }
    return Figures(
        executions=whole.height,
        cycle_s=float(whole["duration_s"].sum()) / whole.height if whole.height else None,
        lost_s=lost_s / known.height if known.height else None,
        lost_share=lost_s / duration_s if duration_s > 0 else None,
        newest=max(days.values(), default=None),
        set_aside_share=aside / read if read else 0.0,
        model_doubt=model_doubt,
        **changes,  # type: ignore[arg-type]
    )
