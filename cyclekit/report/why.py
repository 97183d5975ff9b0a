"""Section 3: why the robot is slowed: scaling against distance, and where the operator was."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclekit.report.findings import floor_plan, safety_function
from cyclekit.report.numbers import count, fixed, percent
from cyclekit.report.pictures import Picture, picture
from cyclekit.report.tables import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl

    from cyclekit.dataset import Dataset
    from cyclekit.report.findings import FloorPlan, Overview, Predicts, SafetyFunction
    from cyclekit.report.texts import Texts

EXPLAINS = 0.8
"""From this part of the variance on, distance is said to be what the safety function acts on."""


def section(
    texts: Texts, dataset: Dataset, samples: pl.DataFrame, model: Predicts | None, seen: Overview
) -> dict[str, Any]:
    """Return what the template needs for section 3."""
    found = safety_function(samples, dataset.levels, model)
    plan = floor_plan(dataset, samples)
    missing = _missing(texts, samples, found)
    sentences: list[str] = []
    if seen.slowed == 0.0:
        sentences.append(texts("why.never"))
    elif seen.slowed is not None and seen.halted is not None:
        sentences.append(texts("why.slowed", slowed=percent(seen.slowed), halted=percent(seen.halted)))
    if found:
        sentences.append(texts("why.lead", samples=count(found.samples)))
        key = "why.distance_good" if found.explained >= EXPLAINS else "why.distance_bad"
        sentences.append(texts(key, percent=percent(found.explained)))
    return {
        "sentences": sentences + missing,
        "staircase": _staircase(texts, found, dataset.levels) if found else None,
        "bands": _bands(texts, found) if found and found.bands else None,
        "map": _map(texts, plan) if plan else None,
        "missing": missing,
    }


def _missing(texts: Texts, samples: pl.DataFrame, found: SafetyFunction | None) -> list[str]:
    missing = []
    if not samples["human_x_m"].count():
        missing.append(texts("why.no_operator"))
    if not samples["scaling"].count():
        missing.append(texts("why.no_scaling"))
    if found is None and not missing:
        missing.append(texts("why.too_few"))
    return missing


def _speed(scaling: float) -> str:
    return f"{100 * scaling:.0f} %"


def _staircase(texts: Texts, found: SafetyFunction, levels: Sequence[float]) -> Picture:
    from cyclekit.report import charts

    labels = {key: texts(f"why.{key}") for key in ("logged", "predicted", "distance", "speed")}
    bands = " ".join(
        texts("why.band", speed=_speed(b.scaling), low=fixed(b.low_m, 2), high=fixed(b.high_m, 2)) for b in found.bands
    )
    alt = texts("why.picture", bands=bands)
    return picture("staircase", alt, lambda width_in: charts.staircase(width_in, found, levels, labels))


def _bands(texts: Texts, found: SafetyFunction) -> Table:
    heads = [texts("why.level"), texts("why.range"), texts("why.count")]
    rows = [[_speed(b.scaling), f"{fixed(b.low_m, 2)} to {fixed(b.high_m, 2)}", count(b.samples)] for b in found.bands]
    return Table(texts("why.bands"), heads, rows, frozenset({0, 1, 2}))


def _map(texts: Texts, plan: FloorPlan) -> Picture:
    from cyclekit.report import charts

    labels = {key: texts(f"why.{key}") for key in ("base", "x", "y")} | {"speed": texts("why.map_speed")}
    alt = texts("why.map_picture_none")
    if len(plan.lost_s):
        most = int(plan.lost_s.argmax())
        alt = texts("why.map_picture", x=fixed(float(plan.x_m[most]), 1), y=fixed(float(plan.y_m[most]), 1))
    return picture("floor", alt, lambda width_in: charts.floor_map(width_in, plan, labels))
