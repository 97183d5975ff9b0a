"""The operator's slider that the levels show although no log holds it: some executions ran at a part of every level."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit import schema

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.schema import Vector

TURNED_DOWN = 0.97
"""Maximum slider of an execution that was turned down."""


def sliders_of(execution: Sequence[str], slider: Vector | None) -> dict[str, float]:
    """Return the executions that ran with the slider turned down, and where it stood.

    Args:
        execution: Name of the execution of each sample, N of them.
        slider: The slider found with the levels, shape (N,), NaN = unknown; None if none was found.
    """
    if slider is None:
        return {}
    found = pl.DataFrame({"execution": execution, "slider": slider}).filter(pl.col("slider").is_not_nan())
    usual = found.group_by("execution").agg(pl.col("slider").median()).filter(pl.col("slider") < TURNED_DOWN)
    return dict(usual.sort("execution").iter_rows())


def without_slider_loss(tasks: pl.DataFrame, sliders: Mapping[str, float]) -> pl.DataFrame:
    """Return table TASKS with the time lost to a slider that was found taken from the other causes, unknown ones first.

    A motion of nominal time n at slider f loses n (1 - f) / f to it.
    """
    if not sliders:
        return tasks
    at = pl.col("execution").replace_strict(dict(sliders), default=1.0, return_dtype=pl.Float64)
    lost = pl.min_horizontal(pl.col("nominal_s") * (1.0 - at) / at, pl.col("safety_loss_s"))
    causes = [f"lost_{cause}_s" for cause in schema.SCALING_CAUSES]
    known = tasks.with_columns(lost.fill_null(0.0).alias("slider_s"))
    unknown = pl.col("lost_unknown_s").fill_null(0.0)
    others = pl.sum_horizontal(pl.col(name).fill_null(0.0) for name in causes) - unknown
    rest = (pl.col("slider_s") - unknown).clip(0.0)
    kept = pl.when(others > 0.0).then(((others - rest) / others).clip(0.0)).otherwise(1.0)
    return known.with_columns(
        *((pl.col(name) * kept).alias(name) for name in causes if name != "lost_unknown_s"),
        (pl.col("lost_unknown_s") - pl.col("slider_s")).clip(0.0),
        pl.col("lost_slider_s") + pl.col("slider_s"),
        pl.col("safety_loss_s") - pl.col("slider_s"),
    ).drop("slider_s")
